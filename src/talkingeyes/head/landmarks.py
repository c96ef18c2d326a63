"""A plain analytic face: named 3D points in metres that follow gaze, lids and jaw.

The origin of head coordinates is the head joint, between the ears at the top of the neck; the head turns about it and
then moves by its translation. Axes: +x to the subject's left, y up, +z out of the face. Eyes: left, right.
Measures: eyeball and pupil of FLAME, fissure 27.3 x 9.1 mm, neutral eye aspect ratio .33 (FACTS, sections 4 and 7); the
rest is an average adult face. Lids: the upper lid follows the eye down with gain 1 and up with .8, the lower lid with
.35 (section 5), both as angles on the eyeball, so 20 degrees of down-gaze lower the upper lid by 4.3 mm.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.rotation import angles_of_gaze, directions, matrices

EYE_CENTRES = np.array([[0.03145, 0.040, 0.075], [-0.03145, 0.040, 0.075]])
EYEBALL_RADIUS_M = 0.0126
PUPIL_M = 0.0133  # from the eye's centre to the pupil, along the optical axis
JAW_HINGE = np.array([0.0, 0.018, 0.012])

FISSURE_WIDTH_M = 0.0273
UPPER_LID_M, LOWER_LID_M = 0.0049, -0.0042  # heights over the eye's centre, gaze straight ahead
UPPER_GAIN_DOWN, UPPER_GAIN_UP, LOWER_GAIN = 1.0, 0.8, 0.35
UPPER_TRAVEL = 0.9  # share of a closure that the upper lid makes; the lower lid rises by the rest
LIMIT_RAD = 1.1  # of a lid on the eyeball

SIDES = ("left", "right")
EYE_POINTS = (
    "outer",
    "upper_outer",
    "upper_inner",
    "inner",
    "lower_inner",
    "lower_outer",
)  # p1 to p6

# Point of the subject's left half: (x, y, z) at rest and how far it follows the jaw. A right half mirrors it.
_PAIRED = {
    "brow_outer": (0.052, 0.058, 0.075, 0.0),
    "brow_middle": (0.032, 0.064, 0.090, 0.0),
    "brow_inner": (0.012, 0.058, 0.094, 0.0),
    "nose_wing": (0.017, -0.006, 0.095, 0.0),
    "mouth_corner": (0.025, -0.035, 0.088, 0.5),
    "outline_temple": (0.072, 0.055, 0.030, 0.0),
    "outline_ear": (0.0715, 0.030, 0.025, 0.0),
    "outline_lobe": (0.069, 0.005, 0.022, 0.2),
    "outline_angle": (0.064, -0.020, 0.025, 0.6),
    "outline_jaw_back": (0.056, -0.042, 0.035, 0.9),
    "outline_jaw": (0.042, -0.059, 0.055, 1.0),
    "outline_jaw_front": (0.022, -0.070, 0.075, 1.0),
}
_MIDDLE = {
    "nose_bridge": (0.0, 0.044, 0.092, 0.0),
    "nose_middle": (0.0, 0.022, 0.103, 0.0),
    "nose_tip": (0.0, 0.000, 0.117, 0.0),
    "nose_base": (0.0, -0.012, 0.103, 0.0),
    "upper_lip": (0.0, -0.028, 0.100, 0.0),
    "upper_lip_inner": (0.0, -0.0355, 0.098, 0.0),
    "lower_lip_inner": (0.0, -0.0362, 0.0975, 1.0),
    "lower_lip": (0.0, -0.044, 0.097, 1.0),
    "outline_chin": (0.0, -0.073, 0.085, 1.0),
}
_MIRROR = np.array([-1.0, 1.0, 1.0])
_EYE_NAMES = tuple(f"{side}_eye_{point}" for side in SIDES for point in EYE_POINTS)
_FACE = {
    **{f"left_{name}": np.array(row) for name, row in _PAIRED.items()},
    **{f"right_{name}": np.array([-row[0], *row[1:]]) for name, row in _PAIRED.items()},
    **{name: np.array(row) for name, row in _MIDDLE.items()},
}
_FACE_POINTS = np.stack(list(_FACE.values()))

NAMES: tuple[str, ...] = (*_EYE_NAMES, *_FACE)
EYES = np.arange(12).reshape(2, 6)  # indices into NAMES: eye, then p1 to p6 of the aspect ratio (Soukupova & Cech 2016)
RIGID = np.array(  # indices into NAMES of the points that neither lids nor jaw nor brows move
    [
        NAMES.index(name)
        for name in NAMES
        if name.endswith(("eye_outer", "eye_inner", "nose_wing", "temple", "outline_ear")) or name.startswith("nose_")
    ]
)
OUTLINE = np.array(  # indices into NAMES, from the subject's left temple over the chin to the right temple
    [NAMES.index(f"left_{name}") for name in _PAIRED if name.startswith("outline")]
    + [NAMES.index("outline_chin")]
    + [NAMES.index(f"right_{name}") for name in reversed(_PAIRED) if name.startswith("outline")]
)


def landmarks(
    gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"], jaw: Float[ndarray, "T 3"]
) -> Float[ndarray, "T L 3"]:
    """All points of NAMES in head coordinates, metres."""
    eyes = eye_points(angles_of_gaze(gaze)[..., 1], lid)
    return np.concatenate([eyes.reshape(len(gaze), 12, 3), _face_points(jaw)], axis=1)


def eye_points(pitch_rad: Float[ndarray, "T 2"], lid: Float[ndarray, "T 2"]) -> Float[ndarray, "T 2 6 3"]:
    """Corners and lid points p1 to p6 of both eyes at an eye-in-head pitch (positive up) and a closure."""
    upper, lower = lid_angles(pitch_rad, lid)
    heights = EYEBALL_RADIUS_M * np.sin(np.stack([upper, upper, lower, lower], axis=-1))
    across = FISSURE_WIDTH_M / 6 * np.array([1.0, -1.0, -1.0, 1.0])
    depths = np.sqrt(np.maximum(EYEBALL_RADIUS_M**2 - across**2 - heights**2, 0.0))
    lids = np.stack([np.broadcast_to(across, heights.shape), heights, depths], axis=-1)
    points = np.empty((*pitch_rad.shape, 6, 3))
    points[:, :, 0] = [FISSURE_WIDTH_M / 2, 0.0005, 0.004]
    points[:, :, 3] = [-FISSURE_WIDTH_M / 2, -0.0005, 0.008]
    points[:, :, [1, 2, 4, 5]] = lids
    points[:, 1] *= _MIRROR
    return np.asarray(points + EYE_CENTRES[:, None])


def lid_angles(
    pitch_rad: Float[ndarray, "T 2"], lid: Float[ndarray, "T 2"]
) -> tuple[Float[ndarray, "T 2"], Float[ndarray, "T 2"]]:
    """Elevation of the upper and lower lid on the eyeball: what gaze alone gives, then closed by `lid` (1 is shut)."""
    gain = np.where(pitch_rad < 0, UPPER_GAIN_DOWN, UPPER_GAIN_UP)
    upper = np.clip(np.arcsin(UPPER_LID_M / EYEBALL_RADIUS_M) + gain * pitch_rad, -LIMIT_RAD, LIMIT_RAD)
    lower = np.clip(np.arcsin(LOWER_LID_M / EYEBALL_RADIUS_M) + LOWER_GAIN * pitch_rad, -LIMIT_RAD, LIMIT_RAD)
    opening = np.maximum(upper - lower, 0.0)
    return upper - UPPER_TRAVEL * lid * opening, lower + (1 - UPPER_TRAVEL) * lid * opening


def pupils(gaze: Float[ndarray, "T 2 3"]) -> Float[ndarray, "T 2 3"]:
    """Pupil centres in head coordinates, metres."""
    return np.asarray(EYE_CENTRES + PUPIL_M * directions(gaze))


def in_camera(
    points: Float[ndarray, "T K 3"], head: Float[ndarray, "T 3"], translation: Float[ndarray, "T 3"]
) -> Float[ndarray, "T K 3"]:
    """Points in head coordinates after the head has turned about its joint and moved; what `Camera.project` takes."""
    return np.asarray(np.einsum("tij,tkj->tki", matrices(head), points) + translation[:, None])


def _face_points(jaw: Float[ndarray, "T 3"]) -> Float[ndarray, "T F 3"]:
    """Brows, nose, mouth, outline. A point follows the jaw by turning about the hinge with its share of the angle."""
    rest, share = _FACE_POINTS[:, :3], _FACE_POINTS[:, 3]
    turn = matrices(jaw[:, None] * share[:, None])
    return np.asarray(np.einsum("tkij,kj->tki", turn, rest - JAW_HINGE) + JAW_HINGE)
