"""Interface of gaze generators: loss terms for true gaze in training, and sampling of gaze from speech and head motion.

Each generator is one file of this folder: `point_process`, `categorical`, `regression` (the paper) or `vae` (the
paper's baseline). docs/extend.md explains how to add one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from pydantic import BeforeValidator, SerializeAsAny
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings
from talkingeyes.models.gaze.saccade_rendering import SEED_OFFSET

GAZE_GENERATORS = ComponentRegistry(
    "gaze generator",
    {
        "categorical": "talkingeyes.models.gaze.categorical:CategoricalGaze",
        "point_process": "talkingeyes.models.gaze.point_process:PointProcessGaze",
        "regression": "talkingeyes.models.gaze.regression:RegressionGaze",
        "vae": "talkingeyes.models.gaze.vae:VAEGaze",
    },
    ("normalise_by", "loss_terms", "sample"),
)
GazeComponentSettings = Annotated[SerializeAsAny[ComponentSettings], BeforeValidator(GAZE_GENERATORS.parse)]


@dataclass(frozen=True)
class GazeCondition:
    """Inputs of a gaze generator. `head` is in radians; `normalised_head`, the input of the networks, is in standard
    deviations.

    In training, `normalised_head` may be a reconstruction of `head`. `mean_speech`, for guidance, is `speech` of mean
    speech (all standardised channels zero) with the same further conditions.
    """

    speech: Float[Tensor, "B T S"]
    head: Float[Tensor, "B T 3"]
    normalised_head: Float[Tensor, "B T 3"]
    mean_speech: Float[Tensor, "B T S"] | None = None


class GazeGenerator(Protocol):
    """Protocol of a torch module `Class(settings, speech, codebook)`; `speech` is the number of features per frame.

    `codebook` is the frozen tokenizer named in conf/model/, or None.
    """

    settings_class: Any

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """Set the statistics of eye-in-head in the train split; generators with a codebook ignore them."""
        ...

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Named loss terms for true gaze."""
        ...

    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Sample eye-in-head rotation vectors, one seed per row."""
        ...


@runtime_checkable
class BatchedGazeGenerator(Protocol):
    """Further member of a gaze generator that samples step by step, where many rows cost little more than one."""

    def sample_batch(
        self, conditions: Sequence[GazeCondition], seeds: Sequence[list[int]], temperature: float
    ) -> list[Float[Tensor, "_ _ 2 3"]]:
        """`sample` for each of several conditions of any lengths, in one batch."""
        ...


@runtime_checkable
class GuidedGazeGenerator(Protocol):
    """Further member of a gaze generator whose samples can be moved away from those for mean speech."""

    @property
    def is_guided(self) -> bool:
        """Whether sampling needs `mean_speech`."""
        ...


@runtime_checkable
class GazeLikelihood(Protocol):
    """Further member of a gaze generator whose true gaze has a likelihood."""

    def log_likelihood(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Named terms of the log-likelihood of true gaze, in nats per row, given speech and true head motion."""
        ...


class StreamingGaze(Protocol):
    """A gaze generator for streams, whose states are never changed: a step that fails can be taken again."""

    def begin(self, seed: int) -> Any:
        """The state of a stream before its first frame."""
        ...

    def step(self, states: Sequence[Any], condition: GazeCondition) -> tuple[Float[Tensor, "B T 2 3"], list[Any]]:
        """Eye-in-head of the next `step_frames` frames of each stream (fewer at its end), and the states after them."""
        ...


@runtime_checkable
class StreamableGazeGenerator(Protocol):
    """Further members of a gaze generator that can be streamed (models/motion_stream.py)."""

    @property
    def step_frames(self) -> int:
        """Frames per step."""
        ...

    @property
    def has_lookahead(self) -> bool:
        """Whether the configured generator uses input after the current step; if so, it cannot be streamed."""
        ...

    def streaming(self, temperature: float) -> StreamingGaze:
        """The generator for streams, which yield the result of `sample`."""
        ...


def concat_padded(parts: Sequence[Float[Tensor, "_ _ W"]]) -> tuple[Float[Tensor, "B T W"], Int[Tensor, " B"]]:
    """The rows of all parts, filled with zeros up to the longest, and their lengths."""
    rows = [row for part in parts for row in part]
    return pad_sequence(rows, batch_first=True), torch.tensor([len(row) for row in rows], device=rows[0].device)


def uniform_noise(seeds: list[int], count: int) -> Float[Tensor, "B N"]:
    """Uniform numbers, one seed per row: the same alone, in a batch and for a prefix."""
    return torch.stack(
        [torch.rand(count, generator=torch.Generator().manual_seed(seed + SEED_OFFSET)) for seed in seeds]
    )
