"""Gaze and eyelid closure from images by analysis-by-synthesis, alternating between closure and gaze.

Elisei, Bailly & Casari (AVSP 2007), section 6. For a gaze (a1, a2) and a closure v, the Eyelid model and the camera
determine which pixels show the iris (E1), the rest of the eyeball (E2) and skin (E3). The union of the three regions
depends on neither gaze nor closure. Our copy of the paper lacks the equations, so these forms are ours:

    (1) bias(x, y) = R / (R + G + B)
    (2) minimise over v     -w (1 - w) d |d|, where d = mean bias in E3 - mean bias in E1 and E2, and w is the fraction
        of pixels in E1 and E2. Skin is redder than the eye. w (1 - w) d^2 is the variance explained by the split;
        minimising -d alone would favour a narrow slit inside the sclera
    (3) minimise over a1, a2   mean of (R - S)^2 over E1 and E2 as given by (2), where S is the mean red of each region
        (the paper averages the two colours in one camera image and amplifies their contrast). Solutions with an iris
        lighter than the sclera are penalised

(2) starts from gaze straight ahead, (3) from the best point of a grid; the two steps alternate until gaze converges.
Region edges are one pixel soft, so the energies are smooth. A nearly closed eye is flagged and its gaze is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.optimize import minimize, minimize_scalar

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import angles_to_direction, rotvec_to_matrix
from talkingeyes.head.eyelid.anatomy import IRIS_CENTRE_M, IRIS_RADIUS_M
from talkingeyes.head.eyelid.model import LOWER, UPPER, EyelidModel
from talkingeyes.head.eyelid.region import TEMPORAL_AXES
from talkingeyes.rendering.view import OrbitCamera

REGION_HALF_HEIGHT_M = 0.0105  # of the ellipse that E1, E2 and E3 cover, from eye corner to eye corner
CLOSURE_GRID = np.linspace(-0.3, 1.0, 14)
GAZE_GRID_RAD = np.radians([[yaw, pitch] for yaw in range(-30, 31, 10) for pitch in range(-25, 16, 10)])
GAZE_LIMITS_RAD = np.radians([[-45.0, -35.0], [45.0, 30.0]])
NEARLY_SHUT = 0.7  # closure from which gaze is not estimated
MIN_CONTRAST = 0.02  # of red bias between skin and eye; below it, no eye is visible
ROUNDS, CONVERGENCE_RAD = 4, np.radians(0.1)
STEP_RAD = np.radians(3.0)
DARK_OFFSET = 0.03  # added to each channel in (1), because the hue of black is undefined


@dataclass(frozen=True)
class PosedImage:
    """One view: an image (linear or display colours from 0 to 1), its camera, and the pose of the head."""

    image: Float[ndarray, "H W 3"]
    view: OrbitCamera
    head: Float[ndarray, " 3"]
    translation: Float[ndarray, " 3"]


@dataclass(frozen=True)
class EyeGeometry:
    """One eye: its index (0 the subject's left, 1 the right), its centre in head coordinates, its Eyelid model."""

    eye: int
    centre: Float[ndarray, " 3"]
    lids: EyelidModel


@dataclass(frozen=True)
class EyeEstimate:
    """Estimated gaze and closure. `angles_rad` (yaw, pitch; eye-in-head) is NaN if the eye is nearly shut."""

    angles_rad: Float[ndarray, " 2"]
    lid: float
    nearly_shut: bool
    contrast: float


@dataclass(frozen=True)
class Patch:
    """The N pixels around one eye in one view, with their rays in head axes relative to the eye's centre."""

    at_px: Float[ndarray, "N 2"]
    red: Float[ndarray, " N"]
    bias: Float[ndarray, " N"]
    origin: Float[ndarray, " 3"]
    rays: Float[ndarray, "N 3"]
    px_per_m: float
    turn: Float[ndarray, "3 3"]
    posed_image: PosedImage


def estimate_eye(posed_images: Sequence[PosedImage], eye: EyeGeometry) -> EyeEstimate:
    """Estimate gaze and closure of one eye from one to three views of the same instant.

    Raises InputError if there is no image, or if the eye is outside all of them.
    """
    if not posed_images:
        raise InputError("posed_images: should hold at least one image, got none")
    patches = [patch for patch in (_patch(posed_image, eye) for posed_image in posed_images) if len(patch.red)]
    if not patches:
        raise InputError("posed_images: the eye should be inside at least one image, got it outside all")
    angles, lid = np.zeros(2), 0.0
    for turn in range(ROUNDS):
        lid = _closure(patches, eye, angles, None if turn == 0 else lid)
        contrast = _contrast(patches, eye, angles, lid)
        if lid > NEARLY_SHUT or contrast < MIN_CONTRAST:
            return EyeEstimate(np.full(2, np.nan), lid, True, contrast)
        before, angles = angles, _gaze(patches, eye, lid, angles, GAZE_GRID_RAD if turn == 0 else angles[None])
        if np.abs(angles - before).max() < CONVERGENCE_RAD:
            break
    return EyeEstimate(angles, lid, False, contrast)


def red_bias(image: Float[ndarray, "*N 3"], dark_offset: float = DARK_OFFSET) -> Float[ndarray, "*N"]:
    """(1): the normalised red component; `dark_offset` is added to each channel."""
    lifted = image + dark_offset
    return np.asarray(lifted[..., 0] / lifted.sum(axis=-1))


def blink_energy(bias: Float[ndarray, " N"], inside: Float[ndarray, " N"]) -> float:
    """(2): the negative separation of red skin and eye. `inside` is the fraction of each pixel in E1 and E2."""
    area, total = inside.sum(), float(len(inside))
    if not 1e-9 < area < total - 1e-9:
        return 0.0
    apart = (bias * (1 - inside)).sum() / (total - area) - (bias * inside).sum() / area
    share = area / total
    return float(-share * (1 - share) * apart * abs(apart))


def gaze_energy(red: Float[ndarray, " N"], inside: Float[ndarray, " N"], iris: Float[ndarray, " N"]) -> float:
    """(3): mean squared difference to a two-colour image. `iris` is the fraction of each pixel in the iris."""
    first, second = inside * iris, inside * (1 - iris)
    area = first.sum(), second.sum()
    if min(area) < 1e-6:
        return float((inside * (red - (inside * red).sum() / inside.sum()) ** 2).sum() / inside.sum())
    dark, light = (first * red).sum() / area[0], (second * red).sum() / area[1]
    if dark > light:
        dark = light = (inside * red).sum() / inside.sum()
    return float((inside * (red - iris * dark - (1 - iris) * light) ** 2).sum() / inside.sum())


def _closure(patches: list[Patch], eye: EyeGeometry, angles_rad: Float[ndarray, " 2"], near: float | None) -> float:
    """Step one: the closure that minimises (2) at a given gaze."""

    def energy(lid: float) -> float:
        return float(
            sum(blink_energy(patch.bias, lid_opening_coverage(patch, eye, angles_rad, lid)) for patch in patches)
        )

    step = CLOSURE_GRID[1] - CLOSURE_GRID[0]
    start = CLOSURE_GRID[int(np.argmin([energy(lid) for lid in CLOSURE_GRID]))] if near is None else near
    bounds = (max(start - step, CLOSURE_GRID[0]), min(start + step, CLOSURE_GRID[-1]))
    return float(minimize_scalar(energy, bounds=bounds, method="bounded", options={"xatol": 1e-3}).x)


def _gaze(
    patches: list[Patch], eye: EyeGeometry, lid: float, angles_rad: Float[ndarray, " 2"], starts: Float[ndarray, "K 2"]
) -> Float[ndarray, " 2"]:
    """Step two: the gaze that minimises (3) with the eye opening held fixed."""
    openings = [lid_opening_coverage(patch, eye, angles_rad, lid) for patch in patches]
    seen = [(patch, inside) for patch, inside in zip(patches, openings, strict=True) if inside.sum() > 1.0]

    def energy(angles: Float[ndarray, " 2"]) -> float:
        beyond = np.abs(angles - np.clip(angles, *GAZE_LIMITS_RAD)).sum()
        return float(
            beyond + sum(gaze_energy(patch.red, inside, iris_coverage(patch, angles)) for patch, inside in seen)
        )

    best = starts[int(np.argmin([energy(start) for start in starts]))]
    simplex = best + STEP_RAD * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-9, "maxfev": 120}
    return np.asarray(minimize(energy, best, method="Nelder-Mead", options=options).x)


def _contrast(patches: list[Patch], eye: EyeGeometry, angles_rad: Float[ndarray, " 2"], lid: float) -> float:
    """Mean red bias of skin minus that of the eye, pooled over views."""
    bias = np.concatenate([patch.bias for patch in patches])
    inside = np.concatenate([lid_opening_coverage(patch, eye, angles_rad, lid) for patch in patches])
    if not 0 < inside.sum() < len(inside):
        return 0.0
    return float(np.average(bias, weights=1 - inside) - np.average(bias, weights=inside))


def lid_opening_coverage(
    patch: Patch, eye: EyeGeometry, angles_rad: Float[ndarray, " 2"], lid: float
) -> Float[ndarray, " N"]:
    """Fraction of each pixel between the lids (E1 and E2)."""
    curves = eye.lids.curves(angles_rad, np.array(lid))[UPPER.start : LOWER.stop] * TEMPORAL_AXES[eye.eye] + eye.centre
    projected = _project(patch.posed_image, curves, patch.turn)
    x, y = patch.at_px.T
    upper, lower = (_height(projected[curve], x) for curve in (UPPER, LOWER))
    return np.asarray(np.clip(np.minimum(lower - y, y - upper) + 0.5, 0.0, 1.0))


def iris_coverage(patch: Patch, angles_rad: Float[ndarray, " 2"]) -> Float[ndarray, " N"]:
    """Fraction of each pixel in the iris circle, whether or not the lids cover it."""
    gaze = angles_to_direction(angles_rad)
    along = (IRIS_CENTRE_M - patch.origin @ gaze) / (patch.rays @ gaze)
    met = patch.origin + along[:, None] * patch.rays
    away = np.linalg.norm(met - IRIS_CENTRE_M * gaze, axis=1)
    return np.asarray(np.clip((IRIS_RADIUS_M - away) * patch.px_per_m + 0.5, 0.0, 1.0))


def _patch(posed_image: PosedImage, eye: EyeGeometry) -> Patch:
    """The pixels in an ellipse from eye corner to eye corner, tilted with the eye."""
    rest = eye.lids.rest[UPPER] * TEMPORAL_AXES[eye.eye]
    inner, outer = rest[0], rest[-1]
    middle, half = (inner + outer) / 2, (outer - inner) / 2
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None]
    ring = middle + np.cos(around) * half + np.sin(around) * np.array([0.0, REGION_HALF_HEIGHT_M, 0.0])
    turn = rotvec_to_matrix(posed_image.head)
    inside = _pixels_within(_project(posed_image, ring + eye.centre, turn), posed_image.image.shape)
    colours = posed_image.image[inside[:, 0], inside[:, 1]]
    at_px = inside[:, ::-1] + 0.5
    origin = (posed_image.view.origin - posed_image.translation) @ turn - eye.centre
    depth = float(np.linalg.norm(origin))
    return Patch(
        at_px=at_px,
        red=colours[:, 0],
        bias=red_bias(colours),
        origin=origin,
        rays=posed_image.view.rays(at_px) @ turn,
        px_per_m=posed_image.view.camera.focal_px / depth,
        turn=turn,
        posed_image=posed_image,
    )


def _pixels_within(ring: Float[ndarray, "K 2"], shape: tuple[int, ...]) -> Int[ndarray, "N 2"]:
    """Rows and columns of the pixels whose centres lie inside a convex ring."""
    low = np.maximum(np.floor(ring.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(ring.max(axis=0)).astype(int), [shape[1], shape[0]])
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    step = np.roll(ring, -1, axis=0) - ring
    side = step[:, 0] * (rows[..., None] + 0.5 - ring[:, 1]) - step[:, 1] * (columns[..., None] + 0.5 - ring[:, 0])
    inside = (side >= 0).all(axis=-1) | (side <= 0).all(axis=-1)
    return np.stack([rows[inside], columns[inside]], axis=-1)


def _project(
    posed_image: PosedImage, points: Float[ndarray, "K 3"], turn: Float[ndarray, "3 3"]
) -> Float[ndarray, "K 2"]:
    return posed_image.view.project(points @ turn.T + posed_image.translation)


def _height(curve_px: Float[ndarray, "U 2"], x: Float[ndarray, " N"]) -> Float[ndarray, " N"]:
    """y of a lid curve at pixel columns; beyond its ends, y of its end point, where both lids meet."""
    order = np.argsort(curve_px[:, 0], kind="stable")
    return np.asarray(np.interp(x, curve_px[order, 0], curve_px[order, 1]))
