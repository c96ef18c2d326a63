"""A take: the complete motion of a speaker for one sound, sampled from the style of the speaker.

Motion depends on the sound only through its annotation, and only through random events. Takes of one sound therefore
differ in everything except articulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core import rotation
from talkingeyes.core.motion import Blink, Events, Motion, Saccade, VergenceMovement
from talkingeyes.physiology import blinks, face, render
from talkingeyes.physiology.articulation import ArticulationStyle
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.physiology.render import ContinuousMotion, Sinusoids
from talkingeyes.synthesis import emotion, head_gestures
from talkingeyes.synthesis.brows import sample_brow_raises
from talkingeyes.synthesis.gaze_aversion import WARM_UP_S, GazeInterval, gaze_intervals
from talkingeyes.synthesis.gaze_fixations import generate_fixations
from talkingeyes.synthesis.gaze_shifts import generate_gaze, start_gaze
from talkingeyes.synthesis.speakers import SpeakerStyle

LID_DRIFT_RAD = np.radians(1.2)  # correlation time of half a second, up to 5 degrees; partly different between the eyes
LID_DRIFT_HZ, LID_WAVES, LID_DIFFERENCE_RAD = (0.04, 1.6), 12, 0.35
EMOTION_FLUCTUATION, EMOTION_FLUCTUATION_HZ = 0.2, (0.05, 0.3)
# Factor on the probability of blinks in shifts back to the partner: blinks are suppressed towards relevant targets
# (Williamson 2005). With a factor of 0.4, shifts of 20 to 30 degrees, most of which are returns, would have far fewer
# blinks than in Evinger et al.
RETURN_BLINK_FACTOR = 0.85
EVOKED_COMPLETE_PROBABILITY = 0.5
MIN_SPONTANEOUS_SHARE = 0.25
HEAD_GRID_S = 0.08
BLINK_LAG_S, MAX_BLINK_LAG_S = 0.004, 0.010


@dataclass(frozen=True)
class Take:
    """One performance of a sound, with its gaze states; it can be rendered at any frame rate."""

    events: Events
    continuous_motion: ContinuousMotion
    gaze_intervals: tuple[GazeInterval, ...]

    def motion(self, fps: float, frames: int) -> Motion:
        """Render frames 0 to `frames` at `fps`."""
        return render.render_at(self.events, self.continuous_motion, fps, frames)


def sample_take(
    annotation: Annotation, style: SpeakerStyle, seconds: float, rng: np.random.Generator, profile: BlinkProfile
) -> Take:
    """Sample a take of a sound that lasts `seconds`, in the emotion of its annotation."""
    style = emotion.emotional_style(style, annotation.emotion, _emotion_strength(annotation, style))
    continuous_motion = _continuous(annotation, style, seconds, rng)
    gestured = [
        move
        for gesture in (
            head_gestures.posture_shifts,
            head_gestures.sample_nods,
            head_gestures.loudness_pitch,
            head_gestures.listener_nods,
        )
        for move in gesture(annotation, style, rng)
    ]
    head_s = np.arange(-WARM_UP_S, seconds + HEAD_GRID_S, HEAD_GRID_S)
    head = render.head_rotations(Events(head_movements=tuple(gestured)), continuous_motion, head_s)
    head_space_rad = rotation.direction_to_angles(rotation.rotvec_to_direction(head))
    if style.habits is None:
        states = gaze_intervals(annotation, style, seconds, rng)
        gaze_builder = start_gaze(style, head_s, head_space_rad, rng)
        generate_gaze(gaze_builder, states)
    else:
        gaze_builder = start_gaze(style, head_s, head_space_rad, rng)
        states = generate_fixations(gaze_builder, annotation, style.habits, seconds)
    shifts = tuple(each for each in gaze_builder.saccades if each.onset_s < seconds)
    moves = sorted(gestured + gaze_builder.head_movements, key=lambda move: move.onset_s)
    past = [move for move in moves if move.onset_s + move.duration_s <= 0]
    present = [move for move in moves if move.onset_s + move.duration_s > 0 and move.onset_s < seconds]
    seen = tuple(each for each in shifts if each.onset_s + each.duration_s > 0)
    events = Events(
        saccades=seen,
        vergence_movements=_from_time_zero(gaze_builder.vergence_movements, seconds),
        head_movements=tuple(present),
        blinks=_blinks(annotation, style, seconds, seen, gaze_builder.partner_rad, rng, profile),
    )
    continuous_motion = replace(
        continuous_motion,
        gaze_rest_rad=shifts[-1].end_rad,
        head_rest=continuous_motion.head_rest + np.sum([move.delta_rad for move in past], axis=0),
    )
    return Take(events, continuous_motion, tuple(look for look in states if look.end_s > 0))


def _from_time_zero(vergence_movements: Sequence[VergenceMovement], seconds: float) -> tuple[VergenceMovement, ...]:
    """Vergence movements from time 0 on: the last one before it, and those after it."""
    before = max((index for index, each in enumerate(vergence_movements) if each.onset_s <= 0), default=0)
    return tuple(each for each in vergence_movements[before:] if each.onset_s < seconds)


def _continuous(
    annotation: Annotation, style: SpeakerStyle, seconds: float, rng: np.random.Generator
) -> ContinuousMotion:
    posture = np.array([style.rest_pitch, 0.0, style.rest_roll]) + np.radians(0.7) * rng.standard_normal(3)
    drift, *speaking = (head_gestures.idle_motion(band, style, rng) for band in head_gestures.FREQUENCY_BANDS.values())
    return ContinuousMotion(
        gaze_rest_rad=(0.0, 0.0),
        kappa_rad=np.array(style.kappa),
        head_rest=posture,
        head_drift=drift,
        head_speech_motion=head_gestures.concatenate_sinusoids(*speaking),
        activity=head_gestures.motion_scale(annotation, rng),
        translation=head_gestures.head_sway(style, rng),
        eyelids=style.eyelids,
        lid_rest=style.lid_rest,
        lid_drift=_lid_drift(rng),
        blink_lag_s=float(np.clip(BLINK_LAG_S * rng.standard_normal(), -MAX_BLINK_LAG_S, MAX_BLINK_LAG_S)),
        phonemes=annotation.phonemes,
        mouth=_articulation_style(annotation, style),
        face=_face(annotation, style, seconds, rng),
        emotion_fluctuation=_emotion_fluctuation(rng),
    )


def _emotion_fluctuation(rng: np.random.Generator) -> Sinusoids:
    """Fluctuation of the strength of an emotion around 0."""
    amplitude = np.full((3, 1), EMOTION_FLUCTUATION * np.sqrt(2.0 / 3.0))
    return Sinusoids(rng.uniform(*EMOTION_FLUCTUATION_HZ, 3), amplitude, rng.uniform(0, 2 * np.pi, (3, 1)))


def _lid_drift(rng: np.random.Generator) -> Sinusoids:
    """Slow lid motion at constant gaze: a first-order low-pass spectrum, similar in both eyes."""
    low, high = np.log(LID_DRIFT_HZ)
    frequency = np.exp(rng.uniform(low, high, LID_WAVES))
    power = frequency / (1.0 + (2.0 * np.pi * 0.5 * frequency) ** 2)
    amplitude = LID_DRIFT_RAD * np.sqrt(2.0 * power / power.sum())
    phase = rng.uniform(0, 2 * np.pi, (LID_WAVES, 1)) + rng.normal(0.0, LID_DIFFERENCE_RAD, (LID_WAVES, 2))
    return Sinusoids(frequency, np.repeat(amplitude[:, None], 2, axis=1), phase)


def _emotion_strength(annotation: Annotation, style: SpeakerStyle) -> float:
    """Visible strength of the emotion in this face."""
    return float(min(face.INTENSITY_STRENGTH[annotation.intensity] * style.expressiveness, 1.2))


def _articulation_style(annotation: Annotation, style: SpeakerStyle) -> ArticulationStyle:
    emotion_expression, share = face.EMOTION_EXPRESSIONS[annotation.emotion], _emotion_strength(annotation, style)
    return ArticulationStyle(
        jaw_scale=style.jaw_scale * (1.0 + share * (emotion_expression.jaw_scale - 1.0)),
        lip_scale=style.lip_scale,
        jaw_asymmetry=style.jaw_asymmetry,
        jaw_rest_rad=share * emotion_expression.jaw_rest_rad,
    )


def _face(
    annotation: Annotation, style: SpeakerStyle, seconds: float, rng: np.random.Generator
) -> face.FacialBehaviour:
    brows = sample_brow_raises(annotation, style.speech_coupling, seconds, rng)
    return face.FacialBehaviour(annotation.emotion, _emotion_strength(annotation, style), brows)


def _blinks(
    annotation: Annotation,
    style: SpeakerStyle,
    seconds: float,
    shifts: Sequence[Saccade],
    partner_rad: Float[ndarray, " 2"],
    rng: np.random.Generator,
    profile: BlinkProfile,
) -> tuple[Blink, ...]:
    """Gaze-evoked blinks of large shifts (Evinger et al. 1994), and spontaneous ones up to the speaker's rate."""
    evoked = []
    for shift in shifts:
        start, end = (np.hypot(*(np.array(place) - partner_rad)) for place in (shift.start_rad, shift.end_rad))
        chance = blinks.evoked_blink_probability(float(np.hypot(*np.subtract(shift.end_rad, shift.start_rad))))
        if shift.onset_s >= 0 and rng.random() < chance * (RETURN_BLINK_FACTOR if end < start else 1.0):
            evoked.append(
                blinks.sample_blink(profile, shift.onset_s + rng.uniform(-0.03, 0.03), rng, EVOKED_COMPLETE_PROBABILITY)
            )
    spontaneous = max(style.blinks_per_min - 60.0 * len(evoked) / seconds, MIN_SPONTANEOUS_SHARE * style.blinks_per_min)
    others = tuple(blinks.sample_blinks(profile, seconds, rng, annotation, spontaneous, style.blink_completeness))
    return blinks.drop_overlapping(evoked, others)
