"""Norms of the losses: means of standardised motion, or sums over radians as printed."""

from __future__ import annotations

import pytest
import torch

from talkingeyes.models import losses
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.head.vae import VAEHead, VAEHeadSettings
from tests.test_gaze_models import VAE
from tests.test_training import tokenizer


def test_printed_norms_are_sums_over_frames_and_dimensions() -> None:
    """Eq. 11 and 12, written out for two clips."""
    torch.manual_seed(0)
    predicted, true = torch.randn(2, 7, 3), torch.randn(2, 7, 3)
    error = predicted - true
    torch.testing.assert_close(
        losses.reconstruction(predicted, true, "radian_sum"), error.square().sum(dim=(1, 2)).mean()
    )
    change = error[:, 1:] - error[:, :-1]
    torch.testing.assert_close(losses.velocity(predicted, true, "radian_sum"), change.square().sum(dim=(1, 2)).mean())
    torch.testing.assert_close(losses.reconstruction(predicted, true), error.square().mean())


@pytest.mark.parametrize(("norm", "scale"), [("radian_sum", 1.0), ("standardised_mean", 0.1)])
def test_a_model_with_printed_norms_stays_in_radians(norm: str, scale: float) -> None:
    head = VAEHead(VAEHeadSettings.model_validate({"kind": "vae", "norm": norm, **VAE}), 4)
    head.normal.set(torch.ones(3), 0.1)
    gaze = GazeVQVAE(tokenizer(1).network.model_copy(update={"norm": norm}))
    gaze.normalise_by(torch.ones(6), 0.1)
    assert head.normal.scale.tolist() == pytest.approx([scale] * 3)
    assert float(gaze.scale) == pytest.approx(scale)


def test_the_printed_divergence_of_the_head_sums_over_the_latent_code() -> None:
    """Eq. 13 against the mean over the same dimensions."""
    speech, motion = torch.randn(2, 50, 4), 0.1 * torch.randn(2, 50, 3)
    terms = {}
    for norm in ("radian_sum", "standardised_mean"):
        torch.manual_seed(0)
        settings = VAEHeadSettings.model_validate({"kind": "vae", "norm": norm, **VAE, "latent_frames": None})
        terms[norm] = VAEHead(settings, 4).eval().predict(speech, motion).loss_terms
    latent = VAE["latent"]
    torch.testing.assert_close(terms["radian_sum"]["head_kl"], latent * terms["standardised_mean"]["head_kl"])
