"""Streaming generation: embeddings of a few frames at a time in, head and gaze out, of many streams in one step.

The result of each stream equals that of `SpeechToMotion.generate` for the whole embedding (up to rounding:
tests/test_streaming.py), one gaze step at a time. Small steps cost more in calls than in arithmetic, so a step of 25
streams costs little more than that of 5. The model must have limited lookahead (conf/model/talkingeyes_live.yaml):
causal speech layers, the head `causal_vae`, and gaze without lookahead (`StreamableGazeGenerator`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.core.errors import InputError
from talkingeyes.models.gaze.generator import GazeCondition, StreamableGazeGenerator
from talkingeyes.models.head.causal_vae import CausalVAEHead, HeadState
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.speech_stream import SpeechState, SpeechStreams
from talkingeyes.models.speech_to_motion import GeneratedMotion, SpeechToMotion


@dataclass(frozen=True)
class StreamingModules:
    """The modules of a network that can be streamed."""

    speech: ConvolutionStack
    speech_lookahead: int  # frames
    head: CausalVAEHead
    gaze: StreamableGazeGenerator

    @classmethod
    def of(cls, network: SpeechToMotion) -> StreamingModules:
        """Modules of a network. Raises InputError if it uses the whole speech, or conditions that a stream does not
        provide."""
        if network.conditions or network.waveform_encoder is not None:
            raise InputError(
                "model: should have no conditions and no waveform encoder for streaming, got a model with them"
            )
        speech, head, gaze = network.speech.stack, network.head, network.gaze
        if (
            speech.lookahead is None
            or not isinstance(head, CausalVAEHead)
            or not isinstance(gaze, StreamableGazeGenerator)
            or gaze.has_lookahead
        ):
            raise InputError(
                "model: should be streamable (speech.lookahead, head causal_vae, gaze without lookahead), got another"
            )
        return cls(speech, speech.lookahead, head, gaze)

    @property
    def lookahead_frames(self) -> int:
        """Number of future frames of the embedding that a frame needs."""
        return self.speech_lookahead + self.gaze.step_frames - 1


@dataclass(frozen=True)
class MotionState:
    """A stream between two parts of its embedding. States are never changed: a step that fails can be taken again."""

    speech: SpeechState
    head: HeadState
    gaze: Any


@dataclass(frozen=True)
class MotionStep:
    """What a stream gives for a part of its embedding, and the stream after it."""

    state: MotionState
    motion: GeneratedMotion


class MotionStreams:
    """The streams of one network, of which many take a step at once."""

    def __init__(self, network: SpeechToMotion, temperature: float | None = None) -> None:
        self._network, parts = network, StreamingModules.of(network)
        self._step_frames = parts.gaze.step_frames
        self._speech, self._head = SpeechStreams(parts.speech, 1 + network.is_guided), parts.head.streaming()
        self._gaze = parts.gaze.streaming(float(network.temperature) if temperature is None else temperature)

    def begin(self, seed: int) -> MotionState:
        """A stream before its first frame."""
        return MotionState(self._speech.begin(), self._head.begin(seed), self._gaze.begin(seed))

    @torch.inference_mode()
    def step(self, states: Sequence[MotionState], embedding: Float[Tensor, "B T C"]) -> list[MotionStep]:
        """Motion that can be generated now: whole steps, perhaps none. Parts of equal length give the same result to
        the bit for a stream alone, and to rounding among others."""
        standardised = self._network.speech.standardise(embedding).numpy()
        speech = self._speech.step([each.speech for each in states], standardised)
        return self._steps([replace(each, speech=own) for each, own in zip(states, speech, strict=True)])

    @torch.inference_mode()
    def finish(self, state: MotionState) -> MotionStep:
        """The rest of the motion; the last step may be incomplete."""
        (found,) = self._steps([replace(state, speech=self._speech.finish(state.speech))])
        if not (rest := found.state.speech.frames):
            return found
        (last,) = self._generate([found.state], rest)
        return MotionStep(last.state, concat_motions([found.motion, last.motion]))

    def _steps(self, states: Sequence[MotionState]) -> list[MotionStep]:
        now = list(states)
        parts: list[list[GeneratedMotion]] = [[] for _ in states]
        while ready := [row for row, each in enumerate(now) if each.speech.frames >= self._step_frames]:
            for row, found in zip(ready, self._generate([now[row] for row in ready], self._step_frames), strict=True):
                now[row] = found.state
                parts[row].append(found.motion)
        return [MotionStep(state, concat_motions(found)) for state, found in zip(now, parts, strict=True)]

    def _generate(self, states: Sequence[MotionState], frames: int) -> list[MotionStep]:
        """Motion of one step, or of its beginning at the end of a stream."""
        speech = torch.from_numpy(np.stack([each.speech.pending[:, :frames] for each in states], axis=1))
        head, heads = self._head.step([each.head for each in states], speech[0])
        mean = speech[1] if self._network.is_guided else None
        condition = GazeCondition(speech[0], head, self._network.head.normal(head), mean)
        gaze, gazes = self._gaze.step([each.gaze for each in states], condition)
        return [
            MotionStep(
                MotionState(each.speech.without(frames), own_head, own_gaze),
                GeneratedMotion(head[row : row + 1], gaze[row : row + 1]),
            )
            for row, (each, own_head, own_gaze) in enumerate(zip(states, heads, gazes, strict=True))
        ]


def concat_motions(parts: Sequence[GeneratedMotion]) -> GeneratedMotion:
    """Concatenate parts of a motion, perhaps none."""
    head = torch.cat([torch.zeros(1, 0, 3), *(part.head for part in parts)], dim=1)
    gaze = torch.cat([torch.zeros(1, 0, 2, 3), *(part.gaze for part in parts)], dim=1)
    return GeneratedMotion(head, gaze)
