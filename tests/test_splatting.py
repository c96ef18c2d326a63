"""3D Gaussians: the rasteriser against closed forms, binding to triangles, and the file of GaussianAvatars."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.camera import Camera
from talkingeyes.head.gaussians import BoundGaussians, Gaussians, read_gaussians, write_gaussians
from talkingeyes.rendering.splatting import LOW_PASS_PX2, colours_from, harmonic_basis, splat
from talkingeyes.rendering.view import OrbitCamera

BLACK, WHITE = np.zeros(3), np.ones(3)
DISTANCE, FOCAL = 1.0, 400.0
VIEW = OrbitCamera(Camera(FOCAL, (32.5, 24.5), DISTANCE, 64, 48))
C0 = 0.28209479177387814


def gaussians(
    means: list[list[float]], scale: object, opacity: object, colour: list[list[float]], turn: object = None
) -> Gaussians:
    count = len(means)
    return Gaussians(
        np.array(means, np.float32),
        np.broadcast_to(np.asarray(scale, np.float32), (count, 3)).copy(),
        np.array(np.broadcast_to(np.eye(3) if turn is None else turn, (count, 3, 3)), np.float32),
        np.broadcast_to(np.asarray(opacity, np.float32), (count,)).copy(),
        ((np.array(colour, np.float32) - 0.5) / C0)[:, None],
    )


def test_one_gaussian_is_its_projected_normal_distribution() -> None:
    turn = rotvec_to_matrix(np.array([0.3, -0.4, 0.8]))
    scale, mean = np.array([0.03, 0.008, 0.015]), np.array([0.02, 0.01, 0.05])
    shown = splat(gaussians([list(mean)], scale, 0.9, [[1, 1, 1]], turn), VIEW, BLACK)[..., 0]
    # The Jacobian of the projection by finite differences, as in the textbook's definition.
    steps = np.eye(3) * 1e-5
    jacobian = ((VIEW.project(mean + steps) - VIEW.project(mean - steps)) / 2e-5).T
    covariance = jacobian @ turn @ np.diag(scale**2) @ turn.T @ jacobian.T + LOW_PASS_PX2 * np.eye(2)
    pixels = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), axis=-1) - VIEW.project(mean)
    wanted = 0.9 * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", pixels, np.linalg.inv(covariance), pixels))
    assert wanted.max() > 0.8
    assert np.abs(shown / 255 - np.where(wanted < 1 / 255, 0, wanted)).max() < 0.004


def test_the_nearer_of_two_covers_the_farther_by_its_opacity() -> None:
    red, blue = [0.8, 0.1, 0.1], [0.1, 0.2, 0.9]
    for first, second in ((0, 1), (1, 0)):  # the order of the file is that of depth in neither
        means, colours = [[0, 0, 0.1], [0, 0, -0.2]], [red, blue]
        both = gaussians(
            [means[first], means[second]], 0.5, [0.6, 0.7][:: 1 - 2 * first], [colours[first], colours[second]]
        )
        middle = splat(both, VIEW, WHITE)[24, 32] / 255
        wanted = 0.6 * np.array(red) + 0.4 * (0.7 * np.array(blue) + 0.3 * WHITE)
        assert np.allclose(middle, wanted, atol=0.005)


def test_slabs_in_depth_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    many = gaussians(
        rng.normal(0, 0.04, (400, 3)).tolist(),
        rng.uniform(0.002, 0.02, (400, 3)),
        rng.uniform(0, 1, 400),
        rng.random((400, 3)).tolist(),
    )
    whole = splat(many, VIEW, WHITE)
    monkeypatch.setattr("talkingeyes.rendering.splatting.SLAB_FRAGMENTS", 1500)
    assert np.abs(splat(many, VIEW, WHITE).astype(int) - whole).max() <= 1
    # Pixel by pixel, as the definition says.
    order = np.argsort(-many.means[:, 2])
    light, left = np.zeros((48, 64, 3)), np.ones((48, 64))
    for one in order:
        layer = (
            splat(replace(many.of(np.array([one])), harmonics=np.full((1, 1, 3), 0.5 / C0)), VIEW, BLACK)[..., 0] / 255
        )
        light += (left * layer)[..., None] * colours_from(many, VIEW.origin)[one]
        left *= 1 - layer
    assert np.abs(light + left[..., None] - whole / 255).mean() < 0.004


def test_harmonics_are_orthonormal_and_keep_the_signs_of_the_file() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angles = np.arange(16) * np.pi / 8
    z, around = (each.ravel() for each in np.meshgrid(nodes, angles))
    points = np.stack([np.sqrt(1 - z**2) * np.cos(around), np.sqrt(1 - z**2) * np.sin(around), z], axis=-1)
    basis = harmonic_basis(points, 16)
    area = np.tile(weights, 16) * np.pi / 8
    assert np.allclose(basis.T @ (basis * area[:, None]), np.eye(16), atol=1e-12)
    assert (harmonic_basis(np.array([[1.0, 0, 0]]), 4) < 0).tolist() == [[False, False, False, True]]
    ball = gaussians([[0, 0, 0]], 0.1, 1, [[0.5, 0.5, 0.5]])
    lit = np.zeros((1, 4, 3), np.float32)
    lit[0, 2, 0] = 0.5  # along z: from the front the direction is -z
    assert np.allclose(
        colours_from(replace(ball, harmonics=lit), np.array([0, 0, 1.0])), [[0.5 - 0.5 * 0.4886, 0.5, 0.5]], atol=1e-4
    )


def test_a_bound_gaussian_turns_moves_and_grows_with_its_triangle() -> None:
    rng = np.random.default_rng(1)
    triangle = rng.normal(0, 0.05, (3, 3))
    bound = BoundGaussians(
        gaussians([[0.3, 0.2, -0.1]], [0.5, 0.1, 0.3], 1, [[1, 0, 0]], rotvec_to_matrix(np.array([0.2, 0.5, -0.3]))),
        np.array([0]),
    )
    faces, turn, shift = np.array([[0, 1, 2]]), rotvec_to_matrix(np.array([0.7, -0.2, 0.4])), np.array([0.1, 0.2, -0.3])
    before, after = bound.posed(triangle, faces), bound.posed(1.5 * triangle @ turn.T + shift, faces)
    assert np.allclose(after.means, 1.5 * before.means @ turn.T + shift, atol=1e-6)
    assert np.allclose(after.scales, 1.5 * before.scales)
    assert np.allclose(after.rotations, turn @ before.rotations, atol=1e-6)
    # The frame is that of the paper: edge, normal, and their product; the size is the mean of edge and height.
    right = BoundGaussians(gaussians([[1, 0, 0], [0, 1, 0]], 1, 1, [[1, 1, 1]] * 2), np.array([0, 0]))
    flat = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.1, 0]])
    assert np.allclose(right.posed(flat, faces).means, flat.mean(axis=0) + 0.2 * np.array([[1, 0, 0], [0, 0, 1]]))


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_the_file_gives_back_what_was_written(tmp_path: Path, coefficients: int) -> None:
    rng = np.random.default_rng(2)
    content = Gaussians(
        rng.normal(size=(5, 3)).astype(np.float32),
        rng.uniform(0.1, 1, (5, 3)).astype(np.float32),
        rotvec_to_matrix(rng.normal(size=(5, 3))).astype(np.float32),
        rng.uniform(0.1, 0.9, 5).astype(np.float32),
        rng.normal(size=(5, coefficients, 3)).astype(np.float32),
    )
    path = tmp_path / "point_cloud.ply"
    write_gaussians(path, content, np.arange(5), ("head anny",))
    back = read_gaussians(path)
    assert back.comments == ("head anny",)
    assert np.array_equal(back.binding, np.arange(5))
    for name in ("means", "scales", "rotations", "opacities", "harmonics"):
        assert np.allclose(getattr(back.local, name), getattr(content, name), atol=1e-5)
    # The order of 3D Gaussian splatting: all coefficients of red, then those of green.
    header, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[-1] for line in header.decode().splitlines() if line.startswith("property")]
    row = dict(zip(names, np.frombuffer(body, "<f4", len(names)), strict=True))
    assert row["f_dc_1"] == content.harmonics[0, 0, 1]
    if coefficients > 1:
        assert row[f"f_rest_{coefficients - 1}"] == content.harmonics[0, 1, 1]


def _broken(kind: str, good: bytes) -> bytes:
    header, end, body = good.partition(b"end_header\n")
    replaced = {
        "text": (b"binary_little_endian", b"ascii"),
        "greedy": (b"element vertex 2", b"element vertex 999999999999"),
        "many": (b"element vertex 2", b"element vertex 3"),
        "no binding": (b"binding_0", b"colour"),
        "odd harmonics": (b"nx", b"f_rest_0"),
        "list": (b"property float nx", b"property list uchar int nx"),
        "faces": (b"property float x", b"element face 1\nproperty float x"),
    }
    if kind in replaced:
        assert replaced[kind][0] in header
        return header.replace(*replaced[kind], 1) + end + body
    table = np.frombuffer(body, "<f4").reshape(2, -1).copy()
    table[1, {"NaN": 0, "huge": 10, "negative binding": -1, "half binding": -1}[kind]] = {
        "NaN": np.nan,
        "huge": 1e6,
        "negative binding": -2,
        "half binding": 0.5,
    }[kind]
    return header + end + table.tobytes()


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("text", "binary little endian ply"),
        ("greedy", "claims 999,999,999,999 Gaussians"),
        ("many", "claims 3 Gaussians"),
        ("no binding", "lacks binding_0"),
        ("odd harmonics", "0, 9, 24 or 45 properties f_rest_, got 1"),
        ("list", "properties of a vertex should be numbers"),
        ("faces", "should have one element, vertex"),
        ("NaN", "holds NaN"),
        ("huge", "scales should be logarithms below 20"),
        ("negative binding", "binding_0 should be indices"),
        ("half binding", "binding_0 should be indices"),
    ],
)
def test_bad_files_are_one_line(tmp_path: Path, kind: str, message: str) -> None:
    path = tmp_path / "point_cloud.ply"
    write_gaussians(path, gaussians([[0, 0, 0]] * 2, 1, 0.5, [[1, 0, 0]] * 2), np.array([0, 1]))
    path.write_bytes(_broken(kind, path.read_bytes()))
    with pytest.raises(InputError, match=message) as raised:
        read_gaussians(path)
    assert "\n" not in str(raised.value)
