"""Quantisers, free bits and training schedules."""

from __future__ import annotations

import math

import pytest
import torch

from talkingeyes.models.layers.conditional_vae import DiagonalGaussian, free_bits_kl
from talkingeyes.models.layers.elementwise import ElementwiseQuantiser, ElementwiseQuantiserSettings
from talkingeyes.models.layers.gradient_quantiser import GradientQuantiser, GradientQuantiserSettings


def test_a_codebook_by_gradient_approaches_its_latents_alone() -> None:
    """Eq. 7: the second term moves the codes, the third the latents, and unused latents neither."""
    torch.manual_seed(0)
    quantiser = GradientQuantiser(
        GradientQuantiserSettings(kind="gradient_codebook", codes=4, width=3, commitment=0.25)
    )
    latents = torch.randn(2, 5, 3, requires_grad=True)
    used = torch.tensor([[True] * 5, [False] * 5])
    found = quantiser(latents, used)
    expected = (latents[0] - quantiser.codebook[found.indices[0]]).square().mean()
    torch.testing.assert_close(found.codebook_error, expected)
    torch.testing.assert_close(found.commitment, expected)
    found.codebook_error.backward()
    assert latents.grad is None
    assert set(torch.nonzero(quantiser.codebook.grad.abs().sum(1)).flatten().tolist()) == set(found.indices[0].tolist())
    quantiser.codebook.grad = None
    quantiser(latents, used).commitment.backward()
    assert quantiser.codebook.grad is None
    assert (latents.grad[0] != 0).all()
    assert (latents.grad[1] == 0).all()


@pytest.mark.parametrize("kind", ["codebook", "gradient_codebook"])
def test_factors_of_a_latent_share_a_codebook(kind: str) -> None:
    """Element-wise quantisation: each factor is replaced by its own nearest code; masked latents do not count."""
    torch.manual_seed(0)
    codebook = {"kind": kind, "codes": 5, "width": 3, "commitment": 0.25}
    more = {"decay": 0.9, "restart_below": 0.0} if kind == "codebook" else {}
    settings = {"kind": "elementwise", "factors": 2, "codebook": codebook | more}
    quantiser = ElementwiseQuantiser(ElementwiseQuantiserSettings.model_validate(settings)).eval()
    latents, used = torch.randn(2, 4, 6), torch.tensor([[True] * 4, [False] * 4])
    found = quantiser(latents, used)
    distances = torch.cdist(latents.reshape(-1, 3), quantiser.codebook).square()
    assert torch.equal(found.indices, distances.argmin(-1).reshape(2, 4, 2))
    torch.testing.assert_close(found.codes, quantiser.codebook[found.indices].flatten(2))
    torch.testing.assert_close(found.commitment, (latents[0] - found.codes[0]).square().mean())
    torch.testing.assert_close(quantiser.distances(latents).reshape(-1, 5), distances, atol=1e-4, rtol=1e-4)


def test_free_bits_are_free_and_excess_costs_are_unchanged() -> None:
    mean = torch.tensor([0.01, 2.0]).expand(3, 4, 2).clone().requires_grad_()
    posterior = DiagonalGaussian(mean, torch.zeros(3, 4, 2))
    assert torch.equal(free_bits_kl(posterior.divergence_per_dim(), 0.0), posterior.divergence())
    free_bits_kl(posterior.divergence_per_dim(), 0.25).backward()
    assert (mean.grad[..., 0] == 0).all()
    assert (mean.grad[..., 1] > 0).all()
    empty = DiagonalGaussian(torch.zeros(3, 4, 2), torch.zeros(3, 4, 2))
    assert float(free_bits_kl(empty.divergence_per_dim(), 0.25)) == pytest.approx(0.25 * math.log(2))
