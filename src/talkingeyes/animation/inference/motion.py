"""The default model of head and gaze in numpy: `SpeechToMotion` (models/speech_to_motion.py) with point processes.

Samples equal those of the torch model up to rounding (tests/test_inference.py). Other generators need torch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.inference.checkpoint import NumpyCheckpoint, bounded
from talkingeyes.animation.inference.networks import ConvolutionStack, SpeechProjection
from talkingeyes.animation.inference.torch_random import uniform
from talkingeyes.corpus.samples import Samples
from talkingeyes.models.gaze.saccade_rendering import SEED_OFFSET, eyes_towards, render_saccades
from talkingeyes.models.head.pose_interpolation import EXTRA_BINS, interpolate_poses
from talkingeyes.models.layers.numpy_layers import Tensors, tensors_under
from talkingeyes.models.layers.numpy_point_process import (
    NO_GUIDANCE,
    Guidance,
    SampledEvents,
    Sampler,
    SamplerWeights,
)


def can_generate_motion(config: Mapping[str, Any]) -> bool:
    """Whether a model has only components that exist in numpy."""
    model = config["model"]
    return bool(
        model["kind"] == "speech_to_motion"
        and model["head"]["kind"] == model["gaze"]["kind"] == "point_process"
        and not {"lookahead", "waveform_encoder"} & model["speech"].keys()
        and {each["kind"] for each in model["conditions"]} <= {"speaker", "emotion"}
        and not any("lookahead" in model[part]["process"] for part in ("head", "gaze"))
    )


@dataclass(frozen=True)
class _Process:
    """A point process with its condition encoder and its number of uniform numbers per bin."""

    encode: ConvolutionStack
    sampler: Sampler
    bin_frames: int
    numbers: int

    @classmethod
    def of(
        cls, tensors: Tensors, settings: Mapping[str, Any], temperature: float, guidance: Guidance = NO_GUIDANCE
    ) -> _Process:
        weights, bin_frames = SamplerWeights.of(tensors), bounded(settings["bin_frames"])
        stack = ConvolutionStack(tensors, "condition_encoder", settings)
        for name in ("absolute_components", "previous_steps", "previous_locations"):
            if settings[name] != getattr(weights, name):
                raise ValueError(f"{name}: should be {getattr(weights, name)} as in the tensors, got {settings[name]}")
        return cls(stack, Sampler(weights, temperature, guidance), bin_frames, weights.means.shape[1] + 3)

    def sample(self, variants: list[Float[ndarray, "_ T C"]], seeds: list[int], extra_bins: int = 0) -> SampledEvents:
        """Sample events, one row per seed, for one condition per row or one for all rows.

        `variants`: the condition, and with guidance that of mean speech.
        """
        binned = [bin_means(condition, self.bin_frames, extra_bins) for condition in variants]
        count = binned[0].shape[1]
        noise = np.stack([uniform(seed, count * self.numbers).reshape(count, self.numbers) for seed in seeds])
        return self.sampler.sample(np.stack([self.encode(each) for each in binned]), noise)


class NumpyMotionGenerator:
    """A trained model of head and gaze."""

    def __init__(self, checkpoint: NumpyCheckpoint) -> None:
        """Generates two frames: a damaged checkpoint raises KeyError, TypeError, ValueError, IndexError or
        ArithmeticError."""
        model, tensors = checkpoint.config["model"], checkpoint.tensors
        self._conditions: list[Mapping[str, Any]] = model["conditions"]
        is_speaker = any(each["kind"] == "speaker" for each in self._conditions)
        self.speakers: tuple[str, ...] = tuple(checkpoint.config["speakers"]) if is_speaker else ()
        guidance = Guidance.model_validate(model["gaze"]["guidance"])
        self._tensors, self._speech = tensors, SpeechProjection(tensors, model["speech"])
        self._head = _Process.of(
            tensors_under(tensors, "head.process"), model["head"]["process"], model["head"]["temperature"]
        )
        self._gaze = _Process.of(
            tensors_under(tensors, "gaze.process"), model["gaze"]["process"], float(tensors["temperature"]), guidance
        )
        self._fps: float = model["gaze"]["fps"]
        self.generate(np.zeros((2, len(tensors["speech.mean"])), np.float32), [0], self._fps)

    def generate(
        self,
        embedding: Float[ndarray, "T C"],
        seeds: list[int],
        fps: float,
        speaker: int | None = None,
        emotion: Float[ndarray, "T E"] | None = None,
    ) -> Samples:
        """Sample head and gaze; `speaker` is an index of `speakers`, None: unconditional; `emotion`: strengths of each
        frame, None: neutral. A seed gives the same motion in any batch."""
        speech = self._speech(embedding)
        head = self._sample_head(self._with_conditions(speech, speaker, emotion, "head"), seeds)
        guided = not self._gaze.sampler.guidance.is_one
        variants = [speech, self._speech.mean_features(len(embedding))] if guided else [speech]
        gaze = self._sample_gaze(
            [self._with_conditions(each, speaker, emotion, "gaze") for each in variants], head, seeds
        )
        return Samples(fps, head.astype(float), gaze.astype(float))

    def _with_conditions(
        self,
        speech: Float[ndarray, "1 T S"],
        speaker: int | None,
        emotion: Float[ndarray, "T E"] | None,
        part: str,
    ) -> Float[ndarray, "1 T F"]:
        """Speech features and the vectors of the conditions (models/condition/)."""
        found = [speech]
        for index, condition in enumerate(self._conditions):
            tensors = tensors_under(self._tensors, f"conditions.{index}")
            if condition["kind"] == "speaker":
                vectors = _speaker_vector(tensors, speaker, condition["embedding_scale"][part])[None]
            else:
                weight = tensors["emotions.weight"]
                vectors = np.zeros((1, len(weight)), np.float32) if emotion is None else emotion @ weight.T
            found.append(np.broadcast_to(vectors, (1, speech.shape[1], vectors.shape[-1])))
        return np.concatenate(found, axis=-1)

    def _sample_head(self, speech: Float[ndarray, "1 T S"], seeds: list[int]) -> Float[ndarray, "B T 3"]:
        sampled = self._head.sample([speech], seeds, EXTRA_BINS)
        poses = interpolate_poses(sampled.event, sampled.location, self._head.bin_frames)
        filtered = equalise(poses, self._tensors["head.equaliser.taps"])[:, : speech.shape[1]].astype(np.float32)
        return np.asarray(filtered * self._tensors["head.normal.scale"] + self._tensors["head.normal.mean"])

    def _sample_gaze(
        self, variants: list[Float[ndarray, "1 T S"]], head: Float[ndarray, "B T 3"], seeds: list[int]
    ) -> Float[ndarray, "B T 2 3"]:
        tensors, bin_frames = self._tensors, self._gaze.bin_frames
        normal = (head - tensors["head.normal.mean"]) / tensors["head.normal.scale"]
        conditions = [
            np.concatenate([np.broadcast_to(each, (len(head), *each.shape[1:])), normal], axis=-1) for each in variants
        ]
        sampled = self._gaze.sample(conditions, [seed + SEED_OFFSET for seed in seeds])
        starts_s = (np.arange(sampled.event.shape[1]) + sampled.phase) * bin_frames / self._fps
        directions = np.asarray(sampled.location * tensors["gaze.scale"] + tensors["gaze.centre"], float)
        times_s = np.arange(head.shape[1]) / self._fps
        return eyes_towards(head, render_saccades(sampled.event, starts_s, directions, times_s))


def _speaker_vector(tensors: Tensors, speaker: int | None, scale: float) -> Float[ndarray, " S"]:
    """The vector of a speaker (models/condition/speaker_embedding.py)."""
    symmetric, antisymmetric = (tensors[f"{name}.weight"] for name in ("symmetric", "antisymmetric"))
    if speaker is None:
        return np.asarray(symmetric[-1])
    mean = symmetric[:-1].mean(0)
    return np.asarray(mean + np.float32(scale) * (symmetric[speaker] + antisymmetric[speaker] - mean))


def bin_means(frames: Float[ndarray, "B T C"], bin_frames: int, extra_bins: int = 0) -> Float[ndarray, "B N C"]:
    """Means of bins, with `extra_bins` more that repeat the last frame (models/layers/point_process.py)."""
    count = math.ceil(frames.shape[1] / bin_frames) + extra_bins
    filled = np.pad(frames, ((0, 0), (0, count * bin_frames - frames.shape[1]), (0, 0)), mode="edge")
    return np.asarray(filled.reshape(len(frames), count, bin_frames, -1).mean(2))


def equalise(motion: Float[ndarray, "B T D"], taps: Float[ndarray, " L"]) -> Float[ndarray, "B T D"]:
    """Filter a motion that is padded by its first and last frame (models/layers/equaliser.py)."""
    if not len(taps):
        return motion
    half = len(taps) // 2
    still = np.pad(motion, ((0, 0), (half, half), (0, 0)), mode="edge")
    rows = [[np.convolve(each, taps, mode="valid") for each in row.T] for row in still]
    return np.stack(rows).swapaxes(1, 2)
