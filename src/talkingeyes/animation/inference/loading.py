"""Trained models of a folder of the train stage, ready to generate: in numpy if it has all their components, else in
torch, which the base installation lacks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from talkingeyes.animation.inference.checkpoint import load_checkpoint
from talkingeyes.animation.inference.face import NumpyFaceGenerator, can_generate_face
from talkingeyes.animation.inference.motion import NumpyMotionGenerator, can_generate_motion
from talkingeyes.core.errors import InputError
from talkingeyes.models.face.basis import FaceBasis

if TYPE_CHECKING:
    from talkingeyes.training.face_generators import TrainedFaceGenerator
    from talkingeyes.training.motion_generators import TrainedGenerator

DAMAGED = (KeyError, TypeError, ValueError, IndexError, ArithmeticError)


def load_motion_generator(folder: Path) -> NumpyMotionGenerator | TrainedGenerator:
    """A model of head and gaze. Raises InputError if it is missing or damaged."""
    checkpoint = load_checkpoint(folder)
    try:
        if can_generate_motion(checkpoint.config):
            return NumpyMotionGenerator(checkpoint)
    except DAMAGED as error:
        raise InputError(f"{folder}: not a model of this version ({error!r}); `make repro` trains one") from None
    from talkingeyes.training.motion_generators import load_generator

    return load_generator(folder)


def load_face_model(folder: Path, head: FaceBasis) -> NumpyFaceGenerator | TrainedFaceGenerator:
    """A model of the face. Raises InputError if it is missing, damaged, or of another head model than `head`."""
    checkpoint = load_checkpoint(folder)
    try:
        generator = NumpyFaceGenerator(checkpoint) if can_generate_face(checkpoint.config) else None
    except DAMAGED as error:
        raise InputError(
            f"{folder}: not a face model of this version ({error!r}); `make report` trains probtalk3d"
        ) from None
    if generator is None:
        from talkingeyes.training.face_generators import load_face_generator

        return load_face_generator(folder, head)
    generator.basis.require_match(head, str(folder), "train one on faces of that head")
    return generator
