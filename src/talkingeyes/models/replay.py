"""Lookups: training motion replayed where the sound is as loud, without any training.

`aligned_replay` takes head and gaze of a training clip whose loudness is nearest frame by frame. `pieced_replay` takes
its head, and around each onset of speech gaze in space from the training onset whose loudness before and after is
nearest; the eyes compensate for the head. Both choose uniformly among the nearest `neighbours`. What such a row reaches
is retrieval: a model that learns should reach more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import eye_in_head, gaze_in_space
from talkingeyes.core.settings import Settings

LOUDNESS, ACTIVITY = "energy_dbfs", "voice_activity"
# An onset is compared over this long before and after it, and begins a piece this long before.
COMPARED_S, LEAD_S = 1.0, 0.5


class ReplaySettings(Settings):
    """Settings of a lookup."""

    kind: Literal["aligned_replay", "pieced_replay"]
    parts: tuple[Literal["head", "gaze"], ...]
    tokenizer: None
    neighbours: Annotated[int, Field(gt=0)]


@dataclass(frozen=True)
class ReplayBank:
    """Concatenated training clips: clip i is frames starts[i] to starts[i + 1].

    `motion` is the head and both eyes in the head, rotation vectors; `loudness` in dB over full scale; `onsets`: frames
    of the concatenation at which speech starts; `channels`: those of loudness and voice activity in an embedding.
    """

    starts: Int[ndarray, " M"]
    motion: Float[ndarray, "F 9"]
    loudness: Float[ndarray, " F"]
    onsets: Int[ndarray, " K"]
    channels: Int[ndarray, " 2"]
    fps: Float[ndarray, ""]

    @classmethod
    def of(
        cls,
        speech: Sequence[Float[ndarray, "T C"]],
        motions: Sequence[Float[ndarray, "T 9"]],
        names: Sequence[str],
        fps: float,
    ) -> ReplayBank:
        """A bank of training clips; `names` of the channels of `speech`. Raises InputError if it lacks loudness or
        voice activity."""
        if missing := {LOUDNESS, ACTIVITY} - set(names):
            raise InputError(f"embed: should have the channel {min(missing)} for a replay, got none")
        channels = np.array([names.index(LOUDNESS), names.index(ACTIVITY)])
        starts = np.cumsum([0, *map(len, motions)])
        onsets = [start + find_onsets(each[:, channels[1]]) for start, each in zip(starts[:-1], speech, strict=True)]
        loudness = np.concatenate([each[:, channels[0]] for each in speech])
        motion = np.concatenate(motions).astype(np.float32)
        return cls(starts, motion, loudness.astype(np.float32), np.concatenate(onsets), channels, np.array(fps))

    def clip(self, index: int) -> slice:
        """The frames of a clip."""
        return slice(int(self.starts[index]), int(self.starts[index + 1]))

    def around(self, onsets: Int[ndarray, " K"]) -> Float[ndarray, "K W"]:
        """Loudness around onsets; beyond a clip, that of its first or last frame."""
        clip = np.searchsorted(self.starts, onsets, side="right") - 1
        frames = onsets[:, None] + self._offsets
        within = np.clip(frames, self.starts[clip][:, None], self.starts[clip + 1][:, None] - 1)
        return np.asarray(self.loudness[within])

    @property
    def _offsets(self) -> Int[ndarray, " W"]:
        half = round(COMPARED_S * float(self.fps))
        return np.arange(-half, half + 1)

    def similar_onsets(self, loudness: Float[ndarray, " T"], onset: int) -> Int[ndarray, " K"]:
        """The bank's onsets, those with the most similar loudness to that around a frame first."""
        around = loudness[np.clip(onset + self._offsets, 0, len(loudness) - 1)]
        distance = np.square(self.around(self.onsets) - around).mean(axis=1)
        return self.onsets[np.argsort(distance, kind="stable")]


def find_onsets(activity: Float[ndarray, " T"]) -> Int[ndarray, " K"]:
    """Frames at which speech starts."""
    speaking = np.concatenate([[False], activity > 0.5])
    return np.flatnonzero(speaking[1:] & ~speaking[:-1])


def sample_replay(
    settings: ReplaySettings, bank: ReplayBank, embedding: Float[ndarray, "T C"], seeds: Sequence[int]
) -> Float[ndarray, "B T 9"]:
    """Motions of the bank for a sound, one row a seed. Frames beyond the longest training clip hold its last pose."""
    loudness, activity = (embedding[:, channel] for channel in bank.channels)
    rows = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        row = _aligned(bank, loudness, settings.neighbours, rng)
        if settings.kind == "pieced_replay":
            row = _pieced(bank, row, loudness, activity, settings.neighbours, rng)
        rows.append(row)
    return np.stack(rows)


def _aligned(
    bank: ReplayBank, loudness: Float[ndarray, " T"], neighbours: int, rng: np.random.Generator
) -> Float[ndarray, "T 9"]:
    """A training clip whose loudness is nearest frame by frame, among those that are long enough."""
    lengths = np.diff(bank.starts)
    frames = min(len(loudness), int(lengths.max()))
    candidates = np.flatnonzero(lengths >= frames)
    curves = bank.loudness[bank.starts[candidates][:, None] + np.arange(frames)]
    distance = np.square(curves - loudness[:frames]).mean(axis=1)
    chosen = int(rng.choice(candidates[np.argsort(distance, kind="stable")[:neighbours]]))
    found = bank.motion[bank.clip(chosen)][:frames]
    return np.concatenate([found, np.repeat(found[-1:], len(loudness) - frames, axis=0)])


def _pieced(
    bank: ReplayBank,
    row: Float[ndarray, "T 9"],
    loudness: Float[ndarray, " T"],
    activity: Float[ndarray, " T"],
    neighbours: int,
    rng: np.random.Generator,
) -> Float[ndarray, "T 9"]:
    """Replace gaze in space from before each onset to before the next by that of a training onset."""
    onsets, lead = find_onsets(activity), round(LEAD_S * float(bank.fps))
    if not len(onsets) or not len(bank.onsets):
        return row
    space = _in_space(row)
    begins = [max(int(onset) - lead, 0) for onset in onsets]
    for onset, begin, end in zip(onsets, begins, [*begins[1:], len(row)], strict=True):
        source = int(rng.choice(bank.similar_onsets(loudness, int(onset))[:neighbours]))
        clip = bank.clip(int(np.searchsorted(bank.starts, source, side="right")) - 1)
        frames = np.clip(np.arange(begin, end) - int(onset) + source, clip.start, clip.stop - 1)
        space[begin:end] = _in_space(bank.motion[frames])
    eyes = eye_in_head(row[:, :3], space).reshape(len(row), 6)
    return np.concatenate([row[:, :3], eyes], axis=1).astype(np.float32)


def _in_space(motion: Float[ndarray, "T 9"]) -> Float[ndarray, "T 2 2"]:
    return gaze_in_space(motion[:, :3], motion[:, 3:].reshape(-1, 2, 3))
