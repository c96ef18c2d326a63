"""The causal VAE of the head: streams, temperature and gain."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from talkingeyes.models.head.causal_vae import CausalVAEHead, CausalVAEHeadSettings
from talkingeyes.models.layers.conditional_vae import DiagonalGaussian

SPEECH, FRAMES = 5, 90
SETTINGS = {
    "kind": "causal_vae", "width": 8, "layers": 2, "dropout": 0.0, "latent": 3, "latent_frames": 6,
    "free_bits": 0.0,
}  # fmt: skip


def head(temperature: float = 1.0, gain: float = 1.5) -> CausalVAEHead:
    torch.manual_seed(0)
    settings = SETTINGS | {"temperature": temperature, "gain": gain}
    return CausalVAEHead(CausalVAEHeadSettings.model_validate(settings), SPEECH).eval()


def speech(seed: int = 0) -> Tensor:
    return torch.randn(2, FRAMES, SPEECH, generator=torch.Generator().manual_seed(seed))


@torch.no_grad()
def test_a_stream_is_the_sample_of_the_whole() -> None:
    model, features = head(), speech()
    streaming, parts = model.streaming(), []
    states = [streaming.begin(seed) for seed in (3, 4)]
    for each in features.split([1, 4, 25, 60], dim=1):
        part, states = streaming.step(states, each)
        parts.append(part)
    torch.testing.assert_close(torch.cat(parts, dim=1), model.sample(features, [3, 4]), atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_samples_differ_less_at_a_lower_temperature() -> None:
    same = speech()[:1].expand(40, -1, -1)
    spread = [head(temperature).sample(same, list(range(40))).std(dim=0).mean() for temperature in (1.0, 0.5)]
    assert 0.3 < spread[1] / spread[0] < 0.7


@torch.no_grad()
def test_gain_scales_what_samples_deviate_from_the_mean_pose() -> None:
    heads = [head(gain=gain) for gain in (1.0, 1.5)]
    for each in heads:
        each.normal.set(torch.tensor([0.1, 0.2, 0.3]), 0.05)
    one, other = (each.sample(speech(), [3, 4]) - each.normal.mean for each in heads)
    torch.testing.assert_close(other, 1.5 * one, atol=1e-6, rtol=1e-5)


@torch.no_grad()
def test_divergence_of_a_normal_distribution() -> None:
    posterior = DiagonalGaussian(torch.randn(2, 4, 3), torch.randn(2, 4, 3))
    expected = kl_divergence(Normal(posterior.mean, (0.5 * posterior.log_variance).exp()), Normal(0.0, 1.0))
    torch.testing.assert_close(posterior.divergence_per_dim(), expected)
