"""Gaussian avatars: of FLAME and of the open head, their films, and the errors of bad folders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
import trimesh
from command_line import call
from flame_file import arrays, write

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats.writers.gaussians import y_down
from talkingeyes.head.anny import anny_head
from talkingeyes.head.flame import load_flame
from talkingeyes.head.gaussian_avatar import GaussianAvatar, load_avatar
from talkingeyes.head.gaussians import BoundGaussians, Gaussians, write_gaussians
from talkingeyes.rendering import open_avatar
from talkingeyes.rendering.open_avatar import Posture
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.splatting import AvatarRenderer, colours_from


def on_triangles(binding: list[int]) -> BoundGaussians:
    """A round grey Gaussian at the centre of each triangle."""
    count = len(binding)
    turns = np.tile(np.eye(3, dtype=np.float32), (count, 1, 1))
    ones = np.ones((count, 3), np.float32)
    return BoundGaussians(
        Gaussians(0 * ones, 0.5 * ones, turns, np.full(count, 0.9, np.float32), np.zeros((count, 1, 3), np.float32)),
        np.array(binding),
    )


@pytest.fixture
def flame_avatar(tmp_path: Path) -> Path:
    """An avatar as GaussianAvatars keeps it, with a FLAME file: two triangles, and one of the teeth."""
    folder = tmp_path / "avatar"
    folder.mkdir()
    bound = on_triangles([0, 5000, 9976 + 167])
    write_gaussians(folder / "point_cloud.ply", bound.local, bound.binding)
    write(folder / "flame.pkl", arrays())
    offset = np.zeros((1, 5143, 3), np.float32)
    offset[0, :, 1] = 0.01
    np.savez(folder / "flame_param.npz", shape=np.array([0.5, -1], np.float32), static_offset=offset)
    return folder


def test_an_avatar_of_flame_has_the_shape_of_its_person_and_no_teeth(flame_avatar: Path) -> None:
    avatar = load_avatar(flame_avatar)
    mean = load_flame(flame_avatar / "flame.pkl")
    wanted = mean.template + 0.5 * mean.identity[0] - mean.identity[1]
    moved = avatar.head.template - wanted
    assert np.allclose(moved, moved[0], atol=1e-6)  # heads are centred on their necks
    assert avatar.bound.binding.tolist() == [0, 5000]
    motion = Motion.of(25.0, np.array([[0, 0, 0], [0, 0.5, 0]]), np.zeros((2, 2, 3)))
    first, second = avatar.posed(motion)
    assert np.allclose(first.means, avatar.head.template[avatar.head.faces[[0, 5000]]].mean(axis=1), atol=1e-6)
    assert not np.allclose(first.means, second.means, atol=1e-3)


def test_an_avatar_of_the_open_head_looks_like_it_and_blinks(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = [Posture(lid=lid, framing="face") for lid in (0.0, 1.0)]
    monkeypatch.setattr(open_avatar, "POSTURES", (*shown, Posture(gaze_deg=(20.0, 0.0), framing="face")))
    monkeypatch.setattr(open_avatar, "SIZE_PX", 128)
    monkeypatch.setattr(open_avatar, "PRIOR", 0.1)  # for so few pixels
    avatar = open_avatar.build_avatar(anny_head(), 13_000)
    assert len(avatar.bound.local) == 13_000
    monkeypatch.setattr(open_avatar, "ITERATIONS", 0)
    first = open_avatar.build_avatar(anny_head(), 13_000)
    mesh, splats, unfitted = (
        np.stack([next(renderer(each, posture.view(128)).draw(posture.motion)) / 255 for posture in shown])
        for renderer, each in ((HeadRenderer, avatar.head), (AvatarRenderer, avatar), (AvatarRenderer, first))
    )
    face, eyes = np.s_[:, 25:110, 40:90], np.s_[25:55, 25:103]
    error, before = (np.sqrt(((each - mesh)[face] ** 2).mean()) for each in (splats, unfitted))
    assert error < 0.05
    assert error < 0.8 * before
    moved, followed = (shut[eyes] - open_[eyes] for open_, shut in (mesh, splats))
    covered = np.abs(moved) > 0.2  # where a lid comes before an eye
    assert covered.sum() > 100
    assert 0.7 < (moved * followed)[covered].sum() / (moved**2)[covered].sum() < 1.3


def test_a_film_of_an_avatar(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flame_avatar: Path) -> None:
    monkeypatch.chdir(tmp_path)
    Motion.of(30.0, np.zeros((3, 3)), np.zeros((3, 2, 3))).save(Path("a.npz"))
    monkeypatch.setattr(open_avatar, "build_avatar", lambda head: GaussianAvatar(head, on_triangles([*range(12_000)])))
    assert call("avatar", "-o", "own") == 0
    assert call("avatar", "-o", "own") == 2  # it exists
    for folder in ("own", "avatar"):
        words = ("render", "a.npz", "-o", f"{folder}.mp4", "--head", "gaussians", "--model", folder, "--size", "64")
        assert call(*words) == 0
        with av.open(f"{folder}.mp4") as container:
            frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert (len(frames), frames[0].shape) == (3, (64, 64, 3))
    assert frames[0].std() > 0.1


def test_a_posed_frame_is_a_ply_of_3d_gaussian_splatting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flame_avatar: Path
) -> None:
    """Read by trimesh, which knows no Gaussians; y points down, and colours are the same from the same side."""
    monkeypatch.chdir(tmp_path)
    motion = Motion.of(30.0, np.array([[0, 0, 0], [0.1, 0.2, 0.3]]), np.zeros((2, 2, 3)))
    motion.save(Path("a.npz"))
    words = ("export", "a.npz", "-o", "a.ply", "--head", "gaussians", "--model", "avatar", "--frame", "1", "--eyes")
    assert call(*words, "optical") == 0
    _, posed = load_avatar(flame_avatar).posed(motion)
    content = trimesh.load("a.ply").metadata["_ply_raw"]["vertex"]
    assert [*content["properties"]][:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert not any("binding" in name for name in content["properties"])
    read = np.stack([content["data"][axis].ravel() for axis in "xyz"], axis=1)
    assert np.allclose(read, posed.means * [1, -1, -1], atol=1e-6)
    rng = np.random.default_rng(0)
    coloured = replace(posed, harmonics=rng.normal(0, 0.1, (len(posed), 16, 3)).astype(np.float32))
    turned, origin = y_down(coloured), np.array([0.3, 0.4, 0.8])
    assert np.allclose(colours_from(turned, origin * [1, -1, -1]), colours_from(coloured, origin), atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "point_cloud.ply").unlink(), "not a readable point cloud"),
        (lambda folder: (folder / "flame.pkl").unlink(), "should hold one FLAME file .* got 0"),
        (lambda folder: (folder / "flame_param.npz").unlink(), "not a readable FLAME parameters"),
        (lambda folder: np.savez(folder / "flame_param.npz", shape=np.zeros(400)), "at most 300 numbers, got 400"),
        (lambda folder: np.savez(folder / "flame_param.npz", shape=np.full(3, np.nan)), "shape should be finite"),
        (
            lambda folder: np.savez(folder / "flame_param.npz", static_offset=np.zeros((1, 9, 3))),
            "static_offset should",
        ),
        (
            lambda folder: write_gaussians(
                folder / "point_cloud.ply", on_triangles([20_000]).local, np.array([20_000])
            ),
            "triangles of flame, below 10144, got 20000",
        ),
    ],
)
def test_a_bad_folder_is_one_line(flame_avatar: Path, change: object, message: str) -> None:
    change(flame_avatar)  # type: ignore[operator]
    with pytest.raises(InputError, match=message) as raised:
        load_avatar(flame_avatar)
    assert "\n" not in str(raised.value)


def test_the_folder_of_the_avatar_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Motion.of(30.0, np.zeros((3, 3)), np.zeros((3, 2, 3))).save(Path("a.npz"))
    assert call("render", "a.npz", "-o", "a.mp4", "--head", "gaussians") == 2
    assert "model: should be the folder of the avatar where head is gaussians" in capfd.readouterr().err
