"""An animator of toy motions with jumping gaze and a swaying head, for tests of controls."""

from __future__ import annotations

from typing import Any

import numpy as np
from toy import recordings

from talkingeyes.animation.animation import Animation
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.fitting.motion_style import MotionStyle
from talkingeyes.physiology import blinks
from talkingeyes.training.motion_generators import Speech, TrainedGenerator

SECONDS = 30
SOUND = np.zeros(16_000 * SECONDS, np.float32)
CALM_STYLE = MotionStyle((0.05, 0.0, 0.01), (0.01, 0.02, 0.01), (0.02, -0.03), (0.05, 0.03), 40.0, 8.0)
LIVELY_STYLE = MotionStyle((-0.03, 0.02, 0.0), (0.05, 0.06, 0.03), (-0.04, 0.0), (0.12, 0.08), 110.0, 40.0)


class Encoder:
    channels = ("a",)

    def __call__(self, sound: Any, fps: float) -> Any:
        return np.zeros((int(len(sound) * fps // 16_000), 1), np.float32)


class Generator(TrainedGenerator):
    def sample(self, speech: Speech) -> Samples:
        clips = [recordings(1, seed, len(speech.embedding))[0] for seed in speech.seeds]
        heads, gazes = (np.stack([getattr(clip, name) for clip in clips]).astype(float) for name in ("head", "gaze"))
        return Samples(speech.fps, heads, gazes)


PERFORMER = Animator(Encoder(), Generator(), 25.0, blinks.PROFILES, {"ann": CALM_STYLE, "bob": LIVELY_STYLE})


def perform_toy(samples: int = 1, seed: int = 0, fps: float = 25.0, **asked: Any) -> list[Animation]:
    """Animations of half a minute with the given controls."""
    return PERFORMER.perform(SOUND, samples, seed, fps, Controls(**asked))


def motion(seed: int = 0, fps: float = 25.0, **asked: Any) -> Motion:
    """Motion of one such animation."""
    return perform_toy(1, seed, fps, **asked)[0].motion
