"""Live speech becomes head, gaze and blinks while it is spoken: chunks of sound in, frames out, a stated time later.

A frame at t is given as soon as the sound up to t + `latency_s` is there (0.237 s with the model `talkingeyes_live`:
37 ms for prosody, 160 ms that its speech layers look ahead, 40 ms for the rest of a bin of gaze). What comes out does
not depend on how the sound is cut into chunks; it is what `LiveModel.whole` gives for all of it at once (docs/live.md).
Jaw and expression are neutral: no model of the face can be streamed yet.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.animation.direction import Liveliness
from talkingeyes.animation.model_file import opened
from talkingeyes.animation.perform import SHUT, held_over, sample_seeds
from talkingeyes.audio.encoder import EmbedSettings
from talkingeyes.audio.live import LiveProsody
from talkingeyes.audio.waveform import LONGEST_S, SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Motion
from talkingeyes.models.speech_to_motion import Generated, SpeechToMotion
from talkingeyes.models.streaming import MotionStream, Streamed, joined
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.training.trained import NetworkGenerator, load_generator

GREATEST_LATENCY_S = 0.4


@dataclass(frozen=True)
class Frames:
    """Consecutive frames of a stream, the first of them number `first`: head, eye-in-head and lids as in Motion."""

    first: int
    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]
    lid: Float[ndarray, "T 2"]

    def __len__(self) -> int:
        return len(self.head)


@dataclass(frozen=True)
class LiveWish:
    """What a person asks of a stream: the profile of its blinks, and how lively it is (performance.direction)."""

    blinks: str = "physio"
    liveliness: Liveliness = field(default_factory=Liveliness)


AS_IT_IS = LiveWish()


@dataclass(frozen=True)
class _Shaped:
    """Head, and gaze in space."""

    head: Float[ndarray, "T 3"]
    space: Float[ndarray, "T 2 2"]


@dataclass(frozen=True)
class LiveModel:
    """A trained model that can be streamed."""

    network: SpeechToMotion
    embedding: EmbedSettings
    fps: float
    blink_profiles: Mapping[str, BlinkProfile]

    @classmethod
    def load(cls, model: Path) -> LiveModel:
        """From a folder of the train stage or a packed file. Raises InputError if it is not one for streams."""
        with opened(model) as folder:
            generator = load_generator(folder)
            try:
                content = json.loads((folder / "embedding.json").read_text())
                settings = EmbedSettings.model_validate(content["settings"])
                seen = json.loads((folder / "blinks.json").read_text())["speakers"]["log_normal"]
                corpus = BlinkProfile("lognormal", math.exp(seen["mean"]), seen["sd"])
            except (OSError, ValueError, KeyError) as error:
                raise InputError(f"{model}: not a trained model ({error}); `make repro` trains one") from None
        if not isinstance(generator, NetworkGenerator):
            raise InputError(
                f"{model}: should be a model for streams, such as data/train/talkingeyes_live, got a baseline"
            )
        found = cls(generator.network, settings, float(content["fps"]), blinks.PROFILES | {"corpus": corpus})
        found.check(model)
        return found

    def check(self, model: Path) -> None:
        """Raises InputError for a model that hears too far ahead, or what no stream can tell it."""
        if not self.heard or set(self.heard) - set(LiveProsody.channels):
            raise InputError(f"{model}: a model for streams should hear {', '.join(LiveProsody.channels)} alone")
        if self.latency_s > GREATEST_LATENCY_S:
            raise InputError(f"{model}: should look at most {GREATEST_LATENCY_S:g} s ahead, got {self.latency_s:.3f} s")

    @property
    def latency_s(self) -> float:
        """How much sound after a frame must have come before the frame is given."""
        return (
            Streamed.of(self.network).frames_ahead / self.fps
            + LiveProsody(self.embedding, self.fps).ahead / SAMPLE_RATE
        )

    def stream(self, seed: int, wish: LiveWish = AS_IT_IS) -> Stream:
        """A new stream; the same seed and sound give the same frames. Raises InputError for unknown blinks."""
        return Stream(self, seed, wish)

    def whole(self, sound: Float[ndarray, " N"], seed: int, wish: LiveWish = AS_IT_IS) -> Motion:
        """What a stream of the sound gives, by the model's ordinary generation of a whole speech."""
        features = LiveProsody(self.embedding, self.fps).whole(sound)
        (own_seed,) = sample_seeds(seed, 1)
        found = self.shaped(self.network.generate(self.embedded(features), [own_seed]), wish)
        blinked = self.blinks_of(seed, wish)
        eye = eye_head.within_range(rotation.eye_in_head(found.head, held_over(blinked, found.space, self.fps)))
        closure = blinks.closure(blinked, np.arange(len(found.head)) / self.fps)
        return Motion.of(self.fps, found.head, eye, lid=np.repeat(closure[:, None], 2, axis=1))

    def embedded(self, features: Float[ndarray, "T 3"]) -> Float[Tensor, "T C"]:
        """The embedding that the network expects; channels that it does not hear are left at zero."""
        speech = self.network.speech
        embedding = torch.zeros(len(features), len(speech.mean))
        embedding[:, speech.heard] = torch.from_numpy(features[:, [LiveProsody.channels.index(n) for n in self.heard]])
        return embedding

    @property
    def heard(self) -> tuple[str, ...]:
        """The channels that the network hears."""
        return self.network.settings.speech.channels or ()

    def shaped(self, generated: Generated, wish: LiveWish) -> _Shaped:
        """As lively as is wished: the head about its mean pose, gaze of both eyes together about straight ahead."""
        head, gaze = (part[0].numpy().astype(np.float64) for part in (generated.head, generated.gaze))
        space = rotation.gaze_in_space(head, gaze)
        lively = wish.liveliness
        if lively.head != 1:
            mean = Streamed.of(self.network).head.normal.mean.numpy()
            head = mean + lively.head * (head - mean)
        if lively.gaze != 1:
            space = space + (lively.gaze - 1) * space.mean(axis=1, keepdims=True)
        return _Shaped(head, space)

    def blinks_of(self, seed: int, wish: LiveWish) -> tuple[Blink, ...]:
        """The blinks of an hour, so that they do not depend on how long the speech turns out to be."""
        if wish.blinks not in self.blink_profiles:
            raise InputError(f"blinks: should be one of {', '.join(self.blink_profiles)}, got {wish.blinks}")
        profile, random = self.blink_profiles[wish.blinks], np.random.default_rng([seed, 0])
        rate = blinks.draw_rate_per_min(profile, random) * wish.liveliness.blinks
        return blinks.draw_blinks(profile, LONGEST_S, random, rate_per_min=rate) if rate else ()


class Stream:
    """The state of one stream: sound that no frame needs any more is forgotten, so memory does not grow."""

    def __init__(self, model: LiveModel, seed: int, wish: LiveWish) -> None:
        self._model, self._wish = model, wish
        self._blinks = deque(model.blinks_of(seed, wish))
        self._motion = MotionStream(model.network, sample_seeds(seed, 1)[0])
        self._prosody = LiveProsody(model.embedding, model.fps, together=Streamed.of(model.network).gaze.step_frames)
        self._samples, self._frames = 0, 0
        self._held: Float[ndarray, "2 2"] | None = None
        self._ended = False

    def push(self, chunk: Float[ndarray, " N"]) -> Frames:
        """Hear the next 16 kHz samples; the frames that can be given now, perhaps none.

        Raises InputError for NaN, for more than an hour, and after the end.
        """
        if self._ended:
            raise InputError("sound: the stream has ended; a new one should be begun, got more sound")
        if not np.isfinite(chunk).all():
            raise InputError("sound: samples should be finite numbers, got NaN or infinite ones")
        self._samples += len(chunk)
        if self._samples > LONGEST_S * SAMPLE_RATE:
            raise InputError(f"sound: a stream should last at most {LONGEST_S:.0f} s, got more")
        patch = self._prosody.together
        features = self._prosody.push(chunk)
        parts = [self._given(features[first : first + patch]) for first in range(0, len(features), patch)]
        return self._played(parts)

    def finish(self) -> Frames:
        """The rest: all frames of the sound have been given then."""
        self._ended = True
        features = self._prosody.finish()
        return self._played([self._given(features), self._motion.finish()])

    def _given(self, features: Float[ndarray, "T 3"]) -> Generated:
        return self._motion.push(self._model.embedded(features))

    def _played(self, parts: list[Generated]) -> Frames:
        """With blinks, and gaze held while the lids are shut."""
        if not parts:
            return Frames(self._frames, np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 2)))
        shaped = self._model.shaped(joined(parts), self._wish)
        first = self._frames
        self._frames += len(shaped.head)
        closure = self._closure(np.arange(first, self._frames) / self._model.fps)
        for frame, shut in enumerate(closure):
            if shut < SHUT or self._held is None:
                self._held = shaped.space[frame].copy()
            shaped.space[frame] = self._held
        eye = eye_head.within_range(rotation.eye_in_head(shaped.head, shaped.space))
        return Frames(first, shaped.head, eye, np.repeat(closure[:, None], 2, axis=1))

    def _closure(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """How far the lids are shut; blinks that are over are forgotten."""
        if not len(times_s):
            return np.zeros(0)
        while self._blinks and blinks.end_s(self._blinks[0]) < times_s[0]:
            self._blinks.popleft()
        return blinks.closure([*takewhile(lambda blink: blink.onset_s <= times_s[-1], self._blinks)], times_s)
