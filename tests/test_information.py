"""Information of speech about motion: the likelihoods are proper, and what was planted in speech is found."""

from __future__ import annotations

import json
import math
from typing import get_args

import numpy as np
import pytest
import torch
from test_point_process import made

from pipelines import validate
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.report.information import ClipLikelihood, information, information_table
from talkingeyes.evaluation.report.validation_metrics import SelectionMetric
from talkingeyes.models.layers.point_process import EventSequence, PointProcess
from talkingeyes.orchestration.run import Workspace

BOOTSTRAP = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)
BINS, RATE = 40, 0.5


def events_at(happened: torch.Tensor) -> EventSequence:
    """Events in the marked bins, and in the first, all at the same location."""
    frames = happened.repeat_interleave(2, dim=1).clone()
    frames[:, 1::2] = False
    return EventSequence.from_frames(frames, torch.zeros(*frames.shape, 2), bin_frames=2)


@torch.no_grad()
def test_likelihoods_are_probabilities() -> None:
    process = made()
    happened = torch.tensor([[False, first, second] for first in (False, True) for second in (False, True)])
    condition = torch.randn(1, 3, 3).expand(4, -1, -1)
    found = process.log_likelihood(events_at(happened), condition)
    assert float(found["time"].exp().sum()) == pytest.approx(1, abs=1e-5)
    one = events_at(torch.tensor([[False, True]]))
    grid = torch.linspace(-12, 12, 241)
    where = torch.stack(torch.meshgrid(grid, grid, indexing="ij"), dim=-1).reshape(-1, 1, 2)
    locations = torch.cat([torch.zeros_like(where), where], dim=1)
    many = EventSequence(one.bins.expand(len(where), -1), locations, one.mask.expand(len(where), -1))
    density = process.log_likelihood(many, condition[:1, :2].expand(len(where), -1, -1))["location"].exp()
    assert float(density.sum()) * 0.01 == pytest.approx(1, abs=0.02)


@torch.no_grad()
def test_the_loss_is_the_mean_of_the_likelihood() -> None:
    process, condition = made(), torch.randn(2, BINS, 3)
    events = events_at(torch.rand(2, BINS) < RATE)
    loss, found = process.loss_terms(events, condition), process.log_likelihood(events, condition)
    assert float(loss["time"]) == pytest.approx(-float(found["time"].mean()) / (BINS - 1), rel=1e-5)


@pytest.mark.long
def test_speech_that_decides_every_event_gives_its_entropy() -> None:
    """A process that hears whether an event comes gains the entropy of a coin a bin over one that is deaf; a wrong
    sound costs it more than it ever gained."""
    hearing, deaf = (trained(hears) for hears in (True, False))
    happened = torch.rand(64, BINS, generator=torch.Generator().manual_seed(9)) < RATE
    scores = {
        "own": hearing.log_likelihood(events_at(happened), heard(happened)),
        "other": hearing.log_likelihood(events_at(happened), heard(happened.flip(0))),
        "deaf": deaf.log_likelihood(events_at(happened), torch.zeros(64, BINS, 3)),
    }
    rows = {
        name: [
            ClipLikelihood(str(clip), str(clip % 8), float(BINS - 1), {"gaze_time": value})
            for clip, value in enumerate(terms["time"].tolist())
        ]
        for name, terms in scores.items()
    }
    own, other = (information(rows[name], rows["deaf"], BOOTSTRAP)["gaze"] for name in ("own", "other"))
    assert own.low <= own.value <= own.high
    assert own.value == pytest.approx(math.log(2), abs=0.1)
    assert other.high < -math.log(2)


def heard(happened: torch.Tensor) -> torch.Tensor:
    return torch.stack([happened.float()] * 3, dim=-1)


def trained(hears: bool) -> PointProcess:
    process, rng = made(), torch.Generator().manual_seed(1)
    optimiser = torch.optim.Adam(process.train().parameters(), lr=1e-2)
    for _ in range(150):
        happened = torch.rand(32, BINS, generator=rng) < RATE
        condition = heard(happened) if hears else torch.zeros(32, BINS, 3)
        loss = process.loss_terms(events_at(happened), condition)["time"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return process.eval()


def test_parts_add_up_and_long_clips_weigh_more() -> None:
    hearing = [
        ClipLikelihood("a", "one", 1.0, {"head_time": 3.0, "gaze_time": 1.0}),
        ClipLikelihood("b", "two", 3.0, {"head_time": 0.0, "gaze_time": 2.0}),
    ]
    deaf = [ClipLikelihood(name, "", 0.0, {"head_time": 1.0, "gaze_time": 1.0}) for name in ("a", "b", "unheard")]
    found = {name: each.value for name, each in information(hearing, deaf, BOOTSTRAP).items()}
    assert found == {"total": 0.5, "head": 0.25, "gaze": 0.25, "head_time": 0.25, "gaze_time": 0.25}


def test_a_part_without_likelihood_has_an_empty_cell() -> None:
    gaze = {name: {"value": 0.5, "low": 0.25, "high": 0.75} for name in ("total", "gaze")}
    table = information_table({"live": {"unseen": {"own": gaze}}}, {"live": "Live"})
    assert table.splitlines()[-1] == "| Live | 0.50 (0.25 to 0.75) |  | 0.50 (0.25 to 0.75) |  |"


def test_validation_of_a_network_has_every_metric_of_selection(tiny, tmp_path) -> None:
    workspace = Workspace(tmp_path, Workspace.open(tiny).params)
    for part in ("synthesize", "fit", "embed", "critic", "train"):
        workspace.data(part).parent.mkdir(exist_ok=True)
        workspace.data(part).symlink_to(tiny / "data" / part)
    validate.run(workspace, "talkingeyes_events")
    figures = json.loads(workspace.data("validate", "talkingeyes_events", "metrics.json").read_text())
    assert set(get_args(SelectionMetric)) <= set(figures)
    parts = figures["log_likelihood_head"] + figures["log_likelihood_gaze"]
    assert figures["log_likelihood"] == pytest.approx(parts)


def test_the_stage_scores_every_split_and_finds_nothing_in_an_untrained_model(tiny) -> None:
    figures = json.loads((tiny / "data/information/untrained/metrics.json").read_text())
    assert set(figures) == {"val", "test", "unseen"}
    for split in figures.values():
        total = split["own"]["total"]
        assert np.isfinite(list(total.values())).all()
        assert total["value"] == pytest.approx(split["own"]["head"]["value"] + split["own"]["gaze"]["value"])
