"""Marked point processes in bins: simulated structure is learned and reproduced in free running."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from talkingeyes.models.layers.point_process import EventSequence, PointProcess, PointProcessSettings
from talkingeyes.models.layers.point_process_sampler import sample_events
from talkingeyes.models.layers.previous_steps import previous_step_encodings

SETTINGS = {
    "width": 16,
    "bin_frames": 2,
    "absolute_components": 4,
    "relative_components": 2,
    "adaptive_components": True,
    "previous_steps": 2,
    "previous_locations": 2,
    "layers": 1,
    "dropout": 0.0,
    "history_dropout": 0.0,
    "history_noise": 0.0,
}


def made(**changes: object) -> PointProcess:
    torch.manual_seed(0)
    return PointProcess(PointProcessSettings.model_validate({**SETTINGS, **changes}), 3, (1.0, 0.5)).eval()


def learn(process: PointProcess, batch: Callable[[], EventSequence], steps: int, rate: float, bins: int) -> None:
    """Loss terms of events under a zero condition."""
    process.train()
    optimiser = torch.optim.Adam(process.parameters(), lr=rate)
    for _ in range(steps):
        events = batch()
        loss_terms = process.loss_terms(events, torch.zeros(len(events.bins), bins, 3))
        optimiser.zero_grad()
        (loss_terms["time"] + loss_terms["location"]).backward()
        optimiser.step()
    process.eval()


def test_events_of_frames() -> None:
    event = torch.zeros(1, 10, dtype=torch.bool)
    event[0, [1, 5, 8]] = True
    location = torch.arange(10.0)[None, :, None]
    found = EventSequence.from_frames(event, location, bin_frames=2)
    assert found.bins.tolist() == [[0, 2, 4]]  # an event in the first bin is the initial location
    assert found.locations[..., 0].tolist() == [[0.0, 5.0, 8.0]]
    assert found.mask.all()


def test_learns_rare_locations_in_all_directions() -> None:
    """One event in twenty lies on a wide ring, far from all initial components."""
    rng, bins = torch.Generator().manual_seed(2), 16

    def batch() -> EventSequence:
        angle = 2 * math.pi * torch.rand(32, bins, generator=rng)
        ring = 3.0 * torch.stack([angle.cos(), 0.5 * angle.sin()], -1)
        near = 0.1 * torch.randn(32, bins, 2, generator=rng)
        far = torch.rand(32, bins, 1, generator=rng) < 0.05
        event = torch.zeros(32, 2 * bins, dtype=torch.bool)
        event[:, ::2] = True
        return EventSequence.from_frames(event, torch.where(far, ring, near).repeat_interleave(2, dim=1), 2)

    process = made()
    learn(process, batch, 150, 1e-2, bins)
    sampled = sample_events(process, torch.zeros(64, 32, 3), torch.rand(64, 32, 5, generator=rng), 1.0)
    gone = np.abs(np.asarray(sampled.location)[np.asarray(sampled.event)] / (1.0, 0.5)).max(axis=1) > 1.5
    assert np.mean(gone) == pytest.approx(0.05, abs=0.02)


def test_learns_times_and_locations() -> None:
    """The condition determines the times of events and the side of their locations."""
    torch.manual_seed(1)
    process = made().train()
    optimiser = torch.optim.Adam(process.parameters(), lr=1e-2)

    def batch() -> tuple[Tensor, EventSequence]:
        cue = (torch.rand(32, 40) < 0.2).float()
        side = torch.randint(0, 2, (32, 40)) * 2.0 - 1
        condition = torch.stack([cue, side, torch.zeros_like(cue)], -1)
        location = torch.stack([side, torch.zeros_like(side)], -1) + 0.05 * torch.randn(32, 40, 2)
        marked = (cue > 0).repeat_interleave(2, dim=1)
        marked[:, 1::2] = False
        return condition, EventSequence.from_frames(marked, location.repeat_interleave(2, dim=1), 2)

    for _ in range(150):
        condition, events = batch()
        total = sum(process.loss_terms(events, condition).values())
        optimiser.zero_grad()
        total.backward()  # type: ignore[union-attr]
        optimiser.step()
    process.eval()
    condition, _ = batch()
    sampled = sample_events(process, condition, torch.rand(32, 40, 5), 1.0)
    cue, side = condition[:, 1:, 0].numpy(), condition[:, 1:, 1].numpy()
    happened = sampled.event[:, 1:]
    assert (happened == (cue > 0)).mean() > 0.95
    right = (np.sign(sampled.location[:, 1:, 0]) == side)[happened]
    assert right.mean() > 0.9


def test_learns_regression_to_the_centre() -> None:
    """Each event moves half the way to the centre; free running keeps the spread of the data."""
    torch.manual_seed(2)
    process = made(absolute_components=0, relative_components=3)

    def batch() -> EventSequence:
        locations = [torch.randn(32, 2)]
        for _ in range(12):
            locations.append(0.5 * locations[-1] + 0.5 * torch.randn(32, 2))
        bins = (3 * torch.arange(13)).expand(32, -1).contiguous()
        return EventSequence(bins, torch.stack(locations, 1), torch.ones(32, 13, dtype=torch.bool))

    learn(process, batch, 200, 2e-2, 40)
    sampled = sample_events(process, torch.zeros(200, 90, 3), torch.rand(200, 90, 5), 1.0)
    before, after = sampled.location[:, 30:-3].reshape(-1, 2), sampled.location[:, 33:].reshape(-1, 2)
    moved = (after != before).all(-1)
    slope = (after * before)[moved].sum() / (before[moved] ** 2).sum()
    assert 0.3 < slope < 0.7
    assert 0.45 < sampled.location[:, 30:].std() < 0.75  # sqrt(0.25 / 0.75) = 0.58


def told(locations: list[tuple[float, float]], count: int) -> list[list[float]]:
    return previous_step_encodings(torch.tensor([locations]), count)[0].tolist()


def test_previous_steps_are_encoded_by_direction_and_length() -> None:
    locations = [(1.0, 1.0), (4.0, 5.0), (4.0, 5.01)]
    none, far, near = [0.0, 0.0, math.log(0.05)], [3 / 5.05, 4 / 5.05, math.log(5.05)], [0.0, 1 / 6, math.log(0.06)]
    expected = [none + none, none + none, far + none, near + far]  # before each, and after the last
    np.testing.assert_allclose(told(locations, 2), expected, atol=1e-3)
    assert told(locations, 0) == [[], [], [], []]


def test_learns_direction_and_length_of_steps() -> None:
    """Each sequence has a direction and a step length between 0.1 and 3, which free running keeps."""
    torch.manual_seed(3)
    process = made(absolute_components=0, relative_components=4, previous_steps=1)
    bins = (2 * torch.arange(9)).expand(64, -1).contiguous()

    def batch() -> EventSequence:
        way = F.normalize(torch.randn(64, 1, 2), dim=-1) * 0.1 * 30 ** torch.rand(64, 1, 1)
        steps = way * (1 + 0.1 * torch.randn(64, 8, 2))
        locations = F.pad(steps, (0, 0, 1, 0)).cumsum(1)
        return EventSequence(bins, locations, torch.ones(64, 9, dtype=torch.bool))

    learn(process, batch, 250, 1e-2, 18)
    sampled = sample_events(process, torch.zeros(200, 18, 3), torch.rand(200, 18, 5), 1.0)
    steps = [
        np.diff(location[event], axis=0)[1:] for event, location in zip(sampled.event, sampled.location, strict=True)
    ]
    last, following = (np.concatenate([each[part] for each in steps]) for part in (slice(-1), slice(1, None)))
    far = [np.hypot(*each.T) for each in (last, following)]
    turned = (last * following).sum(1) / (far[0] * far[1])
    assert np.median(turned) > 0.9
    assert np.corrcoef(*np.log(far))[0, 1] > 0.8


@pytest.mark.long
def test_samples_exclude_observation_noise() -> None:
    """Locations jump between -1 and 1 and are observed with noise: samples lie closer to -1 and 1 than observations."""
    torch.manual_seed(4)
    noise = 0.2
    process = made(relative_components=4)
    bins = (2 * torch.arange(9)).expand(64, -1).contiguous()

    def batch() -> EventSequence:
        locations = torch.stack([2.0 * torch.randint(0, 2, (64, 9)) - 1, torch.zeros(64, 9)], -1)
        return EventSequence(bins, locations + noise * torch.randn_like(locations), torch.ones(64, 9, dtype=torch.bool))

    learn(process, batch, 300, 1e-2, 18)
    off = []
    for process.observation_noise[:] in (noise, 0.0):
        sampled = sample_events(process, torch.zeros(200, 18, 3), torch.rand(200, 18, 5), 1.0)
        off.append(np.sqrt(np.square(np.abs(sampled.location[sampled.event][:, 0]) - 1).mean()))
    assert off[0] < 0.7 * noise < 0.9 * noise < off[1]
