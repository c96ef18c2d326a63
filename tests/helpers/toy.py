"""Toy recordings: gaze with jumps and rests, a swaying head, noise as speech. Fast, with enough structure to learn."""

import numpy as np

from talkingeyes.core import rotation
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recording

CHANNELS = 6


def clip(name: str, speaker: str = "a", take: int = 0) -> Clip:
    """An index row with only the name and the speaker set."""
    return Clip(
        id=name, sound=name, take=take, speaker=speaker, split="train", seconds=8.4, fps=25.0, emotion="neutral",
        intensity=0, language="en", text="", source="toy", licence="none", content_hash="",
    )  # fmt: skip


def recordings(count: int, seed: int, frames: int = 210) -> list[Recording]:
    """`count` clips of `frames` frames."""
    rng = np.random.default_rng(seed)
    return [_recording(f"toy-{seed}-{index}", frames, rng) for index in range(count)]


def _recording(name: str, frames: int, rng: np.random.Generator) -> Recording:
    times = np.arange(frames)[:, None] / 25
    waves = [
        np.sin(2 * np.pi * hz * times + rng.uniform(0, 6)) * rng.normal(0, 0.03, 3) / (1 + hz) for hz in (0.2, 0.5, 1.2)
    ]
    head = np.sum(waves, axis=0)
    starts = np.cumsum(rng.integers(6, 30, frames))
    targets = rng.normal(0, 0.13, (frames, 2))
    space = targets[np.searchsorted(starts, np.arange(frames), side="right")]
    gaze = rotation.eye_in_head(head, np.repeat(space[:, None], 2, axis=1))
    speech = rng.standard_normal((frames, CHANNELS)).astype(np.float32)
    return Recording(clip(name), speech, head.astype(np.float32), gaze.astype(np.float32), np.ones(frames, dtype=bool))
