"""Lids and jaw: eye aspect ratio, gain of the lids, fit of the Eyelid model, jaw motion and its relation to sound.

Sources: Becker & Fuchs 1988 (gain of the upper lid), Elisei, Bailly & Casari 2007 (stage one of the Eyelid model,
fitted here to each eye of each speaker), Munhall et al. (jaw and speech envelope).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.detectors.signal import spectrum
from talkingeyes.evaluation.measures.pooled import (
    FrameProsody,
    Measurement,
    PooledArrays,
    in_spans,
    measure_values,
    measurement,
)
from talkingeyes.evaluation.papers.probtalk3d_articulation import best_correlation
from talkingeyes.head import landmarks as face
from talkingeyes.head.eyelid.model import gaze_predictors

UPPER = slice(1, 3)  # of the six points of an eye
EVERY = 4  # frames
BLINK, ROUND_BLINK_S = 0.15, 0.12
MIN_PITCH_DEG = 2.0
JAW_BAND_HZ = (1.0, 10.0)
MIN_FRAMES = 200


def extract_lids(group: str, motion: Motion) -> PooledArrays:
    """Gaze and height of the upper lids (as an angle at the eye centre) in every fourth frame, without blinks.

    `group` names what is fitted together: one person in one emotion.
    """
    above = motion.lid.mean(axis=1) - np.median(motion.lid)
    reach = round(ROUND_BLINK_S * motion.fps)
    blinking = np.convolve(above > BLINK, np.ones(2 * reach + 1), "same") > 0
    chosen = np.flatnonzero(motion.valid & ~blinking)[::EVERY]
    points = face.eye_landmarks(motion.gaze[chosen], motion.lid[chosen])[:, :, UPPER].mean(axis=2)
    ahead = face.eye_landmarks(np.zeros((1, 2, 3)), np.zeros((1, 2)))[:, :, UPPER].mean(axis=2) - face.EYE_CENTRES
    # From height alone: in depth the sculpted lids of the head do not lie on a sphere.
    above_centre = (points - face.EYE_CENTRES)[..., 1] / np.hypot(ahead[..., 1], ahead[..., 2])
    height = np.degrees(np.arcsin(np.clip(above_centre, -1.0, 1.0)))
    angles = gaze_to_angles(motion.gaze[chosen])
    eye = np.broadcast_to(["left", "right"], height.shape)
    return {
        "lid.whose": np.char.add(f"{group} ", eye).ravel(),
        "lid.angles_rad": angles.reshape(-1, 2),
        "lid.height_deg": height.ravel(),
    }


def extract_jaw(
    motion: Motion, behaviour: Behaviour, annotation: Annotation, frame_prosody: FrameProsody
) -> PooledArrays:
    """Jaw opening in speech, its spectrum, and the largest correlation with the envelope over small lags."""
    opening = motion.jaw[:, 0]
    frames = min(len(opening), len(frame_prosody.energy_dbfs))
    power = spectrum(motion.jaw[:, :1], motion.fps, motion.valid)
    speech = in_spans(annotation.speaking, behaviour)
    envelope = 10 ** (frame_prosody.energy_dbfs[:frames] / 20)
    return {
        "jaw.opening_rad": opening[speech][::EVERY],
        "jaw.power": power.power.sum(axis=1)[None],
        "jaw.frequency_hz": power.frequency_hz[None],
        "jaw.r": np.array([best_correlation(opening[:frames], envelope, motion.fps)]),
    }


def eye_aspect_ratio(lid: float) -> float:
    """Eye aspect ratio (Soukupova & Cech 2016) of the open head looking straight ahead, at lid closure `lid`."""
    points = face.eye_landmarks(np.zeros((1, 2, 3)), np.full((1, 2), lid))[0, 0, :, :2]
    upright = np.linalg.norm(points[1] - points[5]) + np.linalg.norm(points[2] - points[4])
    return float(upright / (2 * np.linalg.norm(points[0] - points[3])))


def lid_gains(pool: PooledArrays) -> dict[str, Measurement]:
    """Rotation of the upper lid per rotation of gaze, below and above the horizon, each eye about its mean."""
    pitch, height = np.degrees(pool["lid.angles_rad"][:, 1]), pool["lid.height_deg"]
    gains = {}
    for name, chosen in (("lid_down", pitch < -MIN_PITCH_DEG), ("lid_up", pitch > MIN_PITCH_DEG)):
        x, y = (_about_own(each[chosen], pool["lid.whose"][chosen]) for each in (pitch, height))
        gains[name] = measurement(
            float(x @ y / max(float(x @ x), 1e-12)), int(chosen.sum()), "frames and eyes", MIN_FRAMES
        )
    return gains


def _about_own(values: Float[ndarray, " N"], group: ndarray) -> Float[ndarray, " N"]:
    _, index = np.unique(group, return_inverse=True)
    count = np.maximum(np.bincount(index), 1)
    return np.asarray(values - (np.bincount(index, values) / count)[index])


def lid_r_squared(pool: PooledArrays) -> Measurement:
    """Fraction of the variance of lid height explained by stage one of the Eyelid model, fitted to each eye."""
    inputs, height, group = gaze_predictors(pool["lid.angles_rad"]), pool["lid.height_deg"], pool["lid.whose"]
    left, total, count = 0.0, 0.0, 0
    for each in np.unique(group):
        mine = group == each
        if mine.sum() < MIN_FRAMES:
            continue
        rows = np.column_stack([inputs[mine], np.ones(int(mine.sum()))])
        weights = np.linalg.lstsq(rows, height[mine], rcond=None)[0]
        left += float(np.square(height[mine] - rows @ weights).sum())
        total += float(np.square(height[mine] - height[mine].mean()).sum())
        count += int(mine.sum())
    return measurement(1 - left / max(total, 1e-12) if count else np.nan, count, "frames and eyes", MIN_FRAMES)


def jaw_opening_p95(pool: PooledArrays) -> Measurement:
    """95th percentile of jaw opening in speech, radians."""
    return measure_values(pool["jaw.opening_rad"], lambda opening: np.quantile(opening, 0.95), "frames", MIN_FRAMES)


def jaw_peak_hz(pool: PooledArrays) -> Measurement:
    """Peak frequency of the spectrum of jaw velocity, by a parabola through the three bins around the maximum."""
    frequency, power = pool["jaw.frequency_hz"][0], pool["jaw.power"].sum(axis=0)
    velocity = power * np.square(frequency)
    band = np.flatnonzero((frequency >= JAW_BAND_HZ[0]) & (frequency <= JAW_BAND_HZ[1]))
    top = int(np.clip(band[velocity[band].argmax()], 1, len(frequency) - 2))
    before, here, after = velocity[top - 1 : top + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return measurement(
        float(frequency[top] + shift * frequency[1]) if here > 0 else np.nan, len(pool["jaw.power"]), "clips", 5
    )


def jaw_envelope(pool: PooledArrays) -> Measurement:
    """Mean over clips of the correlation of jaw opening and envelope."""
    return measure_values(pool["jaw.r"], np.mean, "clips", 5)
