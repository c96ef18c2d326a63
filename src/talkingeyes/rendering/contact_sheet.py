"""Contact sheets of a head: motions at several times, and the range of eyes and lids."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.head.model import HeadModel
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS

GAZE_YAW_DEG, GAZE_PITCH_DEG = (
    (-25.0, 0.0, 25.0),
    (18.0, 0.0, -20.0),
)  # columns and rows; the subject's left is the image's right
LID_CLOSURES = (-0.3, 0.0, 0.35, 0.7, 1.0)  # from wide to shut


def contact_sheet(model: HeadModel, motions: list[Motion], times_s: list[float], size: int) -> UInt8[ndarray, "H W 3"]:
    """An image grid with one row per motion and one column per time."""
    renderer = HeadRenderer(model, FRAMINGS["head"].centred_on(model.eye_centres).view(size, size))
    rows = []
    for motion in motions:
        frames = [min(round(time_s * motion.fps), len(motion) - 1) for time_s in times_s]
        rows.append(np.concatenate([next(renderer.draw(motion.cut(frame, frame + 1))) for frame in frames], axis=1))
    return np.concatenate(rows, axis=0)


def eyes_sheet(model: HeadModel, width: int) -> UInt8[ndarray, "H W 3"]:
    """The head with its eyes in nine directions, above the eyes at five lid closures.

    The image width is `width`, rounded down to whole tiles.
    """
    side = width * 4 // 17
    tall = 3 * (side * 9 // 20)
    eyes = HeadRenderer(model, FRAMINGS["eyes"].centred_on(model.eye_centres).view(side, tall // 3))
    yaw, pitch = np.meshgrid(GAZE_YAW_DEG, GAZE_PITCH_DEG)
    looks = list(eyes.draw(static_motion(gaze_deg=np.stack([yaw.ravel(), pitch.ravel()], axis=-1))))
    nine = np.concatenate([np.concatenate(looks[row : row + 3], axis=1) for row in (0, 3, 6)], axis=0)
    whole = HeadRenderer(model, FRAMINGS["head"].centred_on(model.eye_centres).view(width - 3 * side, tall)).draw(
        static_motion()
    )
    upper = np.concatenate([next(whole), nine], axis=1)
    fifth = width // len(LID_CLOSURES)
    lids = HeadRenderer(model, FRAMINGS["eyes"].centred_on(model.eye_centres).view(fifth, fifth * 9 // 20)).draw(
        static_motion(lid=np.array(LID_CLOSURES))
    )
    lower = np.concatenate(list(lids), axis=1)
    return np.concatenate([upper[:, : lower.shape[1]], lower], axis=0)


def static_motion(gaze_deg: Float[ndarray, "T 2"] | None = None, lid: Float[ndarray, " T"] | None = None) -> Motion:
    """Still frames of a head facing the camera: both eyes at (yaw, pitch), both lids at a closure."""
    frames = len(gaze_deg) if gaze_deg is not None else len(lid) if lid is not None else 1
    angles = np.zeros((frames, 2)) if gaze_deg is None else np.radians(gaze_deg)
    closure = np.zeros(frames) if lid is None else lid
    gaze = np.repeat(angles_to_gaze(angles)[:, None], 2, axis=1)
    return Motion.of(25.0, np.zeros((frames, 3)), gaze, lid=np.repeat(closure[:, None], 2, axis=1))
