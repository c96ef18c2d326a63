"""Initialise a training from another model, for example from a motion prior trained without speech (UniLS).

The weights of head and gaze generators are copied. Weights of speech channels that the other model lacks start at zero,
so that the model initially moves like the other one and gradually learns to use the speech. Speakers that the other
model does not know start as its mean speaker.
"""

from __future__ import annotations

import re

import torch

from talkingeyes.core.errors import InputError
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.training.checkpoint import Checkpoint

SPEAKER_VECTORS = re.compile(r"conditions\.\d+\.(anti)?symmetric\.weight")
COPIED_PREFIXES = ("head.", "gaze.", "speech.stack.", "conditions.")
SPEECH_INPUT_WEIGHT = "speech.stack.input_projection.weight"


@torch.no_grad()
def init_from(network: SpeechToMotion, other: Checkpoint) -> None:
    """Copy the weights of a trained model. Raises InputError if its modules have other shapes."""
    same_speakers = list(network.speakers) == other.config.get("speakers")
    for name, own in network.state_dict().items():
        if not name.startswith(COPIED_PREFIXES):
            continue
        source = other.tensors.get(name)
        if source is not None and SPEAKER_VECTORS.fullmatch(name) and not same_speakers:
            own[:-1], own[-1] = source[:-1].mean(0), source[-1]  # the last is the unconditional vector
        elif source is not None and source.shape == own.shape:
            own.copy_(source)
        elif name == SPEECH_INPUT_WEIGHT:
            own.zero_()
        else:
            came = "none" if source is None else str(tuple(source.shape))
            raise InputError(
                f"init_from: should be a model of the same parts; {name} is {tuple(own.shape)}, got {came}"
            )
