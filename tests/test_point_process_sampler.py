"""Sampling in numpy: event by event equals bin by bin, and both agree with the likelihood used in training."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from test_point_process import made

from talkingeyes.models.layers.numpy_point_process import NO_GUIDANCE, Guidance, SampledEvents, Sampler
from talkingeyes.models.layers.point_process import EventSequence, PointProcess
from talkingeyes.models.layers.point_process_sampler import make_sampler, sample_events
from talkingeyes.models.layers.revisit_mixture import PreviousLocations

STRONG = Guidance(time=1.5, location=2.5)


def lively(bias: float, **changes: object) -> PointProcess:
    """A process without zero weights, with revisits of previous locations."""
    process = made(absolute_components=3, relative_components=4, previous_locations=3, **changes)
    with torch.no_grad():
        for weight in process.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
        process.hazard.bias.fill_(bias)
        process.revisits.score.bias.fill_(1.0)
    return process


def bin_by_bin(sampler: Sampler, encoded_condition: np.ndarray, uniform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    run = sampler.begin(encoded_condition[:, :, 0], uniform[:, 0])
    events, locations = [np.ones(len(uniform), bool)], [run.location.copy()]
    for at in range(1, encoded_condition.shape[2]):
        events.append(sampler.advance(run, encoded_condition[:, :, at], uniform[:, at]))
        locations.append(run.location.copy())
    return np.stack(events, 1), np.stack(locations, 1)


# Rare, occasional, and in nearly every bin.
@pytest.mark.parametrize(("bias", "guidance"), [(-6.0, None), (-2.0, None), (3.0, None), (-2.0, STRONG)])
def test_sampling_by_event_equals_sampling_by_bin(bias: float, guidance: Guidance | None) -> None:
    process, condition, uniform = lively(bias), torch.randn(5, 90, 3), torch.rand(5, 90, 5)
    further = (guidance, torch.randn(1, 90, 3).expand(5, -1, -1)) if guidance else ()
    sampled = sample_events(process, condition, uniform, 1.0, *further)
    with torch.no_grad():
        encoded_condition = np.stack([process.condition_encoder(each).numpy() for each in (condition, *further[1:])])
    sampler = make_sampler(process, 1.0, *further[:1])
    events, locations = bin_by_bin(sampler, encoded_condition, uniform.numpy())
    assert np.array_equal(sampled.event, events)
    np.testing.assert_allclose(sampled.location, locations, atol=1e-5, rtol=1e-5)
    further = (guidance, further[1][:1]) if guidance else ()
    alone = sample_events(process, condition[:1], uniform[:1], 1.0, *further)  # a row is the same alone
    assert np.array_equal(alone.event[0], sampled.event[0])
    np.testing.assert_allclose(alone.location[0], sampled.location[0], atol=1e-5, rtol=1e-5)


def sequence(sampled: SampledEvents) -> EventSequence:
    """Sampled events of one row in the format of training."""
    bins = np.flatnonzero(sampled.event[0])
    return EventSequence(
        torch.from_numpy(bins)[None],
        torch.from_numpy(sampled.location[:, bins]),
        torch.ones(1, len(bins), dtype=torch.bool),
    )


@pytest.mark.parametrize(
    ("temperature", "changes", "guidance"),
    [
        (1.0, {}, NO_GUIDANCE),
        (0.5, {}, NO_GUIDANCE),
        (1.0, {"previous_steps": 0}, NO_GUIDANCE),
        (1.0, {"adaptive_components": False}, NO_GUIDANCE),
        (1.0, {"adaptive_components": False}, STRONG),
    ],
)
def test_free_running_agrees_with_training_likelihood(
    temperature: float, changes: dict[str, object], guidance: Guidance
) -> None:
    """Hazards of all bins, and mixture component and its index at every event, given the sampled events; with guidance
    extrapolated from those of a neutral condition."""
    process, condition, uniform = lively(-1.5, **changes), torch.randn(1, 160, 3), torch.rand(1, 160, 5)
    neutral = torch.randn(1, 160, 3)
    sampled = sample_events(process, condition, uniform, temperature, guidance, neutral)
    events = sequence(sampled)
    at = events.bins[0]
    log_odds, logits = [], []
    with torch.no_grad():
        for each in (neutral, condition):
            encoded_condition = process.condition_encoder(each)
            past = process._past(events, encoded_condition)
            features = process._features(past, encoded_condition)
            log_odds.append(process.hazard(features)[0, 1:, 0])
            previous_locations = PreviousLocations.before(
                events.bins, events.locations, process.settings.previous_locations
            )
            mixture = process._mixture(
                features[:, at],
                past.location[:, at],
                PreviousLocations(previous_locations.locations[:, :-1], previous_locations.dwell_bins[:, :-1]),
            )
            logits.append(mixture.logits[0])
    happens = uniform[0, 1:, 0] < torch.lerp(*log_odds, guidance.time).sigmoid()
    assert np.array_equal(happens.numpy(), sampled.event[0, 1:])
    assert happens.sum() > 15
    share = (torch.lerp(*logits, guidance.location).double() / temperature).softmax(-1).cumsum(-1)
    chosen = (share < uniform[0, at, 2:3].double()).sum(-1)
    row = torch.arange(len(at))
    normal = torch.special.ndtri(uniform[0, at, 3:].double().clamp(1e-6, 1 - 1e-6)).float()
    location = mixture.centre[0][row, chosen] + temperature * normal * mixture.log_sd[0][row, chosen].exp()
    torch.testing.assert_close(events.locations[0], location, atol=1e-4, rtol=1e-4)
    near = process.settings.absolute_components + process.settings.relative_components
    assert (chosen >= near).any() and (chosen < near).any(), "both kinds of Gaussians were drawn"


def test_zero_temperature_samples_the_mode() -> None:
    process, condition = lively(-1.5), torch.randn(1, 60, 3)
    one, other = (sample_events(process, condition, torch.rand(1, 60, 5), 0.0) for _ in range(2))
    np.testing.assert_array_equal(one.location[0, 0], other.location[0, 0])
