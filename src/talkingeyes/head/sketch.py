"""A plain drawing of a motion: a head that turns, two eyes with lids, a mouth. No model file, no GPU.

The points are those of `landmarks`, projected by a pinhole camera; skull, hairline, ears and cheeks are shapes in the
same head coordinates, so a turn shows as it would on a face. Drawn by Pillow at three times the size and averaged down.
The subject's left is on the right of the picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image, ImageDraw
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull

from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import EYE_CENTRES, EYEBALL_RADIUS_M, EYES, NAMES, OUTLINE, in_camera, landmarks
from talkingeyes.motion import Motion
from talkingeyes.rotation import matrices

OVERSAMPLING = 3
BLOCK_FRAMES = 256
FIELD_M, DISTANCE_M, MIDDLE_Y_M = 0.30, 1.2, 0.035  # what the picture spans at the head, from where, and around what
IRIS_M, PUPIL_M = 0.0059, 0.0025

PAPER, SHIRT, SKIN, SHADE = (244, 243, 239), (108, 124, 140), (238, 206, 184), (216, 176, 152)
HAIR, LINE, WHITE, IRIS = (88, 68, 58), (120, 78, 64), (253, 252, 250), (78, 122, 150)
PUPIL, LIP, MOUTH = (24, 24, 28), (196, 112, 106), (104, 42, 44)


def _circle(count: int) -> Float[ndarray, "N 2"]:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _skull() -> Float[ndarray, "N 3"]:
    around, along = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(-np.pi / 2, np.pi / 2, 25))
    ring = np.cos(along)
    unit = np.stack([ring * np.cos(around), np.sin(along), ring * np.sin(around)], axis=-1).reshape(-1, 3)
    return unit * [0.080, 0.092, 0.094] + [0.0, 0.062, -0.004]


def _eye_disc(radius_m: float) -> Float[ndarray, "N 3"]:
    """A circle on the eyeball around the direction of gaze, in eye coordinates."""
    depth = np.sqrt(EYEBALL_RADIUS_M**2 - radius_m**2)
    return np.concatenate([_circle(24) * radius_m, np.full((24, 1), depth)], axis=1)


SKULL = _skull()
HAIRLINE = np.array(
    [[-0.074, 0.060, 0.030], [-0.060, 0.096, 0.056], [0.0, 0.108, 0.078], [0.060, 0.096, 0.056], [0.074, 0.060, 0.030]]
)
# What stands out between the outline and the middle: it shows beyond the outline when the head turns.
CHEEKS = np.array(
    [
        [side * x, y, z]
        for side in (1, -1)
        for x, y, z in ((0.058, 0.010, 0.066), (0.050, 0.030, 0.078), (0.046, 0.075, 0.080), (0.040, -0.030, 0.078))
    ]
)
EARS = np.stack(
    [[[side * (0.074 + 0.008 * c), 0.026 + 0.021 * s, 0.008 + 0.004 * c] for c, s in _circle(16)] for side in (1, -1)]
)
NECK = np.array([[-0.052, -0.03, -0.01], [0.052, -0.03, -0.01], [0.058, -0.16, -0.02], [-0.058, -0.16, -0.02]])
SHOULDERS = np.array(
    [
        [-0.05, -0.102, 0.0],
        [0.05, -0.102, 0.0],
        [0.17, -0.13, 0.0],
        [0.2, -0.3, 0.0],
        [-0.2, -0.3, 0.0],
        [-0.17, -0.13, 0.0],
    ]
)
NOSE = [NAMES.index(name) for name in ("right_nose_wing", "nose_base", "left_nose_wing")]
BRIDGE = [NAMES.index(name) for name in ("nose_bridge", "nose_middle", "nose_tip", "nose_base")]
BROWS = [[NAMES.index(f"{side}_brow_{at}") for at in ("inner", "middle", "outer")] for side in ("left", "right")]
MOUTH_CURVES = {
    name: [NAMES.index(point) for point in ("right_mouth_corner", name, "left_mouth_corner")]
    for name in ("upper_lip", "upper_lip_inner", "lower_lip_inner", "lower_lip")
}


def _spline(points: int, samples: int) -> Float[ndarray, "M N"]:
    """The matrix that turns `points` knots into `samples` points of the natural cubic through them."""
    return np.asarray(
        CubicSpline(np.arange(points), np.eye(points), bc_type="natural")(np.linspace(0, points - 1, samples))
    )


FACE_CURVE = _spline(len(OUTLINE) + len(HAIRLINE), 72)
LID_CURVE = _spline(4, 13)
ARC = _spline(3, 9)


@dataclass(frozen=True)
class Shapes:
    """What one frame shows, in pixels of the picture (oversampled)."""

    silhouette: Float[ndarray, "K 2"]
    face: Float[ndarray, "F 2"]
    points: Float[ndarray, "L 2"]
    ears: Float[ndarray, "2 16 2"]
    neck: Float[ndarray, "4 2"]
    shoulders: Float[ndarray, "6 2"]
    irises: Float[ndarray, "2 24 2"]
    pupils: Float[ndarray, "2 24 2"]


def draw(motion: Motion, size: int) -> Iterator[UInt8[ndarray, "size size 3"]]:
    """The frames of a motion as pictures of size x size."""
    for start in range(0, len(motion), BLOCK_FRAMES):
        for shapes in _shapes(motion.cut(start, start + BLOCK_FRAMES), size * OVERSAMPLING):
            yield _picture(shapes, size)


def contact_sheet(motions: list[Motion], times_s: list[float], size: int) -> UInt8[ndarray, "H W 3"]:
    """One row a motion, one column a time: the drawings side by side."""
    rows = []
    for motion in motions:
        frames = [min(round(time_s * motion.fps), len(motion) - 1) for time_s in times_s]
        rows.append(np.concatenate([next(draw(motion.cut(frame, frame + 1), size)) for frame in frames], axis=1))
    return np.concatenate(rows, axis=0)


def _shapes(motion: Motion, size: int) -> Iterator[Shapes]:
    frames = len(motion)
    focal = size * DISTANCE_M / FIELD_M
    camera = Camera(focal, (size / 2, size / 2 + MIDDLE_Y_M * size / FIELD_M), DISTANCE_M, size, size)

    def on_head(points: ndarray) -> ndarray:
        every = np.broadcast_to(points, (frames, *points.shape[-2:])) if points.ndim == 2 else points
        return camera.project(in_camera(every, motion.head, motion.translation))

    def disc(radius_m: float) -> ndarray:
        turned = np.einsum("teij,kj->teki", matrices(motion.gaze), _eye_disc(radius_m)) + EYE_CENTRES[:, None]
        return on_head(turned.reshape(frames, -1, 3)).reshape(frames, 2, -1, 2)

    points = on_head(landmarks(motion.gaze, motion.lid, motion.jaw))
    skull, hairline, cheeks = (on_head(each) for each in (SKULL, HAIRLINE, CHEEKS))
    irises, pupils = disc(IRIS_M), disc(PUPIL_M)
    ears = on_head(EARS.reshape(-1, 3)).reshape(frames, 2, -1, 2)
    # The neck follows the head a little, the shoulders only where the head goes.
    neck = camera.project(in_camera(np.broadcast_to(NECK, (frames, 4, 3)), motion.head * 0.3, motion.translation))
    body = np.broadcast_to(SHOULDERS, (frames, 6, 3)) + motion.translation[:, None]
    shoulders = camera.project(body)
    for t in range(frames):
        outline = FACE_CURVE @ np.concatenate([points[t, OUTLINE], hairline[t]])
        face = _hull(np.concatenate([outline, cheeks[t]]))
        silhouette = _hull(np.concatenate([skull[t], face]))
        yield Shapes(silhouette, face, points[t], ears[t], neck[t], shoulders[t], irises[t], pupils[t])


def _hull(points: Float[ndarray, "K 2"]) -> Float[ndarray, "H 2"]:
    return np.asarray(points[ConvexHull(points).vertices])


def _picture(shapes: Shapes, size: int) -> UInt8[ndarray, "size size 3"]:
    side = size * OVERSAMPLING
    image = Image.new("RGB", (side, side), PAPER)
    pen = ImageDraw.Draw(image)
    width = max(1, round(side / 160))
    _polygon(pen, shapes.neck, SHADE)
    _polygon(pen, shapes.shoulders, SHIRT)
    _polygon(pen, shapes.silhouette, HAIR)
    for ear in shapes.ears:
        _polygon(pen, ear, SHADE)
    _polygon(pen, shapes.face, SKIN)
    _nose(pen, shapes.points, width)
    for brow in BROWS:
        _line(pen, ARC @ shapes.points[brow], HAIR, 2 * width)
    _mouth(pen, shapes.points, width)
    for eye in range(2):
        _eye(image, pen, shapes, eye, width)
    return np.asarray(image.reduce(OVERSAMPLING))


def _nose(pen: ImageDraw.ImageDraw, points: Float[ndarray, "L 2"], width: int) -> None:
    bridge, wings = points[BRIDGE], points[NOSE]
    # The shaded side is the one that the tip has moved towards: it hides that cheek.
    shift = float(bridge[2, 0] - (wings[0, 0] + wings[2, 0]) / 2)
    _polygon(pen, np.stack([bridge[0], bridge[2], wings[2] if shift > 0 else wings[0]]), SHADE)
    _line(pen, ARC @ np.stack([wings[0], (bridge[2] + bridge[3]) / 2, wings[2]]), LINE, width)


def _mouth(pen: ImageDraw.ImageDraw, points: Float[ndarray, "L 2"], width: int) -> None:
    upper, upper_inner, lower_inner, lower = (ARC @ points[rows] for rows in MOUTH_CURVES.values())
    _polygon(pen, np.concatenate([upper, lower[::-1]]), LIP)
    _polygon(pen, np.concatenate([upper_inner, lower_inner[::-1]]), MOUTH)
    _line(pen, upper_inner, MOUTH, max(1, width // 2))


def _eye(image: Image.Image, pen: ImageDraw.ImageDraw, shapes: Shapes, eye: int, width: int) -> None:
    """The white with iris and pupil, cut out by the lids."""
    outer, upper_outer, upper_inner, inner, lower_inner, lower_outer = shapes.points[EYES[eye]]
    upper = LID_CURVE @ np.stack([outer, upper_outer, upper_inner, inner])
    lower = LID_CURVE @ np.stack([outer, lower_outer, lower_inner, inner])
    opening = np.concatenate([upper, np.maximum(lower, upper)[::-1]])
    left, top = np.floor(opening.min(axis=0)).astype(int) - 1
    right, bottom = np.ceil(opening.max(axis=0)).astype(int) + 2
    corner = np.array([left, top])
    ball = Image.new("RGB", (right - left, bottom - top), WHITE)
    inside = ImageDraw.Draw(ball)
    _polygon(inside, shapes.irises[eye] - corner, IRIS)
    _polygon(inside, shapes.pupils[eye] - corner, PUPIL)
    mask = Image.new("L", ball.size, 0)
    ImageDraw.Draw(mask).polygon([tuple(point) for point in (opening - corner).tolist()], fill=255)
    image.paste(ball, (int(left), int(top)), mask)
    _line(pen, lower, SHADE, width)
    _line(pen, upper, HAIR, round(1.5 * width))


def _polygon(pen: ImageDraw.ImageDraw, points: Float[ndarray, "K 2"], colour: tuple[int, int, int]) -> None:
    pen.polygon([tuple(point) for point in points.tolist()], fill=colour)


def _line(pen: ImageDraw.ImageDraw, points: Float[ndarray, "K 2"], colour: tuple[int, int, int], width: int) -> None:
    pen.line([tuple(point) for point in points.tolist()], fill=colour, width=width, joint="curve")
