"""Norms of the losses: means of standardised motion, or sums and means over radians."""

from __future__ import annotations

from typing import Any

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
    by_frame = losses.reconstruction(predicted, true, "radian_frame_mean")
    torch.testing.assert_close(by_frame, error.square().sum(dim=2).mean())


@pytest.mark.parametrize(("standardised", "scale"), [(False, 1.0), (True, 0.1)])
def test_networks_work_in_radians_or_in_standard_deviations(standardised: bool, scale: float) -> None:
    head = head_vae("radian_sum", standardised)
    head.normal.set(torch.ones(3), 0.1)
    network = tokenizer(1).network.model_copy(update={"norm": "radian_sum", "standardised": standardised})
    gaze = GazeVQVAE(network)
    gaze.normalise_by(torch.ones(6), 0.1)
    assert head.normal.scale.tolist() == pytest.approx([scale] * 3)
    assert float(gaze.scale) == gaze.loss_scale == pytest.approx(scale)


def head_vae(norm: str, standardised: bool, **changes: Any) -> VAEHead:
    torch.manual_seed(0)
    asked = {"kind": "vae", "norm": norm, "standardised": standardised, **VAE, **changes}
    return VAEHead(VAEHeadSettings.model_validate(asked), 4).eval()


def test_losses_in_radians_do_not_depend_on_the_unit_in_the_networks() -> None:
    """The loss of the predicted motion itself, in radians, whatever the networks work in."""
    speech, motion = torch.randn(2, 50, 4), 0.1 * torch.randn(2, 50, 3)
    head = head_vae("radian_mean", standardised=True)
    head.normal.set(motion.mean(dim=(0, 1)), 0.1)
    found = head.predict(speech, motion)
    expected = losses.reconstruction(found.head, motion, "radian_mean")
    torch.testing.assert_close(found.loss_terms["head_reconstruction"], expected)


def test_the_printed_divergence_of_the_head_sums_over_the_latent_code() -> None:
    """Eq. 13 against the mean over the same dimensions."""
    speech, motion = torch.randn(2, 50, 4), 0.1 * torch.randn(2, 50, 3)
    terms = {}
    for norm in ("radian_sum", "radian_mean", "standardised_mean"):
        terms[norm] = head_vae(norm, standardised=False, latent_frames=None).predict(speech, motion).loss_terms
    for norm in ("radian_sum", "radian_mean"):
        torch.testing.assert_close(terms[norm]["head_kl"], VAE["latent"] * terms["standardised_mean"]["head_kl"])
