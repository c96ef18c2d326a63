"""What every gaze generator is: it predicts true gaze in training and samples gaze for speech and a head motion.

A generator is one file here: `events`, `categorical`, `regressed` (the paper) or `vae` (the paper's baseline);
docs/extend.md adds one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from pydantic import BeforeValidator, SerializeAsAny
from torch import Tensor

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings

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

# Gaze draws must not repeat the numbers that the head drew from the same seed.
SEED_OFFSET = 1_000_003


@dataclass(frozen=True)
class GazeCondition:
    """What gaze is generated for. `head` is in radians; `normalised_head`, what networks see, in its standard
    deviations.

    In training `normalised_head` may be a reconstruction of `head`.
    """

    speech: Float[Tensor, "B T S"]
    head: Float[Tensor, "B T 3"]
    normalised_head: Float[Tensor, "B T 3"]


class GazeGenerator(Protocol):
    """The role: a torch module made as `Class(settings, speech, codebook)`, `speech` features a frame.

    `codebook` is the frozen tokenizer that conf/model/ names, or None.
    """

    settings_class: Any

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """Take the statistics of eye-in-head in the train split; one with a codebook needs none."""
        ...

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Named terms of the loss for true gaze."""
        ...

    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Eye-in-head rotation vectors, a seed a row."""
        ...


@runtime_checkable
class GazeStream(Protocol):
    """The state of one stream of gaze."""

    def step(self, condition: GazeCondition) -> Float[Tensor, "1 T 2 3"]:
        """Eye-in-head of the next `step_frames` frames, or of fewer where the stream ends."""
        ...


@runtime_checkable
class StreamableGazeGenerator(Protocol):
    """What a gaze generator has besides if it can be played part by part (models/motion_stream.py)."""

    @property
    def step_frames(self) -> int:
        """How many frames are made together."""
        ...

    @property
    def has_lookahead(self) -> bool:
        """Whether it depends on what comes after its step, as it is configured; then it has no stream."""
        ...

    def stream(self, seed: int, temperature: float) -> GazeStream:
        """A new one, which gives what `sample` gives."""
        ...


def uniform_noise(seeds: list[int], count: int) -> Float[Tensor, "B N"]:
    """Uniform numbers, a seed a row: the same for a seed alone or in a batch, and for a prefix."""
    return torch.stack(
        [torch.rand(count, generator=torch.Generator().manual_seed(seed + SEED_OFFSET)) for seed in seeds]
    )
