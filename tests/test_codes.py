"""Finite scalar and residual quantisation, annealing and free bits."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from talkingeyes.models.layers.conditional_vae import DiagonalGaussian
from talkingeyes.models.layers.elementwise import ElementwiseQuantiser, ElementwiseQuantiserSettings
from talkingeyes.models.layers.finite_scalar import FiniteScalarQuantiser, FiniteScalarQuantiserSettings
from talkingeyes.models.layers.gradient_quantiser import GradientQuantiser, GradientQuantiserSettings
from talkingeyes.models.layers.kl import AnnealingSettings, annealing_weight, free_bits_kl
from talkingeyes.models.layers.quantiser import Quantiser
from talkingeyes.models.layers.quantiser_factory import make_quantiser
from talkingeyes.models.layers.residual import ResidualQuantiser, ResidualQuantiserSettings
from talkingeyes.models.layers.schedules import set_trained_steps

LEVELS = st.lists(st.integers(2, 6), min_size=1, max_size=4).map(tuple)


def finite(levels: tuple[int, ...]) -> FiniteScalarQuantiser:
    return FiniteScalarQuantiser(FiniteScalarQuantiserSettings(kind="finite_scalar", levels=levels))


def residual(depth: int, level_codes: int = 8) -> ResidualQuantiserSettings:
    shared = {"width": 6, "commitment": 0.25, "decay": 0.9, "restart_below": 0.05}
    return ResidualQuantiserSettings(kind="residual", depth=depth, level_codes=level_codes, **shared)  # type: ignore[arg-type]


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


@hypothesis_settings(max_examples=25, deadline=None)
@given(LEVELS)
def test_all_levels_are_reached_and_indices_name_their_values(levels: tuple[int, ...]) -> None:
    quantiser = finite(levels)
    assert quantiser.codebook.shape == (math.prod(levels), len(levels))
    assert len(quantiser.codebook.unique(dim=0)) == quantiser.settings.codes
    torch.manual_seed(0)
    latents = 4 * torch.randn(1, 4000, len(levels))
    found = quantiser(latents)
    torch.testing.assert_close(quantiser.codebook[found.indices], found.values)
    for place, count in enumerate(levels):
        assert len(found.values[0, :, place].unique()) == count
    assert torch.equal(quantiser.distances(latents).argmin(-1), found.indices)
    assert found.commitment == 0


def test_the_gradient_passes_through_finite_scalars_as_through_the_bound() -> None:
    quantiser = finite((5, 4))
    latents = torch.randn(1, 7, 2, requires_grad=True)
    quantiser(latents).values.sum().backward()
    passed = latents.grad.clone()
    latents.grad = None
    quantiser.to_code_space(latents).sum().backward()
    torch.testing.assert_close(passed, latents.grad)
    assert (passed > 0).all()


def test_the_error_of_residual_codes_falls_with_depth() -> None:
    torch.manual_seed(0)
    errors = []
    data = torch.randn(40, 256, 6)
    for depth in (2, 3):
        quantiser = ResidualQuantiser(residual(depth)).train()
        levels = [quantiser.levels[0]]
        for batch in data:
            quantiser(batch[None])
        quantiser.eval()
        found = quantiser(data)
        first = levels[0]
        assert isinstance(first, Quantiser)
        errors += [(first(data).values - data).square().mean(), (found.values - data).square().mean()]
        assert found.indices.max() < quantiser.settings.codes
        torch.testing.assert_close(quantiser.codebook[found.indices], found.values, atol=1e-6, rtol=1e-5)
    one, two, _, three = errors
    assert three < 0.85 * two < 0.85 * 0.85 * one


def test_a_residual_index_is_the_digits_of_its_levels() -> None:
    quantiser = ResidualQuantiser(residual(2, 5))
    first, second = (level.codebook for level in quantiser.levels)
    torch.testing.assert_close(quantiser.codebook[3 * 5 + 2], first[3] + second[2])


def test_latents_that_are_not_used_do_not_move_residual_codes() -> None:
    quantiser = ResidualQuantiser(residual(2)).train()
    used = torch.ones(1, 64, dtype=torch.bool)
    used[:, 32:] = False
    for _ in range(5):
        latents = torch.randn(1, 64, 6)
        latents[:, 32:] = 1e4
        assert quantiser(latents, used).commitment < 100
    assert quantiser.codebook.abs().max() < 100


def test_too_many_combinations_are_an_error() -> None:
    with pytest.raises(ValueError, match="should be at most 4096, got 65536"):
        residual(2, 256)
    assert isinstance(make_quantiser(residual(2)), ResidualQuantiser)
    assert isinstance(make_quantiser(finite((3, 3)).settings), FiniteScalarQuantiser)


def test_annealing_rises_once_or_cyclically() -> None:
    linear = AnnealingSettings(shape="linear", steps=100)
    assert [annealing_weight(linear, step) for step in (0, 25, 100, 1000)] == [0.0, 0.25, 1.0, 1.0]
    cyclical = AnnealingSettings(shape="cyclical", steps=100)
    assert [annealing_weight(cyclical, step) for step in (0, 25, 50, 99, 100, 125)] == [0.0, 0.5, 1.0, 1.0, 0.0, 0.5]
    assert annealing_weight(None, 0) == 1.0


def test_free_bits_are_free_and_excess_costs_are_unchanged() -> None:
    mean = torch.tensor([0.01, 2.0]).expand(3, 4, 2).clone().requires_grad_()
    posterior = DiagonalGaussian(mean, torch.zeros(3, 4, 2))
    assert torch.equal(free_bits_kl(posterior.divergence_per_dim(), 0.0), posterior.divergence())
    free_bits_kl(posterior.divergence_per_dim(), 0.25).backward()
    assert (mean.grad[..., 0] == 0).all()
    assert (mean.grad[..., 1] > 0).all()
    empty = DiagonalGaussian(torch.zeros(3, 4, 2), torch.zeros(3, 4, 2))
    assert float(free_bits_kl(empty.divergence_per_dim(), 0.25)) == pytest.approx(0.25 * math.log(2))


def test_all_scheduled_parts_get_the_step() -> None:
    class Part(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.trained_steps = 0

    network = torch.nn.Sequential(Part(), torch.nn.Sequential(Part()), torch.nn.ReLU())
    set_trained_steps(network, 7)
    assert [each.trained_steps for each in network.modules() if isinstance(each, Part)] == [7, 7]
