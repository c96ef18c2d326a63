"""Eyes and heads as other programs make them: baselines, written anew from the public descriptions of the programs.

No code of these programs is used. What a description leaves open is chosen here and said so. Each generator takes a
sound and a random generator and gives head rotations and eye-in-head angles; both eyes turn alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.prosody import energy_dbfs
from talkingeyes.core.motion import Saccade
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.corpus.samples import Samples
from talkingeyes.formats.arkit import LOOK_RANGE_RAD
from talkingeyes.physiology.frame_saccades import find_saccades
from talkingeyes.physiology.saccades import gaze_path, sample_saccade

MIN_INTERVAL_S = 0.15  # between two saccades

# Uniform eyes: look coefficients (left positive; down positive) and head angles (pitch down, yaw, roll in radians).
EYE_RANGE = np.array([[-0.6, 0.6], [-0.2, 0.6]])
HEAD_RANGE_RAD = np.array([[-0.04, 0.10], [-0.3, 0.3], [-0.08, 0.08]])
EYE_HOLD_S, EYE_MOVE_S = (0.2, 5.0), (0.1, 0.5)
HEAD_HOLD_S, HEAD_MOVE_S = (0.0, 1.0), (0.2, 5.0)

# Replayed saccades: each is drawn among this many recorded ones that start nearest to the present gaze.
NEAREST = 20

# Sines: frequencies and amplitudes of pitch, yaw and roll; levels that map to no and to full motion.
SINE_HZ, SINE_DEG, SINE_SCALE = np.array([2.2, 0.6, 1.3]), np.array([4.5, 7.5, 2.25]), 1.5
LEVEL_DB, OFFSET_DB, GAMMA = (-46.0, -18.0), 4.0, 0.9
VOICE_ON_DB, VOICE_OFF_DB, ATTACK_S, RELEASE_S, LEVEL_WINDOW_S = -35.0, -45.0, 0.05, 0.25, 0.02

# Rules: share of time at the partner by state, the middle of the described ranges.
AT_PARTNER = {"speaking": 0.65, "listening": 0.75, "thinking": 0.40, "idle": 0.35}
CONTACT_S = (1.0, 3.3)
AVERSION_DEG = (6.0, 15.0)
SCAN_S, MICRO_S, MICRO_DEG = (0.25, 0.5), (0.5, 1.0), (0.2, 0.5)
TRIANGLE_DEG = np.array([[1.8, 0.0], [-1.8, 0.0], [0.0, -3.7]])  # eyes and mouth of a partner at 1 m
THINKING_S, IDLE_S = 0.4, 2.0  # silences this long, outside the partner's turns
PLANNING_S = 1.0  # before the own turn


@dataclass(frozen=True)
class FieldSound:
    """What a program may use: T frames of a sound (16 kHz), who speaks when by level, and recorded saccades."""

    frames: int
    fps: float
    sound: Float[ndarray, " N"]
    turns: Annotation
    bank: SaccadeBank

    @property
    def times_s(self) -> Float[ndarray, " T"]:
        return np.arange(self.frames) / self.fps


@dataclass(frozen=True)
class SaccadeBank:
    """Start and displacement of K recorded saccades of gaze in space (yaw, pitch; radians), and their rate."""

    start_rad: Float[ndarray, "K 2"]
    step_rad: Float[ndarray, "K 2"]
    rate_per_s: float

    @classmethod
    def of(cls, gaze_in_space_rad: Sequence[Float[ndarray, "T 2"]], fps: float) -> SaccadeBank:
        """The saccades found in recordings."""
        found = [each for one in gaze_in_space_rad for each in find_saccades(one, fps)]
        start, end = (np.array([getattr(each, name) for each in found]) for name in ("start_rad", "end_rad"))
        return cls(start, end - start, len(found) / (sum(map(len, gaze_in_space_rad)) / fps))


@dataclass(frozen=True)
class FieldMotion:
    """Head rotation vectors and eye-in-head angles (yaw, pitch) of T frames, in radians."""

    head: Float[ndarray, "T 3"]
    eyes_rad: Float[ndarray, "T 2"]


def uniform_eyes(speech: FieldSound, rng: np.random.Generator) -> FieldMotion:
    """Uniformly random eyes, with a new direction every 0.2 to 5 s, and a uniformly random head.

    Source: TalkingHead 1.7 (met4citizen/TalkingHead, README, "animMoods", mood neutral): look coefficients within 0.6
    sideways, from 0.2 up to 0.6 down, reached within 0.1 to 0.5 s after a wait of 0.2 to 5 s; the head turns within 0.3
    rad of yaw, takes 0.2 to 5 s and waits up to 1 s. The head moves. Chosen here: a coefficient of 1 is 37 degrees, as
    in our ARKit files; movements ease in and out.
    """
    look = _eased_path(speech, EYE_RANGE, EYE_HOLD_S, EYE_MOVE_S, rng)
    head = _eased_path(speech, HEAD_RANGE_RAD, HEAD_HOLD_S, HEAD_MOVE_S, rng)
    return FieldMotion(head, look * LOOK_RANGE_RAD * np.array([1.0, -1.0]))


def _eased_path(
    speech: FieldSound,
    bounds: Float[ndarray, "C 2"],
    hold_s: tuple[float, float],
    move_s: tuple[float, float],
    rng: np.random.Generator,
) -> Float[ndarray, "T C"]:
    """A path between uniformly random places, with uniformly random waits and movement times."""
    place = rng.uniform(bounds[:, 0], bounds[:, 1])
    path, end_s = np.tile(place, (speech.frames, 1)), 0.0
    while end_s < speech.frames / speech.fps:
        start_s = end_s + rng.uniform(*hold_s)
        end_s = start_s + rng.uniform(*move_s)
        following = rng.uniform(bounds[:, 0], bounds[:, 1])
        phase = np.clip((speech.times_s - start_s) / (end_s - start_s), 0.0, 1.0)
        path += (following - place) * (phase**2 * (3 - 2 * phase))[:, None]
        place = following
    return path


def replayed_saccades(speech: FieldSound, rng: np.random.Generator) -> FieldMotion:
    """Recorded saccades, replayed at random times.

    Source: NVIDIA Audio2Face-3D (its SDK and samples; the setting "saccade strength" of its manual): saccades come from
    a file of recorded eye rotations, whatever the sound. The head does not move: the program leaves it out. Chosen
    here, in favour of the baseline: the saccades are those of the training split, at their rate; each keeps its
    displacement and is drawn among those that start nearest to the present gaze; kinematics follow the main sequence.
    """
    bank = speech.bank
    place = bank.start_rad[rng.integers(len(bank.start_rad))]
    chain: list[Saccade] = []
    onset_s = rng.exponential(1 / bank.rate_per_s)
    while onset_s < speech.frames / speech.fps:
        nearest = np.argsort(np.linalg.norm(bank.start_rad - place, axis=1))[:NEAREST]
        following = place + bank.step_rad[rng.choice(nearest)]
        chain.append(sample_saccade(onset_s, place, following, rng))
        place = following
        onset_s += MIN_INTERVAL_S + rng.exponential(max(1 / bank.rate_per_s - MIN_INTERVAL_S, 0.0))
    still = np.zeros((speech.frames, 3))
    return FieldMotion(still, gaze_path(chain, place, speech.times_s))


def loudness_sines(speech: FieldSound, rng: np.random.Generator) -> FieldMotion:
    """A head that sways by three sines while the voice is loud.

    Source: Reachy Mini (pollen-robotics/reachy_mini, motion/speech_tapper.py, as its users describe it): pitch, yaw and
    roll are sines of 2.2, 0.6 and 1.3 Hz with amplitudes of 4.5, 7.5 and 2.25 degrees times 1.5; they are gated by
    voice activity (on above -35 dBFS, off below -45) and scaled by loudness (-46 to -18 dBFS), with an attack of 50 ms
    and a release of 250 ms. The head moves; the eyes of the robot cannot, so gaze follows the head.
    """
    level = energy_dbfs(speech.sound, speech.times_s, LEVEL_WINDOW_S, -90.0) + OFFSET_DB
    loudness = np.clip((level - LEVEL_DB[0]) / (LEVEL_DB[1] - LEVEL_DB[0]), 0.0, 1.0) ** GAMMA
    gain, envelope, voiced, quiet_s = 0.0, np.empty(speech.frames), False, 0.0
    for frame in range(speech.frames):
        quiet_s = quiet_s + 1 / speech.fps if level[frame] <= VOICE_OFF_DB else 0.0
        voiced = level[frame] >= VOICE_ON_DB or (voiced and quiet_s < RELEASE_S)
        target = loudness[frame] if voiced else 0.0
        constant_s = ATTACK_S if target > gain else RELEASE_S
        gain += (target - gain) * (1 - np.exp(-1 / (speech.fps * constant_s)))
        envelope[frame] = gain
    phase = rng.uniform(0.0, 2 * np.pi, 3)
    sines = np.sin(2 * np.pi * SINE_HZ * speech.times_s[:, None] + phase)
    head = np.radians(SINE_SCALE * SINE_DEG) * sines * envelope[:, None]
    return FieldMotion(head, np.zeros((speech.frames, 2)))


def rule_based(speech: FieldSound, rng: np.random.Generator) -> FieldMotion:
    """A state machine: speaking, listening, thinking, idle; each with its share of time at the partner.

    Source: thot-pocket (ExpertVagabond/thot-pocket, README, "Conversational Gaze Model"): at the user 60 to 70 % while
    speaking (aversions sideways), 70 to 80 % while listening (brief), 30 to 50 % while thinking (up and right, or down
    and left), 30 to 40 % when idle (anywhere); contact lasts 3.3 s at most; the eyes scan a triangle of eyes and mouth
    two to four times a second, and make microsaccades of 0.2 to 0.5 degrees. The head does not move. Chosen here:
    states from speech detected by level (thinking: the second before the own turn and pauses of 0.4 s; idle: silences
    of 2 s), aversions of 6 to 15 degrees, contacts of 1 to 3.3 s, kinematics of the main sequence.
    """
    states = conversation_states(speech)
    chain: list[Saccade] = []
    place = centre = np.zeros(2)
    now_s = until_s = 0.0
    averted, state = bool(rng.integers(2)), ""
    while now_s < speech.frames / speech.fps:
        present = states[min(int(now_s * speech.fps), speech.frames - 1)]
        if now_s >= until_s or present != state:
            changed, state = present != state, present
            share = AT_PARTNER[state]
            averted = bool(rng.random() > share) if changed else not averted
            length_s = rng.uniform(*CONTACT_S)
            until_s = now_s + (length_s * (1 - share) / share if averted else length_s)
            centre = np.radians(rng.uniform(*AVERSION_DEG)) * _aversion(state, rng) if averted else np.zeros(2)
            following = centre
        elif averted:
            angle = rng.uniform(0, 2 * np.pi)
            following = centre + np.radians(rng.uniform(*MICRO_DEG)) * np.array([np.cos(angle), np.sin(angle)])
        else:
            following = np.radians(TRIANGLE_DEG[rng.integers(3)])
        if np.linalg.norm(following - place) > 0:
            chain.append(sample_saccade(now_s, place, following, rng))
        place = following
        now_s += rng.uniform(*(MICRO_S if averted else SCAN_S))
    return FieldMotion(np.zeros((speech.frames, 3)), gaze_path(chain, place, speech.times_s))


def _aversion(state: str, rng: np.random.Generator) -> Float[ndarray, " 2"]:
    """Direction of an aversion (left, up), a unit vector."""
    side = float(rng.choice([-1.0, 1.0]))
    if state == "thinking":
        return np.asarray(np.array([-side, side]) / np.sqrt(2))  # up and to the right, or down and to the left
    if state == "speaking":
        return np.array([side, 0.0])
    angle = rng.uniform(0, 2 * np.pi)
    return np.asarray([np.cos(angle), np.sin(angle)])


def conversation_states(speech: FieldSound) -> list[str]:
    """The state of each frame, by level alone."""
    states = np.full(speech.frames, "idle", dtype="U9")

    def mark(start_s: float, end_s: float, state: str) -> None:
        states[max(0, round(start_s * speech.fps)) : max(0, round(end_s * speech.fps))] = state

    speaking = speech.turns.speaking
    for one, following in pairwise(speaking):
        if following.start_s - one.end_s < IDLE_S:
            short = following.start_s - one.end_s < THINKING_S
            mark(one.end_s, following.start_s, "speaking" if short else "thinking")
    for span in speech.turns.listening:
        mark(span.start_s, span.end_s, "listening")
    for before, span in zip([None, *speaking], speaking, strict=False):
        if before is None or span.start_s - before.end_s >= IDLE_S:
            mark(span.start_s - PLANNING_S, span.start_s, "thinking")
        mark(span.start_s, span.end_s, "speaking")
    return states.tolist()


GENERATORS: dict[str, Callable[[FieldSound, np.random.Generator], FieldMotion]] = {
    "uniform_eyes": uniform_eyes,
    "replayed_saccades": replayed_saccades,
    "loudness_sines": loudness_sines,
    "rule_based": rule_based,
}


def generate(name: str, speech: FieldSound, seeds: Sequence[Sequence[int]]) -> Samples:
    """Samples of a baseline, one per seed."""
    made = [GENERATORS[name](speech, np.random.default_rng(seed)) for seed in seeds]
    eyes = angles_to_gaze(np.stack([each.eyes_rad for each in made]))
    return Samples(speech.fps, np.stack([each.head for each in made]), np.stack([eyes, eyes], axis=2))
