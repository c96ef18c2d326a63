"""Initialise a training from another model, for example from a motion prior trained without speech (UniLS).

The weights of head and gaze generators are copied. Weights of speech channels that the other model lacks start at zero,
so that the model initially moves like the other one and gradually learns to use the speech.
"""

from __future__ import annotations

import torch

from talkingeyes.core.errors import InputError
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.training.checkpoint import Checkpoint

COPIED_PREFIXES = ("head.", "gaze.", "speech.stack.", "conditions.")
SPEECH_INPUT_WEIGHT = "speech.stack.input_projection.weight"


@torch.no_grad()
def init_from(network: SpeechToMotion, other: Checkpoint) -> None:
    """Copy the weights of a trained model. Raises InputError if its modules have other shapes."""
    for name, own in network.state_dict().items():
        if not name.startswith(COPIED_PREFIXES):
            continue
        source = other.tensors.get(name)
        if source is not None and source.shape == own.shape:
            own.copy_(source)
        elif name == SPEECH_INPUT_WEIGHT:
            own.zero_()
        else:
            came = "none" if source is None else str(tuple(source.shape))
            raise InputError(
                f"init_from: should be a model of the same parts; {name} is {tuple(own.shape)}, got {came}"
            )
