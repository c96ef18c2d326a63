"""A training that starts from what another model has learnt: a motion prior that was learnt without sound (UniLS).

Head and gaze generators are taken as they are. What the other did not hear comes in with weight zero, so that the model
moves as the other at first, and sound takes hold of it from there.
"""

from __future__ import annotations

import torch

from talkingeyes.core.errors import InputError
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.training.checkpoint import Checkpoint

TAKEN = ("head.", "gaze.", "speech.stack.", "conditions.")
HEARS = "speech.stack.enter.weight"


@torch.no_grad()
def start_from(network: SpeechToMotion, other: Checkpoint) -> None:
    """Take the weights of a trained model. Raises InputError if its generators are others."""
    for name, own in network.state_dict().items():
        if not name.startswith(TAKEN):
            continue
        theirs = other.tensors.get(name)
        if theirs is not None and theirs.shape == own.shape:
            own.copy_(theirs)
        elif name == HEARS:
            own.zero_()
        else:
            came = "none" if theirs is None else str(tuple(theirs.shape))
            raise InputError(
                f"start_from: should be a model of the same parts; {name} is {tuple(own.shape)}, got {came}"
            )
