"""Places that were left: kept in a free run as they are told in training, and gone back to."""

import numpy as np
import torch

from talkingeyes.models.layers.event_drawing import Run
from talkingeyes.models.layers.event_process import EventProcess, EventProcessSettings, EventSequence
from talkingeyes.models.layers.event_returns import NEVER, Left, Returns
from talkingeyes.models.layers.event_steps import heading, headings_before

SETTINGS = EventProcessSettings(
    width=24,
    bin_frames=2,
    fixed=4,
    relative=2,
    codebook="learnt",
    adaptive=False,
    steps=0,
    returns=3,
    layers=1,
    dropout=0.0,
    history_dropout=0.0,
    history_noise=0.0,
)


def sequence(seed: int, count: int) -> EventSequence:
    random = torch.Generator().manual_seed(seed)
    bins = torch.randint(1, 9, (2, count), generator=random).cumsum(1)
    bins[:, 0] = 0
    return EventSequence(bins, torch.randn(2, count, 3, generator=random), torch.ones(2, count, dtype=torch.bool))


def test_a_free_run_leaves_places_as_training_tells_them():
    events, rows = sequence(0, 7), np.arange(2)
    told = Left.before(events.bins, events.places, 3)
    place, home, age = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32), np.zeros(2, int)
    still = heading(torch.zeros(2, 2, 3)).numpy()
    run = Run(np.zeros((2, 1)), place, home, still, age, np.zeros((2, 3, 3), np.float32), np.zeros((2, 3), np.float32))
    headings = headings_before(events.places, 2).numpy()
    for number in range(7):
        np.testing.assert_allclose(run.headings.reshape(2, -1), headings[:, number], rtol=1e-6)
        assert np.array_equal(run.held, told.held[:, number])
        known = run.held > 0
        assert np.array_equal(run.left[known], told.places[:, number].numpy()[known])
        here = torch.from_numpy(run.place)
        assert np.array_equal(run.home, Left(told.places[:, number], told.held[:, number]).home(here))
        run.go(rows, events.places[:, number].numpy())
        run.age = (events.bins[:, number + 1] - events.bins[:, number]).numpy() if number < 6 else run.age
    assert told.held[:, 0].sum() == told.held[:, 1].sum() == 0, "the first two events have left nothing"


def test_home_is_where_gaze_was_longest():
    places = torch.arange(6.0).reshape(1, 3, 2)
    present = torch.full((1, 2), 9.0)
    assert torch.equal(Left(places, torch.tensor([[2.0, 7.0, 1.0]])).home(present), places[:, 1])
    assert torch.equal(Left(places, torch.zeros(1, 3)).home(present), present)


def test_a_place_that_there_is_not_is_never_gone_to():
    torch.manual_seed(0)
    left = Left(torch.randn(1, 3, 3), torch.tensor([[4.0, 0.0, 2.0]]))
    logits = Returns(3, 8, (1.0, 1.0, 1.0)).logits(torch.randn(1, 8), left, torch.randn(1, 3))
    assert (logits == NEVER).tolist() == [[False, True, False]]


def alternating(count: int, seed: int) -> EventSequence:
    """Between two places of the sequence's own, again and again."""
    random = torch.Generator().manual_seed(seed)
    own = 2 * torch.randn(count, 2, 3, generator=random)
    places = own[:, [0, 1] * 4] + 0.02 * torch.randn(count, 8, 3, generator=random)
    bins = (torch.arange(8) * 5).expand(count, -1).contiguous()
    return EventSequence(bins, places, torch.ones(count, 8, dtype=torch.bool))


def test_it_learns_to_go_back():
    """Places are new in every sequence, so only what was left can tell where the third event leads."""
    torch.manual_seed(0)
    process = EventProcess(SETTINGS, 2, (1.0, 1.0, 1.0))
    adam = torch.optim.Adam(process.parameters(), lr=1e-2)
    for step in range(150):
        terms = process.terms(alternating(32, step), torch.zeros(32, 40, 2))
        adam.zero_grad()
        (terms["when"] + terms["where"]).backward()
        adam.step()
    process.eval()
    uniform = torch.rand(64, 40, 6, generator=torch.Generator().manual_seed(1))
    drawn = process.sample(torch.zeros(64, 40, 2), uniform, 1.0)
    near = []
    for event, place in zip(drawn.event, drawn.place, strict=True):
        gone = place[event]
        if len(gone) > 3:
            near += (np.linalg.norm(gone[2:4] - gone[:2], axis=1) < 0.5).tolist()
    assert len(near) > 60
    assert sum(near) > 0.8 * len(near)
