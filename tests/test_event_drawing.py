"""Free runs in numpy: from event to event is bin by bin, and both follow the formulas that the process learns with."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from test_event_process import made

from talkingeyes.models.layers.event_drawing import Drawing, Drawn
from talkingeyes.models.layers.event_process import EventProcess, EventSequence
from talkingeyes.models.layers.event_returns import Left


def lively(bias: float, **changes: object) -> EventProcess:
    """A process whose every weight counts: none is zero, and places that were left are gone back to."""
    process = made(fixed=3, relative=4, returns=3, **changes)
    with torch.no_grad():
        for weight in process.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
        process.hazard.bias.fill_(bias)
        process.returns.score.bias.fill_(1.0)
    return process


def bin_by_bin(drawing: Drawing, heard: np.ndarray, uniform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    run = drawing.begin(heard[:, 0], uniform[:, 0])
    events, places = [np.ones(len(heard), bool)], [run.place.copy()]
    for at in range(1, heard.shape[1]):
        events.append(drawing.advance(run, heard[:, at], uniform[:, at]))
        places.append(run.place.copy())
    return np.stack(events, 1), np.stack(places, 1)


@pytest.mark.parametrize("bias", [-6.0, -2.0, 3.0])  # hardly ever, now and then, in nearly every bin
def test_from_event_to_event_is_bin_by_bin(bias: float) -> None:
    process, condition, uniform = lively(bias), torch.randn(5, 90, 3), torch.rand(5, 90, 5)
    drawn = process.sample(condition, uniform, 1.0)
    with torch.no_grad():
        heard = process.listen(condition).numpy()
    events, places = bin_by_bin(Drawing(process, 1.0), heard, uniform.numpy())
    assert np.array_equal(drawn.event, events)
    np.testing.assert_allclose(drawn.place, places, atol=1e-5, rtol=1e-5)
    alone = process.sample(condition[:1], uniform[:1], 1.0)  # a row is the same alone
    assert np.array_equal(alone.event[0], drawn.event[0])
    np.testing.assert_allclose(alone.place[0], drawn.place[0], atol=1e-5, rtol=1e-5)


def sequence(drawn: Drawn) -> EventSequence:
    """What was drawn for one row, as training would be told of it."""
    bins = np.flatnonzero(drawn.event[0])
    return EventSequence(
        torch.from_numpy(bins)[None], torch.from_numpy(drawn.place[:, bins]), torch.ones(1, len(bins), dtype=torch.bool)
    )


@pytest.mark.parametrize(
    ("temperature", "changes"), [(1.0, {}), (0.5, {}), (1.0, {"steps": 0}), (1.0, {"adaptive": False})]
)
def test_a_free_run_follows_the_formulas_of_training(temperature: float, changes: dict[str, object]) -> None:
    """Hazards of all bins, and the Gaussian and the number of it at every event, under the events that were drawn."""
    process, condition, uniform = lively(-1.5, **changes), torch.randn(1, 160, 3), torch.rand(1, 160, 5)
    drawn = process.sample(condition, uniform, temperature)
    events = sequence(drawn)
    with torch.no_grad():
        heard = process.listen(condition)
        past = process._past(events, heard)
        features = process._features(past, heard)
        happens = uniform[0, 1:, 0] < process.hazard(features)[0, 1:, 0].sigmoid()
        left = Left.before(events.bins, events.places, process.settings.returns)
        at = events.bins[0]
        mixture = process._gaussians(features[:, at], past.place[:, at], Left(left.places[:, :-1], left.held[:, :-1]))
    assert np.array_equal(happens.numpy(), drawn.event[0, 1:])
    assert happens.sum() > 15
    share = (mixture.logits[0].double() / temperature).softmax(-1).cumsum(-1)
    chosen = (share < uniform[0, at, 2:3].double()).sum(-1)
    row = torch.arange(len(at))
    normal = torch.special.ndtri(uniform[0, at, 3:].double().clamp(1e-6, 1 - 1e-6)).float()
    place = mixture.centre[0][row, chosen] + temperature * normal * mixture.log_sd[0][row, chosen].exp()
    torch.testing.assert_close(events.places[0], place, atol=1e-4, rtol=1e-4)
    near = process.settings.fixed + process.settings.relative
    assert (chosen >= near).any() and (chosen < near).any(), "both kinds of Gaussians were drawn"


def test_without_a_temperature_the_most_probable_is_drawn() -> None:
    process, condition = lively(-1.5), torch.randn(1, 60, 3)
    one, other = (process.sample(condition, torch.rand(1, 60, 5), 0.0) for _ in range(2))
    np.testing.assert_array_equal(one.place[0, 0], other.place[0, 0])
