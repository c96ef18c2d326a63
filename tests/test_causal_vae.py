"""The causal VAE of the head: streams, and the prior of its codes."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from talkingeyes.models.head.causal_vae import CausalVAEHead, CausalVAEHeadSettings
from talkingeyes.models.layers.conditional_vae import DiagonalGaussian

SPEECH, FRAMES = 5, 90
SETTINGS = {
    "kind": "causal_vae", "width": 8, "layers": 2, "dropout": 0.0, "latent": 3, "latent_frames": 6,
    "kl": {"annealing": None, "free_bits": 0.0},
}  # fmt: skip


def head(prior: str, temperature: float = 1.0, gain: float = 1.5) -> CausalVAEHead:
    torch.manual_seed(0)
    settings = SETTINGS | {"prior": prior, "temperature": temperature, "gain": gain}
    made = CausalVAEHead(CausalVAEHeadSettings.model_validate(settings), SPEECH).eval()
    if made.prior:
        torch.nn.init.normal_(made.prior.moments.weight)
    return made


def speech(seed: int = 0) -> Tensor:
    return torch.randn(2, FRAMES, SPEECH, generator=torch.Generator().manual_seed(seed))


@pytest.mark.long
@pytest.mark.parametrize("prior", ["standard", "conditional"])
@torch.no_grad()
def test_a_stream_is_the_sample_of_the_whole(prior: str) -> None:
    model, features = head(prior), speech()
    stream = model.stream(3)
    parts = torch.cat([stream.step(each) for each in features[:1].split([1, 4, 25, 60], dim=1)], dim=1)
    torch.testing.assert_close(parts, model.sample(features, [3, 4])[:1], atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_the_conditional_prior_follows_speech_up_to_the_first_frame_that_needs_the_code() -> None:
    model, features = head("conditional"), speech()
    assert model.prior
    codes = torch.randn(2, FRAMES // 6, 3)
    before = model.prior(codes, features).mean
    for index in (1, 2, 7):
        changed = features.clone()
        changed[:, model.prior.last_frame(index) + 1 :] += 1.0
        after = model.prior(codes, changed).mean
        torch.testing.assert_close(after[:, : index + 1], before[:, : index + 1])
        assert (after[:, index + 1 :] - before[:, index + 1 :]).abs().max() > 0.01
        # No frame before that one depends on the code.
        moved = codes.clone()
        moved[:, index:] += 1.0
        spread = (model.vae_head.vae._interpolate_latents(each, FRAMES) for each in (codes, moved))
        first = next(spread), next(spread)
        needed = (first[0] != first[1]).any(dim=(0, 2)).nonzero().min()
        assert needed >= model.prior.last_frame(index)


@pytest.mark.parametrize("prior", ["standard", "conditional"])
@torch.no_grad()
def test_samples_differ_less_at_a_lower_temperature(prior: str) -> None:
    same = speech()[:1].expand(40, -1, -1)
    spread = [head(prior, temperature).sample(same, list(range(40))).std(dim=0).mean() for temperature in (1.0, 0.5)]
    assert 0.3 < spread[1] / spread[0] < 0.7


@torch.no_grad()
def test_gain_scales_what_samples_deviate_from_the_mean_pose() -> None:
    heads = [head("standard", gain=gain) for gain in (1.0, 1.5)]
    for each in heads:
        each.normal.set(torch.tensor([0.1, 0.2, 0.3]), 0.05)
    one, other = (each.sample(speech(), [3, 4]) - each.normal.mean for each in heads)
    torch.testing.assert_close(other, 1.5 * one, atol=1e-6, rtol=1e-5)


@torch.no_grad()
def test_divergence_from_another_normal_distribution() -> None:
    moments = [torch.randn(2, 4, 3) for _ in range(4)]
    posterior, prior = DiagonalGaussian(*moments[:2]), DiagonalGaussian(*moments[2:])
    expected = kl_divergence(*(Normal(each.mean, (0.5 * each.log_variance).exp()) for each in (posterior, prior)))
    torch.testing.assert_close(posterior.divergence_per_dim(prior), expected)
    standard = DiagonalGaussian(torch.zeros(2, 4, 3), torch.zeros(2, 4, 3))
    torch.testing.assert_close(posterior.divergence_per_dim(standard), posterior.divergence_per_dim())


@pytest.mark.long
@pytest.mark.parametrize(("prior", "follows"), [("standard", False), ("conditional", True)])
def test_sampled_codes_carry_speech_that_the_decoder_does_not_see(prior: str, follows: bool) -> None:
    """The head turns as speech did 18 frames before; the decoder sees 12."""
    model = head(prior).train()
    blocks = torch.randn(32, FRAMES // 6, SPEECH)
    features = blocks.repeat_interleave(6, dim=1)
    motion = torch.cat([features[..., :1].roll(18, 1), torch.zeros(32, FRAMES, 2)], dim=-1)
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    for _ in range(200):
        terms = model.predict(features, motion).loss_terms
        loss = terms["head_reconstruction"] + 0.05 * terms["head_kl"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        sampled = model.eval().sample(features, list(range(32)))
    pairs = torch.stack([each[:, 18:, 0].flatten() for each in (sampled, motion)])
    related = float(torch.corrcoef(pairs)[0, 1])
    assert related > 0.6 if follows else abs(related) < 0.2
