"""Sampling of a torch point process (point_process.py) by the numpy sampler (numpy_point_process.py)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.models.layers.convolution import torch_gelu
from talkingeyes.models.layers.numpy_layers import module_tensors, to_numpy
from talkingeyes.models.layers.numpy_point_process import NO_GUIDANCE, Guidance, SampledEvents, Sampler, SamplerWeights
from talkingeyes.models.layers.point_process import PointProcess


def make_sampler(process: PointProcess, temperature: float, guidance: Guidance = NO_GUIDANCE) -> Sampler:
    """A sampler with the current weights of a process."""
    settings = process.settings
    sds, return_sd = map(to_numpy, process.denoised_sds())
    weights = SamplerWeights(
        module_tensors(process),
        to_numpy(process.means()),
        sds,
        return_sd,
        settings.absolute_components,
        settings.previous_steps,
        settings.previous_locations,
    )
    return Sampler(weights, temperature, guidance, torch_gelu)


@torch.no_grad()
def sample_events(
    process: PointProcess,
    condition: Float[Tensor, "_ N C"],
    uniform: Float[Tensor, "B N U"],
    temperature: float,
    guidance: Guidance = NO_GUIDANCE,
    neutral: Float[Tensor, "_ N C"] | None = None,
) -> SampledEvents:
    """Sample events from D + 3 uniform numbers per bin, for one condition per row or one for all rows.

    `neutral`: the condition that guidance moves away from; with it, both are evaluated.
    """
    variants = [condition] if neutral is None else [condition, neutral]
    encoded = torch.stack([process.condition_encoder(each) for each in variants]).cpu().numpy()
    return make_sampler(process, temperature, guidance).sample(encoded, uniform.cpu().numpy())
