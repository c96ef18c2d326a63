"""Gaze and lid closure of all frames of a clip at once, by the analysis-by-synthesis of the Eyelid paper.

The energies are those of `analysis_by_synthesis` (Elisei, Bailly & Casari, AVSP 2007, section 6), in a form that treats
all frames together: each eye is a small image at one scale, its pixels are rays in the axes of the head, and both lids
are polynomials along the opening. What the paper takes as known is estimated:

    pose    of the head from landmarks: it is wrong by degrees, which moves an eye by millimetres, and gaze by five
            degrees a millimetre. Each eye is therefore shifted upwards in its image to where its lids fit best, by
            energy (2) over shift and closure, in frames with open eyes, smoothed over time. Gaze is so relative to the
            lids, in the head
    size    of the opening from the eye corners, and of the iris from energy (3), one factor of each for a clip and eye;
            the eyeball has the average ratio to the iris, as in the paper
    trust   `EyeTrack.reason`
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_direction, angles_to_gaze, rotvec_to_matrix
from talkingeyes.fitting.analysis_by_synthesis import NEARLY_SHUT, REGION_HALF_HEIGHT_M, red_bias
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.eyelid.anatomy import IRIS_CENTRE_M, IRIS_RADIUS_M, iris_contour
from talkingeyes.head.eyelid.model import LOWER, UPPER, EyelidModel, LabelledPostures, fit_eyelid_model
from talkingeyes.head.eyelid.region import TEMPORAL_AXES, eyelid_region
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.head.landmarks import EYE_CENTRES, head_to_scene, rest_landmarks
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.tracking.cropping import Crop
from talkingeyes.tracking.eye_images import EyeImage

PX_PER_M = 1500.0  # of an eye's image
IMAGE_PX = (48, 32)  # width and height
BLOCK = 250  # frames treated together: a frame takes 0.2 MB
DEGREE = 5  # of a lid as a polynomial along the opening
DARK_OFFSET = 0.15  # added to each channel in (1): dark brown irises and lashes are as red as skin, but little of it
CLOSURES = np.linspace(-0.3, 1.0, 14)
STARTS_RAD = np.radians([[yaw, pitch] for yaw in (-12, 0, 12) for pitch in (-10, 0, 10)])  # about the first estimate
LIMITS_RAD = np.radians([[-45.0, -35.0], [45.0, 30.0]])
SHIFT_M, STEP_RAD, STEP_CLOSURE = 0.0003, np.radians(1.0), 0.03  # of numerical derivatives
PLANE_M = 0.008  # of the eye plane before the centre of the eye, amid the lid margins
SHADOW_M = 0.0004  # below the upper lid, where its shadow and its lashes darken the eye
MAX_SHIFT_M = 0.006
HEIGHTS_M = np.linspace(-0.004, 0.004, 5)  # first shifts of a clip
HEIGHT_PRIOR = 0.15  # weight of the square of the shift, relative to the largest, in units of (2)
SHIFT_WINDOW_S = 0.4  # of the Gaussian that smooths the shift
SHIFT_SPREAD_M, SHIFT_PRIOR = 0.001, 0.3  # limit of the shift from its median, weight of the median (1: of all frames)
OPEN_CLOSURE = 0.45  # below it, a frame counts for the shift and the sizes
CLOSURE_PRIOR = 0.6  # weight of the squared distance from the landmarks' closure, in units of (2)
SHUT_SEPARATION = 0.5  # of skin and eye by (2), relative to the clip's median: below it, no eye is seen
SIZES = np.array([0.96, 0.98, 1.0, 1.02, 1.04])  # of the iris, relative to the opening: people differ by 4 % (sd)
SIZE_FRAMES = 40
MAX_SD_RAD = np.radians(3.0)  # of gaze that is trusted
MIN_BIAS_CONTRAST = 0.01  # of the red bias between skin and eye
MIN_IRIS_CONTRAST = 0.04  # of the red channel between sclera and iris
MIN_VISIBLE_IRIS = 0.25  # of the circle
RING_POINTS = 48
RESIDUAL_CORRELATION_PX = 3.0  # neighbouring pixels share their errors


@dataclass(frozen=True)
class EyeImages:
    """One eye of T frames in one view, at PX_PER_M.

    The eye plane is PLANE_M before the centre of the eye, in head axes; its coordinates are x and y, metres. `origin`:
    those of the first pixel; `step`: to the next pixel to the right, and down. `slope`: movement in the plane, seen
    from the camera, of a point that moves a metre ahead.
    """

    pixels: Sequence[UInt8[ndarray, "H W 3"]]
    origin: Float[ndarray, "T 2"]
    step: Float[ndarray, "T 2 2"]
    slope: Float[ndarray, "T 2"]

    def at(self, rows: Int[ndarray, " F"]) -> EyeImages:
        """Some of the frames."""
        return EyeImages([self.pixels[row] for row in rows], self.origin[rows], self.step[rows], self.slope[rows])


@dataclass(frozen=True)
class EyeTrack:
    """One eye of T frames. `reason`: why gaze cannot be trusted; empty where it can.

    `angles_rad`: (yaw, pitch) in the head; `closure` as `Motion.lid`; both energies; `sd_rad`: of gaze, by the
    curvature of its energy; `shift_m`: of the eye in its plane, from where the head pose puts it.
    """

    angles_rad: Float[ndarray, "T 2"]
    closure: Float[ndarray, " T"]
    blink_energy: Float[ndarray, " T"]
    gaze_energy: Float[ndarray, " T"]
    sd_rad: Float[ndarray, " T"]
    shift_m: Float[ndarray, "T 2"]
    lid_size: float
    iris_size: float
    reason: tuple[str, ...]

    @property
    def trusted(self) -> Bool[ndarray, " T"]:
        """Frames whose gaze can be trusted."""
        return np.array([not reason for reason in self.reason])


@cache
def open_head_lids() -> tuple[EyelidModel, EyelidModel]:
    """The Eyelid models of the open head's lids, left and right."""
    yaw, pitch, lid = np.meshgrid(np.radians([-30, 0, 30]), np.radians([-25, -12, 0, 15]), [0.0, 0.5, 1.0])
    angles, closures = np.stack([yaw.ravel(), pitch.ravel()], axis=-1), lid.ravel()
    gaze = angles_to_gaze(np.repeat(angles[:, None], 2, axis=1))
    motion = Motion.of(25.0, np.zeros((len(lid.ravel()), 3)), gaze, lid=np.repeat(closures[:, None], 2, axis=1))
    head = anny_head()
    vertices = posed_vertices(head, motion_to_pose(head, motion)).astype(np.float64)
    found = []
    for eye in range(2):
        around = eyelid_region(head, eye)
        curves = (around.curves.of(vertices) - around.centre) * TEMPORAL_AXES[eye]
        found.append(fit_eyelid_model(LabelledPostures(angles, curves, closures == 0, closures == 1)))
    return found[0], found[1]


def place_eye(
    images: Sequence[EyeImage],
    eye: int,
    head: Float[ndarray, "T 3"],
    translation: Float[ndarray, "T 3"],
    camera: Camera,
    crop: Crop,
) -> EyeImages:
    """The images of one eye with the rays of their pixels, for head poses under the camera of a crop."""
    origins, steps, slopes = [], [], []
    for image, turn, moved in zip(images, rotvec_to_matrix(head), translation, strict=True):
        at = image.corner + image.scale * np.array([[0.0, 0.0], [IMAGE_PX[0], 0.0], [0.0, IMAGE_PX[1]]])
        offset = (crop.to_crop(at) - np.array(camera.centre_px)) / camera.focal_px
        rays = np.column_stack([offset[:, 0], -offset[:, 1], np.full(3, -1.0)]) @ turn
        place = (np.array([0.0, 0.0, camera.distance_m]) - moved) @ turn - EYE_CENTRES[eye]
        met = place + ((PLANE_M - place[2]) / rays[:, 2])[:, None] * rays
        origins.append(met[0, :2])
        steps.append([(met[1, :2] - met[0, :2]) / IMAGE_PX[0], (met[2, :2] - met[0, :2]) / IMAGE_PX[1]])
        slopes.append(-place[:2] / place[2])
    return EyeImages([image.pixels for image in images], np.array(origins), np.array(steps), np.array(slopes))


def opening_sizes(
    landmarks: Float[ndarray, "T L 2"], head: Float[ndarray, "T 3"], translation: Float[ndarray, "T 3"], camera: Camera
) -> Float[ndarray, " 2"]:
    """Distance of the corners of each eye relative to those of the open head, the median over the clip."""
    corners = EYE_LANDMARKS[:, [0, 3]]
    rest = np.tile(rest_landmarks()[corners.ravel()], (len(head), 1, 1))
    shown = camera.project(head_to_scene(rest, head, translation)).reshape(-1, 2, 2, 2)
    seen, expected = (np.linalg.norm(each[:, :, 0] - each[:, :, 1], axis=-1) for each in (landmarks[:, corners], shown))
    return np.asarray(np.nanmedian(seen / expected, axis=0))


def project_curves(
    images: EyeImages, eye: int, lids: EyelidModel, found: EyeTrack
) -> tuple[Float[ndarray, "T P 2"], Float[ndarray, "T K 2"]]:
    """The curves of the model (both lids, anchor) and the iris circle of each frame, in pixels of its image."""
    curves = lids.curves(found.angles_rad, found.closure) * TEMPORAL_AXES[eye] * found.lid_size
    ring = iris_contour(found.angles_rad, RING_POINTS, np.random.default_rng(0), 0.0) * found.iris_size
    placed = []
    for points in (curves, ring):
        flat = points[..., :2] + (points[..., 2:] - PLANE_M) * images.slope[:, None] + found.shift_m[:, None]
        placed.append(np.einsum("tpd,tde->tpe", flat - images.origin[:, None], np.linalg.inv(images.step)))
    return placed[0], placed[1]


def capture_eye(
    images: EyeImages,
    eye: int,
    lids: EyelidModel,
    start_rad: Float[ndarray, "T 2"],
    start_closure: Float[ndarray, " T"],
    fps: float,
    lid_size: float = 1.0,
    iris_size: float | None = None,
) -> EyeTrack:
    """Gaze and closure of one eye in all frames; `start_rad`, `start_closure`: first estimates of gaze and lids, as by
    LightGazeFit and from landmarks.

    `lid_size`, `iris_size`: sizes of the opening relative to the lids' model, and of the iris relative to the average;
    without the second, it is estimated.
    """
    frames = len(start_rad)
    iris = 1.0 if iris_size is None else iris_size
    shift = np.zeros((frames, 2), np.float32)

    def scene(rows: ndarray) -> _Scene:
        return _Scene.of(images.at(rows), eye, lids).sized(lid_size=lid_size, iris_size=iris).shifted(shift[rows])

    def by_block(function: Callable[[_Scene, ndarray], tuple[ndarray, ...]]) -> list[ndarray]:
        blocks = [np.arange(first, min(first + BLOCK, frames)) for first in range(0, frames, BLOCK)]
        return [np.concatenate(each) for each in zip(*(function(scene(rows), rows) for rows in blocks), strict=True)]

    (energies,) = by_block(lambda block, rows: (block.energies_by_height(start_rad[rows], start_closure[rows]),))
    costs = energies.mean(axis=0) + HEIGHT_PRIOR * (HEIGHTS_M / HEIGHTS_M[-1]) ** 2
    height_m = float(HEIGHTS_M[np.argmin(costs)])
    shift, closure = by_block(lambda block, rows: block.register(start_rad[rows], start_closure[rows], height_m))
    shift = _smoothed(shift, closure < OPEN_CLOSURE, fps).astype(np.float32)
    (closure,) = by_block(
        lambda block, rows: (block.close(start_rad[rows], block.best_closure(start_rad[rows], start_closure[rows])),)
    )
    open_rows = np.flatnonzero(closure < OPEN_CLOSURE)
    if iris_size is None and len(open_rows):
        sizes = lid_size * SIZES
        rows = open_rows[np.linspace(0, len(open_rows) - 1, min(len(open_rows), SIZE_FRAMES)).round().astype(int)]
        few = scene(rows)
        costs = [few.sized(iris_size=float(size)).look(start_rad[rows], closure[rows])[1].mean() for size in sizes]
        iris = _lowest(sizes, np.array(costs))

    def last(block: _Scene, rows: ndarray) -> tuple[ndarray, ...]:
        angles, _, _ = block.look(start_rad[rows], closure[rows])
        lid = block.close(angles, closure[rows])
        angles, energy, sd = block.look(angles, lid, starts=np.zeros((1, 2)), rounds=3)
        return angles, lid, energy, sd, block.bias_residual(block.opening(angles, lid))[1]

    angles, closure, energy, sd, blink_energy = by_block(last)
    separation = 1.0 - blink_energy
    closure = np.where(separation < SHUT_SEPARATION * np.median(separation), start_closure, closure)
    (reason,) = by_block(lambda block, rows: (np.array(block.reasons(angles[rows], closure[rows], sd[rows])),))
    return EyeTrack(
        angles_rad=angles.astype(np.float64),
        closure=closure.astype(np.float64),
        blink_energy=blink_energy.astype(np.float64),
        gaze_energy=energy.astype(np.float64),
        sd_rad=sd.astype(np.float64),
        shift_m=shift.astype(np.float64),
        lid_size=lid_size,
        iris_size=iris,
        reason=tuple(reason.tolist()),
    )


def _smoothed(shift: Float[ndarray, "T 2"], counts: Bool[ndarray, " T"], fps: float) -> Float[ndarray, "T 2"]:
    """The shift over time from the frames that count, drawn to its median where there are few."""
    if not counts.any():
        return np.zeros_like(shift)
    middle, width = np.median(shift[counts], axis=0), SHIFT_WINDOW_S * fps
    apart = np.clip(shift - middle, -SHIFT_SPREAD_M, SHIFT_SPREAD_M) * counts[:, None]
    total, weight = (gaussian_filter1d(each, width, axis=0, mode="nearest") for each in (apart, counts.astype(float)))
    return np.asarray(middle + total / (weight[:, None] + SHIFT_PRIOR))


def _lowest(places: Float[ndarray, " K"], costs: Float[ndarray, " K"]) -> float:
    """Where the parabola through the lowest of equally spaced places and its neighbours is lowest."""
    at = int(np.clip(np.argmin(costs), 1, len(costs) - 2))
    before, here, after = costs[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    offset = 0.0 if bend <= 0 else float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0))
    return float(places[at] + offset * (places[1] - places[0]))


@dataclass(frozen=True)
class _Scene:
    """All frames of one eye: colours, eye-plane coordinates of the pixels, and lids as polynomials.

    `weight`: whether a pixel is in the ellipse from corner to corner that E1, E2 and E3 cover together. `place_by` maps
    curve points to polynomial coefficients.
    """

    red: Float[ndarray, "T N"]
    bias: Float[ndarray, "T N"]
    u: Float[ndarray, "T N"]
    v: Float[ndarray, "T N"]
    weight: Float[ndarray, "T N"]
    slope: Float[ndarray, "T 2"]
    lids: EyelidModel
    axes: Float[ndarray, " 3"]
    plane_m: float
    shift: Float[ndarray, "T 2"]
    lid_size: float = 1.0
    iris_size: float = 1.0

    @classmethod
    def of(cls, images: EyeImages, eye: int, lids: EyelidModel) -> _Scene:
        frames, (height, width) = len(images.pixels), images.pixels[0].shape[:2]
        colours = np.stack(images.pixels).reshape(frames, -1, 3).astype(np.float32) / np.float32(255.0)
        columns, rows = (each.ravel() for each in np.meshgrid(np.arange(width), np.arange(height)))
        places = (
            images.origin[:, None]
            + columns[:, None] * images.step[:, None, 0]
            + rows[:, None] * images.step[:, None, 1]
        ).astype(np.float32)
        scene = cls(
            red=colours[..., 0],
            bias=red_bias(colours, DARK_OFFSET).astype(np.float32),
            u=places[..., 0],
            v=places[..., 1],
            weight=np.ones(places.shape[:2], np.float32),
            slope=images.slope.astype(np.float32),
            lids=lids,
            axes=TEMPORAL_AXES[eye],
            plane_m=PLANE_M,
            shift=np.zeros((frames, 2), np.float32),
        )
        return scene._masked()

    def _masked(self) -> _Scene:
        """With the ellipse of the regions, which follows size and shift."""
        corners = self.lids.rest[UPPER][[0, -1]] * self.axes
        ends = corners[:, :2] + (corners[:, 2:] - self.plane_m) * self.slope[:, None] + self.shift[:, None]
        middle, half = ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / 2.0
        x, y = self.u - middle[:, :1], self.v - middle[:, 1:]
        reach = np.linalg.norm(half, axis=1, keepdims=True)
        along = (x * half[:, :1] + y * half[:, 1:]) / reach**2
        across = (y * half[:, :1] - x * half[:, 1:]) / reach / REGION_HALF_HEIGHT_M
        return replace(self, weight=(along**2 + across**2 < 1.0).astype(np.float32))

    def sized(self, *, lid_size: float | None = None, iris_size: float | None = None) -> _Scene:
        """With other sizes of the opening and the iris."""
        lid, iris = lid_size or self.lid_size, iris_size or self.iris_size
        return replace(self, lid_size=lid, iris_size=iris)._masked()

    def shifted(self, shift: Float[ndarray, "T 2"]) -> _Scene:
        """With the eye elsewhere in its plane."""
        return replace(self, shift=shift.astype(np.float32))._masked()

    def opening(
        self,
        angles: Float[ndarray, "T 2"],
        closure: Float[ndarray, " T"],
        shift: Float[ndarray, "T 2"] | None = None,
        margin_m: float = 0.0,
    ) -> Float[ndarray, "T N"]:
        """Fraction of each pixel between the lids (E1 and E2), at least `margin_m` below the upper one."""
        shift = self.shift if shift is None else shift
        curves = self.lids.curves(angles, closure)[:, UPPER.start : LOWER.stop] * self.axes * self.lid_size
        flat = curves[..., :2] + (curves[..., 2:] - self.plane_m) * self.slope[:, None] + shift[:, None]
        ends = (flat[:, [0, UPPER.stop - 1]] + flat[:, [LOWER.start, LOWER.stop - 1]]) / 2.0
        inner, outer = ends[:, 0], ends[:, 1]
        chord = outer - inner
        length = np.linalg.norm(chord, axis=1)
        way, sign = chord / length[:, None], self.axes[0]
        normal = np.stack([-way[:, 1], way[:, 0]], axis=-1) * sign
        left = flat - inner[:, None]
        along = np.einsum("tpd,td->tp", left, way) / length[:, None]
        height = np.einsum("tpd,td->tp", left, normal)
        x, y = self.u - inner[:, :1].astype(np.float32), self.v - inner[:, 1:].astype(np.float32)
        cast = [each.astype(np.float32) for each in (way / length[:, None], normal)]
        place = x * cast[0][:, :1] + y * cast[0][:, 1:]
        above = x * cast[1][:, :1] + y * cast[1][:, 1:]
        inside = np.clip(place, 0.0, 1.0)
        upper = _polynomial(along[:, UPPER], height[:, UPPER], inside)
        lower = _polynomial(along[:, LOWER], height[:, LOWER], inside)
        gap = np.minimum(upper - above - np.float32(margin_m), above - lower)
        ends_m = np.minimum(place, 1.0 - place) * length[:, None].astype(np.float32)
        covered = np.clip(np.minimum(gap, ends_m) * np.float32(PX_PER_M) + np.float32(0.5), 0.0, 1.0)
        return np.asarray(covered * self.weight)

    def iris(self, angles: Float[ndarray, "T 2"]) -> Float[ndarray, "T N"]:
        """Fraction of each pixel in the iris circle, whether or not the lids cover it."""
        gaze = angles_to_direction(angles).astype(np.float32)
        depth, radius = np.float32(IRIS_CENTRE_M * self.iris_size), np.float32(IRIS_RADIUS_M * self.iris_size)
        u, v = self.u - self.shift[:, :1], self.v - self.shift[:, 1:]
        gx, gy, gz = (gaze[:, axis, None] for axis in range(3))
        dx, dy = self.slope[:, :1], self.slope[:, 1:]
        behind = np.float32(self.plane_m)
        ahead = (depth - gx * u - gy * v - gz * behind) / (gz - gx * dx - gy * dy)
        x, y, z = u - ahead * dx - depth * gx, v - ahead * dy - depth * gy, behind + ahead - depth * gz
        away = np.sqrt(x * x + y * y + z * z)
        return np.asarray(np.clip((radius - away) * np.float32(PX_PER_M) + np.float32(0.5), 0.0, 1.0))

    def bias_residual(self, opening: Float[ndarray, "T N"]) -> tuple[Float[ndarray, "T N"], Float[ndarray, " T"]]:
        """(2) as least squares: the red bias minus its means in E3 and in E1 and E2; the energy is its mean square,
        relative to the variance of the bias, which for an opening that is redder than the skin counts fully."""
        skin = self.weight - opening
        inner, outer = opening.sum(axis=1) + 1e-3, skin.sum(axis=1) + 1e-3
        eye, face = (self.bias * opening).sum(axis=1) / inner, (self.bias * skin).sum(axis=1) / outer
        total = (self.bias * self.weight).sum(axis=1) / (inner + outer)
        wrong = eye > face
        eye, face = np.where(wrong, total, eye), np.where(wrong, total, face)
        residual = (self.bias - face[:, None]) * self.weight + opening * (face - eye)[:, None]
        spread = np.maximum((((self.bias - total[:, None]) ** 2) * self.weight).sum(axis=1), np.float32(1e-9))
        return residual / np.sqrt(spread)[:, None], (residual**2).sum(axis=1) / spread

    def red_residual(
        self, opening: Float[ndarray, "T N"], iris: Float[ndarray, "T N"]
    ) -> tuple[Float[ndarray, "T N"], Float[ndarray, " T"]]:
        """(3): red minus the colours of iris and sclera, in E1 and E2, and its mean square."""
        first, second = opening * iris, opening * (1.0 - iris)
        dark, light = self._colours(first, second)
        residual = opening * (self.red - light[:, None] - iris * (dark - light)[:, None])
        return residual, (residual**2).sum(axis=1) / (opening.sum(axis=1) + 1e-3)

    def _colours(self, first: Float[ndarray, "T N"], second: Float[ndarray, "T N"]) -> tuple[ndarray, ndarray]:
        """Mean red of iris and sclera; the same where the iris would be the lighter one."""
        one, two = first.sum(axis=1), second.sum(axis=1)
        reds = (self.red * first).sum(axis=1), (self.red * second).sum(axis=1)
        both = (reds[0] + reds[1]) / (one + two + 1e-3)
        dark, light = (reds[0] + both) / (one + 1.0), (reds[1] + both) / (two + 1.0)
        wrong = dark > light
        return np.where(wrong, both, dark), np.where(wrong, both, light)

    def energies_by_height(self, angles: Float[ndarray, "T 2"], closure: Float[ndarray, " T"]) -> Float[ndarray, "T K"]:
        """(2) of each frame with the eye shifted upwards by each of HEIGHTS_M."""
        shifts = [self.shift + np.array([0.0, height], np.float32) for height in HEIGHTS_M]
        return np.stack([self.bias_residual(self.opening(angles, closure, each))[1] for each in shifts], axis=1)

    def register(
        self, angles: Float[ndarray, "T 2"], closure: Float[ndarray, " T"], height_m: float
    ) -> tuple[Float[ndarray, "T 2"], Float[ndarray, " T"]]:
        """Upward shift and closure that minimise (2) together at a given gaze, from a first shift by `height_m`."""
        first = self.shifted(self.shift + np.array([0.0, height_m], np.float32))
        state = np.column_stack([first.shift[:, 1], first.best_closure(angles, closure)])

        def moved(state: ndarray) -> tuple[ndarray, ndarray]:
            height = np.clip(state[:, 0], -MAX_SHIFT_M, MAX_SHIFT_M)
            return np.column_stack([self.shift[:, 0], height]).astype(np.float32), np.clip(state[:, 1], -0.5, 1.0)

        def residual(state: ndarray) -> tuple[ndarray, ndarray]:
            shift, closure = moved(state)
            return self.bias_residual(self.opening(angles, closure, shift))

        damping = np.array([1e-3 / MAX_SHIFT_M**2, 1e-3])
        state, _, _ = _gauss_newton(residual, state, np.array([SHIFT_M, STEP_CLOSURE]), damping, rounds=4)
        return moved(state)

    def close(self, angles: Float[ndarray, "T 2"], closure: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """Step two: the closure that minimises (2) at a given gaze and shift, from a first one."""

        def residual(state: ndarray) -> tuple[ndarray, ndarray]:
            return self.bias_residual(self.opening(angles, np.clip(state[:, 0], -0.5, 1.0)))

        state, _, _ = _gauss_newton(residual, closure[:, None], np.array([STEP_CLOSURE]), np.array([1e-4]), rounds=3)
        return np.asarray(np.clip(state[:, 0], -0.5, 1.0))

    def best_closure(self, angles: Float[ndarray, "T 2"], closure: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """The closure of a grid that minimises (2), not far from a first estimate."""
        energies = [
            self.bias_residual(self.opening(angles, np.full(len(angles), each)))[1]
            + CLOSURE_PRIOR * (each - closure) ** 2
            for each in CLOSURES
        ]
        return np.asarray(CLOSURES[np.argmin(energies, axis=0)])

    def look(
        self,
        angles: Float[ndarray, "T 2"],
        closure: Float[ndarray, " T"],
        starts: Float[ndarray, "K 2"] = STARTS_RAD,
        rounds: int = 5,
    ) -> tuple[Float[ndarray, "T 2"], Float[ndarray, " T"], Float[ndarray, " T"]]:
        """Step three: the gaze that minimises (3) with the opening held fixed, the energy, and the sd of gaze."""
        opening = self.opening(angles, closure, margin_m=SHADOW_M)

        def residual(state: ndarray) -> tuple[ndarray, ndarray]:
            return self.red_residual(opening, self.iris(np.clip(state, *LIMITS_RAD)))

        tried = [np.clip(angles + start, *LIMITS_RAD) for start in starts]
        best = (
            np.argmin([residual(each)[1] for each in tried], axis=0) if len(tried) > 1 else np.zeros(len(angles), int)
        )
        state = np.stack(tried)[best, np.arange(len(angles))]
        steps = np.full(2, STEP_RAD)
        state, energy, curvature = _gauss_newton(residual, state, steps, np.full(2, 1e-6), rounds)
        left = energy * opening.sum(axis=1)
        noise = left / np.maximum(opening.sum(axis=1) - 4.0, 1.0) * RESIDUAL_CORRELATION_PX
        covariance = noise[:, None, None] * np.linalg.inv(curvature + 1e-9 * np.eye(2))
        sd = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        return np.clip(state, *LIMITS_RAD), energy, sd

    def reasons(
        self, angles: Float[ndarray, "T 2"], closure: Float[ndarray, " T"], sd: Float[ndarray, " T"]
    ) -> tuple[str, ...]:
        """Why the gaze of a frame cannot be trusted; the first that applies."""
        opening, iris = self.opening(angles, closure), self.iris(angles)
        skin = self.weight - opening
        bias = (self.bias * skin).sum(axis=1) / (skin.sum(axis=1) + 1e-3)
        bias -= (self.bias * opening).sum(axis=1) / (opening.sum(axis=1) + 1e-3)
        dark, light = self._colours(opening * iris, opening * (1.0 - iris))
        area = np.pi * (IRIS_RADIUS_M * self.iris_size * PX_PER_M) ** 2
        limits = np.abs(angles - np.clip(angles, *(0.98 * LIMITS_RAD))).max(axis=1) > 0
        tests = {
            "nearly shut": closure > NEARLY_SHUT,
            "no contrast to the skin": bias < MIN_BIAS_CONTRAST,
            "iris covered": (opening * iris).sum(axis=1) < MIN_VISIBLE_IRIS * area,
            "no iris found": (light - dark < MIN_IRIS_CONTRAST) | limits,
            "gaze uncertain": sd > MAX_SD_RAD,
        }
        return tuple(next((name for name, hit in tests.items() if hit[t]), "") for t in range(len(angles)))


def _polynomial(
    along: Float[ndarray, "T K"], height: Float[ndarray, "T K"], place: Float[ndarray, "T N"]
) -> Float[ndarray, "T N"]:
    """The polynomial of a lid through its points (least squares), at places between the corners (0 and 1)."""
    # The points move little along the opening, so that one matrix of the mean places serves all frames.
    powers = np.vander(along.mean(axis=0), DEGREE + 1)
    found = (height @ np.linalg.pinv(powers).T).astype(np.float32)
    value = np.broadcast_to(found[:, :1], place.shape)
    for power in range(1, DEGREE + 1):
        value = value * place + found[:, power, None]
    return np.asarray(value)


def _gauss_newton(
    residual: Callable[[ndarray], tuple[Float[ndarray, "T N"], Float[ndarray, " T"]]],
    state: Float[ndarray, "T P"],
    steps: Float[ndarray, " P"],
    damping: Float[ndarray, " P"],
    rounds: int,
) -> tuple[Float[ndarray, "T P"], Float[ndarray, " T"], Float[ndarray, "T P P"]]:
    """Minimise the energy of each frame; a step that raises it is halved. Also gives J^T J at the last state."""
    here, energy = residual(state)
    scale = np.ones(len(state))
    curvature = np.zeros((len(state), state.shape[1], state.shape[1]))
    for _ in range(rounds):
        slopes = np.stack([(residual(state + step)[0] - here) / step.max() for step in np.diag(steps)], axis=-1)
        curvature = np.einsum("tnp,tnq->tpq", slopes, slopes).astype(np.float64)
        gradient = np.einsum("tnp,tn->tp", slopes, here).astype(np.float64)
        bend = np.einsum("tpp->tp", curvature)
        system = curvature + np.einsum("tp,pq->tpq", 1e-3 * bend + damping, np.eye(len(steps)))
        change = -np.linalg.solve(system, gradient[..., None])[..., 0]
        change = np.clip(change, -12.0 * steps, 12.0 * steps)
        trial = state + scale[:, None] * change
        there, value = residual(trial)
        better = value < energy
        state = np.where(better[:, None], trial, state)
        here, energy = np.where(better[:, None], there, here), np.where(better, value, energy)
        scale = np.where(better, np.minimum(1.0, 1.5 * scale), 0.4 * scale)
    return state, energy, curvature
