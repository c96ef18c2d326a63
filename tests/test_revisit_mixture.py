"""Previous locations: the same in free running as in training, and revisited."""

import numpy as np
import torch

from talkingeyes.models.layers.numpy_point_process import SamplerState
from talkingeyes.models.layers.point_process import EventSequence, PointProcess, PointProcessSettings
from talkingeyes.models.layers.point_process_sampler import sample_events
from talkingeyes.models.layers.previous_steps import encode_step, previous_step_encodings
from talkingeyes.models.layers.revisit_mixture import MASKED_LOGIT, PreviousLocations, RevisitMixture

SETTINGS = PointProcessSettings(
    width=24,
    bin_frames=2,
    absolute_components=4,
    relative_components=2,
    adaptive_components=False,
    previous_steps=0,
    previous_locations=3,
    layers=1,
    dropout=0.0,
    history_dropout=0.0,
    history_noise=0.0,
)


def sequence(seed: int, count: int) -> EventSequence:
    rng = torch.Generator().manual_seed(seed)
    bins = torch.randint(1, 9, (2, count), generator=rng).cumsum(1)
    bins[:, 0] = 0
    return EventSequence(bins, torch.randn(2, count, 3, generator=rng), torch.ones(2, count, dtype=torch.bool))


def test_free_running_has_the_previous_locations_of_training():
    events, rows = sequence(0, 7), np.arange(2)
    given = PreviousLocations.before(events.bins, events.locations, 3)
    location, longest_dwell_location, age = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32), np.zeros(2, int)
    still = encode_step(torch.zeros(2, 2, 3)).numpy()
    run = SamplerState(
        np.zeros((1, 2, 1)),
        location,
        longest_dwell_location,
        still,
        age,
        np.zeros((2, 3, 3), np.float32),
        np.zeros((2, 3), np.float32),
    )
    step_encodings = previous_step_encodings(events.locations, 2).numpy()
    for number in range(7):
        np.testing.assert_allclose(run.step_encodings.reshape(2, -1), step_encodings[:, number], rtol=1e-6)
        assert np.array_equal(run.dwell_bins, given.dwell_bins[:, number])
        known = run.dwell_bins > 0
        assert np.array_equal(run.previous_locations[known], given.locations[:, number].numpy()[known])
        here = torch.from_numpy(run.location)
        assert np.array_equal(
            run.longest_dwell_location,
            PreviousLocations(given.locations[:, number], given.dwell_bins[:, number]).longest_dwell_location(here),
        )
        run.move_to(rows, events.locations[:, number].numpy())
        run.age = (events.bins[:, number + 1] - events.bins[:, number]).numpy() if number < 6 else run.age
    assert given.dwell_bins[:, 0].sum() == given.dwell_bins[:, 1].sum() == 0, "the first two events have left nothing"


def test_longest_dwell_location():
    locations = torch.arange(6.0).reshape(1, 3, 2)
    present = torch.full((1, 2), 9.0)
    assert torch.equal(
        PreviousLocations(locations, torch.tensor([[2.0, 7.0, 1.0]])).longest_dwell_location(present), locations[:, 1]
    )
    assert torch.equal(PreviousLocations(locations, torch.zeros(1, 3)).longest_dwell_location(present), present)


def test_missing_locations_are_never_revisited():
    torch.manual_seed(0)
    previous_locations = PreviousLocations(torch.randn(1, 3, 3), torch.tensor([[4.0, 0.0, 2.0]]))
    logits = RevisitMixture(3, 8, (1.0, 1.0, 1.0)).logits(torch.randn(1, 8), previous_locations, torch.randn(1, 3))
    assert (logits == MASKED_LOGIT).tolist() == [[False, True, False]]


def alternating(count: int, seed: int) -> EventSequence:
    """Events that alternate between two locations of the sequence."""
    rng = torch.Generator().manual_seed(seed)
    own = 2 * torch.randn(count, 2, 3, generator=rng)
    locations = own[:, [0, 1] * 4] + 0.02 * torch.randn(count, 8, 3, generator=rng)
    bins = (torch.arange(8) * 5).expand(count, -1).contiguous()
    return EventSequence(bins, locations, torch.ones(count, 8, dtype=torch.bool))


def test_learns_revisits():
    """Locations differ between sequences, so only previous locations predict the third event."""
    torch.manual_seed(0)
    process = PointProcess(SETTINGS, 2, (1.0, 1.0, 1.0))
    adam = torch.optim.Adam(process.parameters(), lr=1e-2)
    for step in range(150):
        loss_terms = process.loss_terms(alternating(32, step), torch.zeros(32, 40, 2))
        adam.zero_grad()
        (loss_terms["time"] + loss_terms["location"]).backward()
        adam.step()
    process.eval()
    uniform = torch.rand(64, 40, 6, generator=torch.Generator().manual_seed(1))
    sampled = sample_events(process, torch.zeros(64, 40, 2), uniform, 1.0)
    near = []
    for event, location in zip(sampled.event, sampled.location, strict=True):
        gone = location[event]
        if len(gone) > 3:
            near += (np.linalg.norm(gone[2:4] - gone[:2], axis=1) < 0.5).tolist()
    assert len(near) > 60
    assert sum(near) > 0.8 * len(near)
