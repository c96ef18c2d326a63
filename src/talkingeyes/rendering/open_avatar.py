"""A Gaussian avatar of a head with vertex colours: Gaussians on its triangles, their colours fitted to its renders.

The triangles are halved at their longest edge, the largest first, until there are as many as Gaussians; eyes, the skin
around them and mouth count as larger. Each part gets a flat Gaussian, WIDTH times as wide as its standard deviations. A
picture is linear in the harmonics of all Gaussians, so these follow by regularised least squares (conjugate gradients)
from renders of the head in several postures and views. The renderer's light is baked in: it does not follow the head.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.ndimage import binary_erosion
from scipy.sparse import csr_array, hstack

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.head.gaussian_avatar import GaussianAvatar
from talkingeyes.head.gaussians import BoundGaussians, Gaussians, triangle_frames
from talkingeyes.head.model import PARTS, HeadModel
from talkingeyes.head.normals import vertex_normals
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.shading import BACKGROUND, EYE, to_pixels, vertex_light
from talkingeyes.rendering.splatting import C0, harmonic_basis, project, weight_slabs
from talkingeyes.rendering.view import FRAMINGS, OrbitCamera

GAUSSIANS = 50_000
COEFFICIENTS = 4  # harmonics of degree 1
WIDTH, EYE_WIDTH, THICKNESS_M, OPACITY = 2.4, 1.8, 0.0001, 0.99
PART_SIZE = {"skin": 1.0, "lips": 1.6, "brow": 2.0, "sclera": 2.2, "iris": 3.0, "pupil": 3.0}
PART_SIZE |= {"teeth": 1.3, "tongue": 0.8, "tissue": 0.5}  # other parts, of looks: 1
EYE_REGION_M, EYE_REGION_SIZE, BACK_SIZE = 0.022, 3.0, 0.6
FLAT = 0.4  # change of the normal over a triangle, above which skin counts as larger: ears
SIZE_PX = 384
ITERATIONS, PRIOR = 20, 5.0  # of conjugate gradients; weight of the first colours beside a pixel's


class Posture(NamedTuple):
    """Both eyes (yaw, pitch), lids and jaw, and the framing and the turn (yaw, pitch) of the camera; degrees."""

    gaze_deg: tuple[float, float] = (0.0, 0.0)
    lid: float = 0.0
    jaw_deg: float = 0.0
    framing: str = "head"
    camera_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def motion(self) -> Motion:
        """A motion of one frame."""
        gaze = np.tile(angles_to_gaze(np.radians(np.array([self.gaze_deg]))), (1, 2, 1))
        jaw = np.radians([[self.jaw_deg, 0.0, 0.0]])
        return Motion.of(25.0, np.zeros((1, 3)), gaze, lid=np.full((1, 2), self.lid), jaw=jaw)

    def view(self, size_px: int) -> OrbitCamera:
        framing = replace(FRAMINGS[self.framing], yaw_deg=self.camera_deg[0], pitch_deg=self.camera_deg[1])
        return framing.view(size_px, size_px)


POSTURES = (  # those that colours are fitted to
    *(Posture(camera_deg=(30.0 * turn, 0.0)) for turn in range(-6, 6)),
    *(Posture(camera_deg=(yaw, pitch)) for yaw in (-45.0, -15.0, 15.0, 45.0) for pitch in (-25.0, 30.0)),
    *(Posture((yaw, pitch), framing="face") for yaw in (-25.0, 0.0, 25.0) for pitch in (-18.0, 0.0, 15.0)),
    *(Posture((yaw, 0.0), framing="eyes", camera_deg=(-yaw, 0.0)) for yaw in (-30.0, 0.0, 30.0)),
    *(Posture(lid=lid, framing="face", camera_deg=(yaw, 0.0)) for lid in (0.5, 1.0) for yaw in (-20.0, 20.0)),
    Posture(lid=1.0, framing="eyes"),
    *(
        Posture(jaw_deg=jaw, framing="face", camera_deg=turn)
        for jaw in (6.0, 15.0)
        for turn in ((-15.0, 10.0), (15.0, -10.0), (0.0, 0.0))
    ),
)


def build_avatar(head: HeadModel, count: int = GAUSSIANS) -> GaussianAvatar:
    """The avatar of a head, of `count` Gaussians or as many as it has triangles."""
    binding, corners = _bisected(head, count)
    local = _on_parts(head, binding, corners)
    return _coloured(GaussianAvatar(head, BoundGaussians(local, binding)))


def _bisected(head: HeadModel, count: int) -> tuple[Int[ndarray, " N"], Float[ndarray, "N 3 3"]]:
    """Triangles of parts of the faces, and the barycentric coordinates of their corners."""
    points = head.template[head.faces]
    middle = points.mean(axis=1)
    sizes = np.array([PART_SIZE.get(part, 1.0) for part in PARTS])[head.parts]
    skin = head.parts == PARTS.index("skin")
    near = np.linalg.norm(middle[:, None] - head.eye_centres, axis=2).min(axis=1) < EYE_REGION_M
    sizes[skin & near] = EYE_REGION_SIZE
    sizes[skin & (middle[:, 2] < 0)] = BACK_SIZE
    (normals,) = vertex_normals(head.template[None], head.faces)
    bend = np.linalg.norm(np.ptp(normals[head.faces], axis=1), axis=1)
    sizes[skin & ~near] *= np.clip(bend[skin & ~near] / FLAT, 1.0, 2.0)

    binding, corners = np.arange(len(head.faces)), np.tile(np.eye(3), (len(head.faces), 1, 1))
    while len(binding) < count:
        at = corners @ points[binding]
        edges = np.linalg.norm(at - np.roll(at, -1, axis=1), axis=2)
        largest = np.argsort(-edges.max(axis=1) * sizes[binding], kind="stable")[
            : min(len(binding) // 8, count - len(binding))
        ]
        longest = edges[largest].argmax(axis=1)
        first, second, third = (corners[largest, (longest + step) % 3] for step in range(3))
        half = (first + second) / 2
        corners[largest] = np.stack([first, half, third], axis=1)
        corners = np.concatenate([corners, np.stack([half, second, third], axis=1)])
        binding = np.concatenate([binding, binding[largest]])
    return binding, corners


def _on_parts(head: HeadModel, binding: Int[ndarray, " N"], corners: Float[ndarray, "N 3 3"]) -> Gaussians:
    """Flat Gaussians with the spread of parts of triangles, in the triangles' frames, lit as the head at rest."""
    # Open lids are folded and shut ones are stretched: their Gaussians have the shape of half-shut ones.
    (vertices,) = posed_vertices(head, motion_to_pose(head, Posture(lid=0.5).motion))
    centres, axes, sizes = triangle_frames(vertices, head.faces)
    at = corners @ vertices[head.faces][binding]
    axis, size = axes[binding], sizes[binding][:, None]
    local = np.einsum("nij,nki->nkj", axis, at - centres[binding][:, None])
    means = local.mean(axis=1)
    out = local - means[:, None]
    spread, turn = np.linalg.eigh(np.einsum("nki,nkj->nij", out, out) / 12)  # a triangle's covariance
    turn[:, :, 0] *= np.sign(np.linalg.det(turn))[:, None]
    width = np.where(EYE[head.parts[binding]], EYE_WIDTH, WIDTH)[:, None]  # of the sharp iris
    scales = np.maximum(width * np.sqrt(np.maximum(spread, 0)), THICKNESS_M)
    lit = (corners.mean(axis=1)[:, :, None] * _lit(head)[head.faces][binding]).sum(axis=1)
    harmonics = np.zeros((len(binding), COEFFICIENTS, 3))
    harmonics[:, 0] = (to_pixels(lit) / 255 - 0.5) / C0
    opacities = np.full(len(binding), OPACITY)
    arrays = (means / size, scales / size, turn, opacities, harmonics)
    return Gaussians(*(array.astype(np.float32) for array in arrays))


def _lit(head: HeadModel) -> Float[ndarray, "V 3"]:
    """Light of the vertices at rest to a viewer in front of each."""
    (normals,) = vertex_normals(head.template[None], head.faces)
    matt = np.isin(np.arange(len(normals)), head.vertices_of("sclera", "iris", "pupil", "teeth"))
    light = vertex_light(normals, -normals, head.colours, head.ambient, matt)
    return np.asarray(light.sky + light.lamps)


@dataclass(frozen=True)
class _Picture:
    """A render: weights of the Gaussians in its pixels, their harmonics' basis, and the light that they should give."""

    weights: csr_array
    basis: Float[ndarray, "N K"]
    light: Float[ndarray, "P 3"]

    def of(self, harmonics: Float[ndarray, "N K 3"]) -> Float[ndarray, "P 3"]:
        return np.asarray(self.weights @ np.einsum("nk,nkc->nc", self.basis, harmonics))

    def back(self, light: Float[ndarray, "P 3"]) -> Float[ndarray, "N K 3"]:
        """The transpose of `of`."""
        return np.asarray(self.basis[:, :, None] * (self.weights.T @ light)[:, None])


def _coloured(avatar: GaussianAvatar) -> GaussianAvatar:
    """The avatar with the harmonics that show its head's renders best."""
    pictures = [_picture(avatar, posture) for posture in POSTURES]
    local = avatar.bound.local
    shown = local.harmonics.astype(np.float64)

    def normal(harmonics: ndarray) -> ndarray:
        return PRIOR * harmonics + sum(each.back(each.of(harmonics)) for each in pictures)

    left = np.sum([each.back(each.light - each.of(shown)) for each in pictures], axis=0)
    step, size = left.copy(), float((left**2).sum())
    for _ in range(ITERATIONS):
        applied = normal(step)
        amount = size / float((step * applied).sum())
        shown, left = shown + amount * step, left - amount * applied
        before, size = size, float((left**2).sum())
        step = left + size / before * step
    fitted = replace(local, harmonics=shown.astype(np.float32))
    return replace(avatar, bound=replace(avatar.bound, local=fitted))


def _picture(avatar: GaussianAvatar, posture: Posture) -> _Picture:
    view, motion = posture.view(SIZE_PX), posture.motion
    (wanted,) = HeadRenderer(avatar.head, view).draw(motion)
    # Pixels beside the background would teach Gaussians of the outline its colour, which they show in other views.
    inside = binary_erosion((wanted != to_pixels(BACKGROUND)).any(axis=-1), iterations=2).ravel()
    (posed,) = avatar.posed(motion)
    parts, sources = zip(*weight_slabs(project(posed, view), SIZE_PX, SIZE_PX), strict=True)
    joined = hstack(parts, format="coo")
    columns = np.concatenate(sources)[joined.col]
    weights = csr_array((joined.data, (joined.row, columns)), shape=(SIZE_PX**2, len(posed)))
    away = posed.means - view.origin
    basis = harmonic_basis(away / np.linalg.norm(away, axis=1, keepdims=True), posed.harmonics.shape[1])
    weights = weights[inside]
    return _Picture(weights, basis, wanted.reshape(-1, 3)[inside] / 255 - 0.5 * weights.sum(axis=1)[:, None])
