"""Streaming speech features: parts of an embedding in, features after a lookahead out, of many streams in one step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.models.layers.convolution import ConvolutionStack


@dataclass(frozen=True)
class SpeechState:
    """The features of a stream between two parts of its embedding. States are never changed."""

    past: Float[ndarray, "V P W"]  # what the layers keep; with guidance, a second row of mean speech
    frames_to_skip: int  # outputs before the first frame
    pending: Float[ndarray, "V F W"]  # features of the frames that have not been taken

    @property
    def frames(self) -> int:
        """Number of pending frames."""
        return int(self.pending.shape[1])

    def without(self, frames: int) -> SpeechState:
        """The state after the first pending frames are taken."""
        return replace(self, pending=self.pending[:, frames:])


class SpeechStreams:
    """The causal speech layers of a network (`SpeechProjection.stack`, with a lookahead)."""

    def __init__(self, stack: ConvolutionStack, variants: int = 1) -> None:
        """`variants` 2: also for mean speech, which is zero, beside each stream (guidance)."""
        assert stack.lookahead is not None
        self._lookahead, self._variants, self._layers = stack.lookahead, variants, stack.streaming()
        self._channels = stack.input_projection.in_features

    def begin(self) -> SpeechState:
        """A stream before its first frame."""
        past = np.stack([self._layers.begin()] * self._variants)
        return SpeechState(past, self._lookahead, np.zeros((self._variants, 0, past.shape[2]), np.float32))

    def step(self, states: Sequence[SpeechState], standardised: Float[ndarray, "B T H"]) -> list[SpeechState]:
        """The streams with the features of a part of their standardised embeddings."""
        if not standardised.shape[1]:
            return list(states)
        past = np.stack([each.past for each in states])
        given = np.stack([standardised, np.zeros_like(standardised)][: self._variants], axis=1)
        features, kept = self._layers.step(past.reshape(-1, *past.shape[2:]), given.reshape(-1, *given.shape[2:]))
        features = features.reshape(*past.shape[:2], *features.shape[1:])
        after = []
        for state, new, own in zip(states, features, kept.reshape(past.shape), strict=True):
            early = min(state.frames_to_skip, new.shape[1])
            pending = np.concatenate([state.pending, new[:, early:]], axis=1)
            after.append(SpeechState(own.copy(), state.frames_to_skip - early, pending))
        return after

    def finish(self, state: SpeechState) -> SpeechState:
        """The stream with the features of its last frames, after which the embedding is zero."""
        (after,) = self.step([state], np.zeros((1, self._lookahead, self._channels), np.float32))
        return after
