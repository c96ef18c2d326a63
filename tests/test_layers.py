"""Attention, transformer, quantiser, convolution, conditional VAE: causality, caches, codes."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from talkingeyes.models.layers.attention import WindowAttention
from talkingeyes.models.layers.conditional_vae import ConditionalVAE, VAESettings
from talkingeyes.models.layers.quantiser import Quantiser, QuantiserSettings, perplexity
from talkingeyes.models.layers.transformer import CausalTransformer, CrossAttentionWindow, TransformerSettings

SETTINGS = TransformerSettings(width=16, layers=2, heads=2, dropout=0.0, lookback=7)
CODES = QuantiserSettings(kind="codebook", codes=16, width=4, commitment=0.25, decay=0.9, restart_below=0.1)


def _transformer(cross: CrossAttentionWindow | None) -> CausalTransformer:
    torch.manual_seed(0)
    return CausalTransformer(SETTINGS, cross).eval()


@pytest.mark.parametrize("cross", [None, CrossAttentionWindow(3, 2)])
def test_steps_with_a_cache_equal_the_parallel_pass(cross: CrossAttentionWindow | None) -> None:
    network = _transformer(cross)
    x = torch.randn(2, 30, 16)
    memory = torch.randn(2, 30, 16) if cross else None
    cache = network.start(memory)
    with torch.no_grad():
        stepped = torch.cat([network.step(x[:, i : i + 1], cache) for i in range(30)], dim=1)
        torch.testing.assert_close(stepped, network(x, memory), atol=2e-6, rtol=1e-5)


def test_causal_ignores_the_future_and_what_is_too_far_back() -> None:
    network = _transformer(None)
    x = torch.randn(1, 40, 16)
    changed = x.clone()
    changed[:, 20] = torch.randn(16)
    with torch.no_grad():
        moved = (network(changed) - network(x)).abs().amax(-1)[0]
    reach = SETTINGS.layers * SETTINGS.lookback
    assert moved[:20].max() == 0
    assert moved[20] > 1e-3
    assert moved[20 + reach + 1 :].max() == 0


def test_look_ahead_of_cross_attention_is_limited() -> None:
    network = _transformer(CrossAttentionWindow(3, 2))
    x, memory = torch.randn(1, 30, 16), torch.randn(1, 30, 16)
    changed = memory.clone()
    changed[:, 20] = torch.randn(16)
    with torch.no_grad():
        moved = (network(x, changed) - network(x, memory)).abs().amax(-1)[0]
    assert moved[:18].max() == 0
    assert moved[18] > 1e-4


def test_attention_depends_on_relative_position_only() -> None:
    torch.manual_seed(0)
    attention = WindowAttention(16, 2, lookback=5, lookahead=0, dropout=0.0).eval()
    x = torch.randn(1, 1, 16)
    memory = torch.randn(1, 6, 16)
    near = attention.step(x, 5, attention.project(memory, 0))
    far = attention.step(x, 10_005, attention.project(memory, 10_000))
    torch.testing.assert_close(near, far, atol=2e-3, rtol=1e-2)


def test_cache_does_not_grow() -> None:
    network = _transformer(None)
    cache = network.start()
    with torch.no_grad():
        for _ in range(50):
            network.step(torch.randn(1, 1, 16), cache)
    assert all(past is not None and past.keys.shape[2] == SETTINGS.lookback + 1 for past in cache.past)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31 - 1))
def test_quantiser_is_idempotent_and_codes_are_their_own_nearest(seed: int) -> None:
    torch.manual_seed(seed)
    quantiser = Quantiser(CODES).eval()
    first = quantiser(torch.randn(3, 5, 4))
    again = quantiser(first.values)
    assert torch.equal(first.indices, again.indices)
    torch.testing.assert_close(quantiser.codebook[first.indices], first.values)
    own = quantiser(quantiser.codebook[None])
    assert torch.equal(own.indices[0], torch.arange(16))


def test_quantiser_uses_its_codes_and_leaves_unused_latents_alone() -> None:
    torch.manual_seed(0)
    quantiser = Quantiser(CODES).train()
    centres = 5 * torch.randn(16, 4)
    for _ in range(200):
        latents = centres[torch.randint(16, (4, 32))] + 0.05 * torch.randn(4, 32, 4)
        used = torch.rand(4, 32) < 0.5
        latents[~used] = 1e3
        result = quantiser(latents, used)
    assert quantiser.codebook.abs().max() < 100, "latents that are not used must not move the codebook"
    counts = torch.bincount(result.indices[used], minlength=16)
    assert (counts > 0).sum() >= 13
    assert result.commitment < 1.0  # the centres vary by 25


def test_quantiser_passes_gradients_straight_through() -> None:
    quantiser = Quantiser(CODES).eval()
    latents = torch.randn(1, 3, 4, requires_grad=True)
    quantiser(latents).values.sum().backward()
    assert torch.equal(latents.grad, torch.ones_like(latents))


def test_perplexity_of_even_use_is_the_number_of_codes() -> None:
    assert perplexity(torch.full((8,), 3.0)) == pytest.approx(8)
    assert perplexity(torch.tensor([5.0, 0, 0, 0])) == pytest.approx(1)


@pytest.mark.parametrize("latent_frames", [25, None])
def test_conditional_vae_takes_any_length(latent_frames: int | None) -> None:
    torch.manual_seed(0)
    network = ConditionalVAE(
        VAESettings(width=16, layers=2, dropout=0.0, latent=4, latent_frames=latent_frames, free_bits=0.0),
        features=3,
        condition=5,
    ).eval()
    for frames in (10, 130, 1100):
        condition = torch.randn(2, frames, 5)
        codes = torch.randn(2, network.latent_count(frames), 4)
        assert network.decode(codes, condition).shape == (2, frames, 3)
    assert network.latent_count(200) == (8 if latent_frames else 1)
    assert network.latent_count(1100) == (44 if latent_frames else 3)


def test_interpolated_codes_keep_their_variance() -> None:
    network = ConditionalVAE(
        VAESettings(width=8, layers=1, dropout=0.0, latent=64, latent_frames=25, free_bits=0.0), features=3, condition=2
    )
    spread = network._interpolate_latents(torch.randn(64, 20, 64), 500)
    assert spread.std((0, 2)).sub(1).abs().max() < 0.08
