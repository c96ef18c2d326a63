"""Streaming faces: embeddings of a few frames at a time in, expression and jaw out, of many streams in one step.

The result of each stream equals that of `SpeechToFace.generate` for the whole embedding (up to rounding:
tests/test_streaming.py). The model must be of conf/model/face_live.yaml's kind: causal speech layers, and the face
`causal`, which has no random part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.core.errors import InputError
from talkingeyes.models.face.causal import CausalFace
from talkingeyes.models.speech_stream import SpeechState, SpeechStreams
from talkingeyes.models.speech_to_face import SpeechToFace


@dataclass(frozen=True)
class FaceState:
    """A face between two parts of its embedding. States are never changed: a step that fails can be taken again."""

    speech: SpeechState
    past: Float[ndarray, "P W"]  # what the layers of the face keep


@dataclass(frozen=True)
class FaceStep:
    """The faces of some frames, and the stream after them."""

    state: FaceState
    face: Float[ndarray, "T F"]


class FaceStreams:
    """The streams of one network, of which many take a step at once."""

    def __init__(self, network: SpeechToFace) -> None:
        """Raises InputError for a network that looks at the whole speech."""
        if not isinstance(network.face, CausalFace) or network.speech.stack.lookahead is None:
            raise InputError("face: should be streamable (speech.lookahead, face causal), got another")
        self._network, self._face = network, network.face
        self._speech, self._layers = SpeechStreams(network.speech.stack), network.face.stack.streaming()

    def begin(self) -> FaceState:
        """A stream before its first frame."""
        return FaceState(self._speech.begin(), self._layers.begin())

    @torch.inference_mode()
    def listen(self, states: Sequence[FaceState], embedding: Float[Tensor, "B T C"]) -> list[FaceState]:
        """The streams with the features of a part of their embeddings."""
        speech = self._speech.step(
            [each.speech for each in states], self._network.speech.standardise(embedding).numpy()
        )
        return [FaceState(new, each.past) for new, each in zip(speech, states, strict=True)]

    def finish(self, state: FaceState) -> FaceState:
        """The stream with the features of its last frames."""
        return FaceState(self._speech.finish(state.speech), state.past)

    def step(self, states: Sequence[FaceState], styles: Sequence[Float[ndarray, "_T D"]]) -> list[FaceStep]:
        """The next faces of each stream, whose features have come: one for each style vector, perhaps none."""
        nothing = np.zeros((0, len(self._network.min_face)), np.float32)
        found = {row: FaceStep(state, nothing) for row, state in enumerate(states)}
        for frames in {len(style) for style in styles} - {0}:
            rows = [row for row, style in enumerate(styles) if len(style) == frames]
            steps = self._step([states[row] for row in rows], np.stack([styles[row] for row in rows]))
            found |= zip(rows, steps, strict=True)
        return [*found.values()]

    @torch.inference_mode()
    def _step(self, states: Sequence[FaceState], style: Float[ndarray, "B T D"]) -> list[FaceStep]:
        frames = style.shape[1]
        speech = np.concatenate([each.speech.pending[:, :frames] for each in states])
        fused = self._network.stylise(torch.from_numpy(speech), torch.from_numpy(style)).numpy()
        hidden, kept = self._layers.step(np.stack([each.past for each in states]), fused)
        faces = self._network.limit(self._face.decode(torch.from_numpy(hidden))).numpy()
        return [
            FaceStep(FaceState(each.speech.without(frames), own.copy()), face)
            for each, own, face in zip(states, kept, faces, strict=True)
        ]
