"""Streaming generation: consumes the embedding of a few frames at a time and yields head and gaze.

The result equals that of `SpeechToMotion.generate` for the whole embedding (up to rounding: tests/test_streaming.py),
one gaze step at a time. The model must have limited lookahead (conf/model/talkingeyes_live.yaml): causal speech layers,
the head `causal_vae`, and gaze without lookahead (`StreamableGazeGenerator`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.core.errors import InputError
from talkingeyes.models.gaze.generator import GazeCondition, StreamableGazeGenerator
from talkingeyes.models.head.causal_vae import CausalVAEHead
from talkingeyes.models.layers.convolution import ConvolutionStack
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


class MotionStream:
    """State of one stream with one seed."""

    def __init__(self, network: SpeechToMotion, seed: int, temperature: float | None = None) -> None:
        self._network, parts = network, StreamingModules.of(network)
        self._step, self._lookahead = parts.gaze.step_frames, parts.speech_lookahead
        chosen = float(network.temperature) if temperature is None else temperature
        # With guidance, the features of mean speech are a second row.
        self._speech = [parts.speech.stream() for _ in range(1 + network.is_guided)]
        self._head = parts.head.stream(seed)
        self._gaze = parts.gaze.stream(seed, chosen)
        self._frames_to_skip = self._lookahead  # outputs before the first frame
        self._pending_features = torch.zeros(len(self._speech), 0, network.settings.speech.width)  # less than a step

    @torch.inference_mode()
    def push(self, embedding: Float[Tensor, "T C"]) -> GeneratedMotion:
        """Motion that can be generated now: whole steps, perhaps none. Chunks of equal length give bit-identical
        results."""
        return self._push_embedding(self._network.speech.standardise(embedding[None]))

    @torch.inference_mode()
    def finish(self) -> GeneratedMotion:
        """The rest of the motion; the last step may be incomplete."""
        channels = self._network.speech.stack.input_projection.in_features
        found = self._push_embedding(torch.zeros(1, self._lookahead, channels))
        return (
            concat_motions([found, self._generate_step(self._pending_features)])
            if self._pending_features.shape[1]
            else found
        )

    def _push_embedding(self, standardise: Float[Tensor, "1 T H"]) -> GeneratedMotion:
        if not standardise.shape[1]:
            return concat_motions([])
        frames = standardise[0].numpy()
        inputs = (frames, np.zeros_like(frames))[: len(self._speech)]  # mean speech is zero
        pairs = zip(self._speech, inputs, strict=True)
        features = torch.stack([torch.from_numpy(stream.step(each)) for stream, each in pairs])
        early = min(self._frames_to_skip, features.shape[1])
        self._frames_to_skip -= early
        self._pending_features = torch.cat([self._pending_features, features[:, early:]], dim=1)
        parts = []
        while self._pending_features.shape[1] >= self._step:
            parts.append(self._generate_step(self._pending_features[:, : self._step]))
            self._pending_features = self._pending_features[:, self._step :]
        return concat_motions(parts)

    def _generate_step(self, speech: Float[Tensor, "V P S"]) -> GeneratedMotion:
        """Motion of one step, or of its beginning at the end of the stream."""
        head = self._head.step(speech[:1])
        mean = speech[1:] if self._network.is_guided else None
        return GeneratedMotion(
            head, self._gaze.step(GazeCondition(speech[:1], head, self._network.head.normal(head), mean))
        )


def concat_motions(parts: Sequence[GeneratedMotion]) -> GeneratedMotion:
    """Concatenate parts of a motion, perhaps none."""
    head = torch.cat([torch.zeros(1, 0, 3), *(part.head for part in parts)], dim=1)
    gaze = torch.cat([torch.zeros(1, 0, 2, 3), *(part.gaze for part in parts)], dim=1)
    return GeneratedMotion(head, gaze)
