"""Sampling of models that exist in torch alone (the others: animation/inference/)."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.samples import Samples
from talkingeyes.models.condition.conditioner import ConditioningInputs
from talkingeyes.training.conditioning import pad_or_trim
from talkingeyes.training.motion_generators import TrainedGenerator, required_inputs


def sample_motion(
    generator: TrainedGenerator,
    embedding: Float[ndarray, "T C"],
    sound: Float[ndarray, " N"],
    seeds: list[int],
    fps: float,
    speaker: int | None,
    emotion: Float[ndarray, "T E"] | None = None,
) -> Samples:
    """Sample head and gaze, conditioned on speaker, emotion and waveform where the model requires them."""
    conditioning = ConditioningInputs(emotion=None if emotion is None else torch.from_numpy(emotion)[None])
    if speaker is not None:
        conditioning = replace(conditioning, speaker=torch.tensor([speaker]))
    if "sound" in required_inputs(generator):
        if not len(sound):
            raise InputError("sound: should be given to a model with a waveform encoder, got embedded speech")
        waveform = pad_or_trim(sound, round(len(embedding) * SAMPLE_RATE / fps))
        conditioning = replace(conditioning, sound=torch.from_numpy(waveform)[None])
    return generator.generate(embedding, seeds, fps, conditioning)
