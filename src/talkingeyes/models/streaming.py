"""A trained network played part by part: embedding of a few frames in, head and gaze of the frames that follow out.

Gives what `SpeechToMotion.generate` gives for the whole embedding (to rounding: tests/test_streaming.py), a step of
gaze at a time. It takes a model that hears no farther ahead than its settings say (conf/model/talkingeyes_live.yaml):
causal speech layers, the head `causal_vae`, and gaze that depends on nothing ahead (`StreamedGaze`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.core.errors import InputError
from talkingeyes.models.gaze.generator import Condition, StreamedGaze
from talkingeyes.models.head.causal import CausalHead
from talkingeyes.models.layers.convolution import CausalConvolutionStack
from talkingeyes.models.speech_to_motion import Generated, SpeechToMotion


@dataclass(frozen=True)
class Streamed:
    """The parts of a network that can be played part by part."""

    speech: CausalConvolutionStack
    head: CausalHead
    gaze: StreamedGaze

    @classmethod
    def of(cls, network: SpeechToMotion) -> Streamed:
        """Raises InputError for a model that hears the whole speech, or what no stream can tell it."""
        if network.conditions or network.wave is not None:
            raise InputError(
                "model: a stream is told nothing but its speech, got a model with conditions or a wave encoder"
            )
        speech, head, gaze = network.speech.stack, network.head, network.gaze
        causal = isinstance(speech, CausalConvolutionStack) and isinstance(head, CausalHead)
        if not causal or not isinstance(gaze, StreamedGaze) or gaze.hears_ahead:
            raise InputError(
                "model: should be one for streams (speech.ahead, head causal_vae, gaze not told ahead), got none"
            )
        assert isinstance(speech, CausalConvolutionStack)
        assert isinstance(head, CausalHead)
        return cls(speech, head, gaze)

    @property
    def frames_ahead(self) -> int:
        """Frames after its own of which the embedding must be known before a frame is given."""
        return self.speech.ahead + self.gaze.step_frames - 1


class MotionStream:
    """The state of one stream of one seed."""

    def __init__(self, network: SpeechToMotion, seed: int, temperature: float | None = None) -> None:
        self._network, parts = network, Streamed.of(network)
        self._stack, self._step = parts.speech, parts.gaze.step_frames
        chosen = float(network.temperature) if temperature is None else temperature
        self._speech, self._head = parts.speech.stream(), parts.head.stream(seed)
        self._gaze = parts.gaze.stream(seed, chosen)
        self._early = parts.speech.ahead  # what the layers say before the first frame
        self._heard = torch.zeros(1, 0, network.settings.speech.width)  # features of less than a step

    @torch.inference_mode()
    def push(self, embedding: Float[Tensor, "T C"]) -> Generated:
        """The motion that can be given now: whole steps, perhaps none. Parts of one length give the same bits."""
        return self._speak(self._network.speech.standard(embedding[None]))

    @torch.inference_mode()
    def finish(self) -> Generated:
        """The rest of the motion, the last step perhaps not whole."""
        found = self._speak(torch.zeros(1, self._stack.ahead, self._stack.enter.in_features))
        return joined([found, self._moved(self._heard)]) if self._heard.shape[1] else found

    def _speak(self, standard: Float[Tensor, "1 T H"]) -> Generated:
        if not standard.shape[1]:
            return joined([])
        said = torch.from_numpy(self._speech.step(standard[0].numpy()))[None]
        early = min(self._early, said.shape[1])
        self._early -= early
        self._heard = torch.cat([self._heard, said[:, early:]], dim=1)
        parts = []
        while self._heard.shape[1] >= self._step:
            parts.append(self._moved(self._heard[:, : self._step]))
            self._heard = self._heard[:, self._step :]
        return joined(parts)

    def _moved(self, speech: Float[Tensor, "1 P S"]) -> Generated:
        """The frames of a step, or of its beginning where the stream ends."""
        head = self._head.step(speech)
        return Generated(head, self._gaze.step(Condition(speech, head, self._network.head.normal(head))))


def joined(parts: Sequence[Generated]) -> Generated:
    """Parts of a motion, one after another; perhaps none."""
    head = torch.cat([torch.zeros(1, 0, 3), *(part.head for part in parts)], dim=1)
    gaze = torch.cat([torch.zeros(1, 0, 2, 3), *(part.gaze for part in parts)], dim=1)
    return Generated(head, gaze)
