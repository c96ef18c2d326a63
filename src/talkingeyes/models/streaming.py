"""A trained network played part by part: embedding of a few frames in, head and gaze of the frames that follow out.

Gives what `SpeechToMotion.generate` gives for the whole embedding (to rounding: tests/test_streaming.py), a code of
gaze at a time. It takes a model that hears no farther ahead than its settings say (conf/model/talkingeyes_live.yaml):
causal speech layers, the head `causal_vae`, gaze `categorical` whose condition is not ahead.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.errors import InputError
from talkingeyes.models.gaze.categorical import CategoricalGaze
from talkingeyes.models.gaze.generator import SEED_OFFSET, Condition
from talkingeyes.models.gaze.signal import gaze_of
from talkingeyes.models.head.causal import CausalHead
from talkingeyes.models.layers.convolution import CausalConvolutionStack
from talkingeyes.models.speech_to_motion import Generated, SpeechToMotion


def frames_ahead(network: SpeechToMotion) -> int:
    """How many frames after its own the embedding must be known before a frame is given: all of its code, and `ahead`.

    Raises InputError for a model that hears the whole speech.
    """
    stack, gaze = network.speech.stack, network.gaze
    causal = isinstance(stack, CausalConvolutionStack) and isinstance(network.head, CausalHead)
    if network.conditions or network.wave is not None:
        raise InputError(
            "model: a stream is told nothing but its speech, got a model with conditions or a wave encoder"
        )
    if not causal or not isinstance(gaze, CategoricalGaze) or gaze.settings.condition_ahead:
        raise InputError(
            "model: should be one for streams (speech.ahead, head causal_vae, condition_ahead 0), got none"
        )
    assert isinstance(stack, CausalConvolutionStack)
    return stack.ahead + gaze.patch - 1


class MotionStream:
    """The state of one stream of one seed."""

    def __init__(self, network: SpeechToMotion, seed: int, temperature: float | None = None) -> None:
        frames_ahead(network)
        stack, head, gaze = network.speech.stack, network.head, network.gaze
        assert isinstance(stack, CausalConvolutionStack)
        assert isinstance(head, CausalHead)
        assert isinstance(gaze, CategoricalGaze)
        self._network, self._stack, self._head, self._gaze = network, stack, head, gaze
        self._temperature = float(network.temperature) if temperature is None else temperature
        self._past, self._turn, self._run = stack.start(1), head.start([seed]), gaze.start(1)
        self._uniform = torch.Generator().manual_seed(seed + SEED_OFFSET)
        self._early = stack.ahead  # what the layers say before the first frame
        self._heard = torch.zeros(1, 0, network.settings.speech.width)  # features of less than a code

    @torch.inference_mode()
    def push(self, embedding: Float[Tensor, "T C"]) -> Generated:
        """The motion that can be given now: whole codes, perhaps none. Parts of one length give the same bits."""
        return self._speak(self._network.speech.standard(embedding[None]))

    @torch.inference_mode()
    def finish(self) -> Generated:
        """The rest of the motion, the last code perhaps not whole."""
        found = self._speak(torch.zeros(1, self._stack.ahead, self._stack.enter.in_features))
        return joined([found, self._code(self._heard)]) if self._heard.shape[1] else found

    def _speak(self, standard: Float[Tensor, "1 T H"]) -> Generated:
        if not standard.shape[1]:
            return joined([])
        said = self._stack.step(standard, self._past)
        early = min(self._early, said.shape[1])
        self._early -= early
        self._heard = torch.cat([self._heard, said[:, early:]], dim=1)
        patch, parts = self._gaze.patch, []
        while self._heard.shape[1] >= patch:
            parts.append(self._code(self._heard[:, :patch]))
            self._heard = self._heard[:, patch:]
        return joined(parts)

    def _code(self, speech: Float[Tensor, "1 P S"]) -> Generated:
        """The frames of a code, or of its beginning where the stream ends."""
        head = self._head.step(speech, self._turn)
        memory = self._gaze.memory(Condition(speech, head, self._head.normal(head)))
        self._gaze.transformer.remember(memory, self._run.cache)
        drawn = torch.rand(1, generator=self._uniform)
        signal = self._gaze.advance(self._run, memory, drawn, self._temperature)[:, : speech.shape[1]]
        return Generated(head, gaze_of(self._gaze.codebook.settings.signal, head, signal))


def joined(parts: Sequence[Generated]) -> Generated:
    """Parts of a motion, one after another; perhaps none."""
    head = torch.cat([torch.zeros(1, 0, 3), *(part.head for part in parts)], dim=1)
    gaze = torch.cat([torch.zeros(1, 0, 2, 3), *(part.gaze for part in parts)], dim=1)
    return Generated(head, gaze)
