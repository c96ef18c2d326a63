"""Motion of the default chain beside motion tracked in real videos: the table of docs/log/2026-11-26-real-motion.md.

Run     python -m pipelines.real_motion        (after make real-videos and make report; half a minute)
Reads   build/real/corpus; corpus, fit and samples in data/ (test and unseen speakers; nothing is chosen by them)
Prints  for each measure its median over real clips, their mean difference, and each row's median with its distance

Distances are as in docs/people.md: |median of a row - median of the real clips| / mean difference of two real clips.
Ranges grow with length, so they are means over windows of WINDOW_S. A tracker's gain of eye angles is uncertain:
measures of the eyes have in brackets also the least distance over gains of GAINS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.real_videos import FOLDER, correlation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import head_speed_deg_s
from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.behaviour import Behaviour, behaviour
from talkingeyes.evaluation.bootstrap import BootstrapSettings, percentile_interval, resample_indices
from talkingeyes.evaluation.paper_metrics.summary import EvaluateSettings
from talkingeyes.evaluation.people.distance import PeopleValues
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import Workspace, parallel_map, run_command

WINDOW_S, STEP_S = 4.0, 0.2
GAINS = np.linspace(0.6, 1.4, 17)
ROWS = {"default": "talkingeyes_events", "live": "talkingeyes_live", "random": "random", "untrained": "untrained"}


@dataclass(frozen=True)
class ClipMeasure:
    """A figure of T frames; `of_eyes` if it grows with the gain of eye angles."""

    title: str
    compute: Callable[[Behaviour], float]
    of_eyes: bool = False


def _head_sd(axis: int, motion: Behaviour) -> float:
    assert motion.head is not None
    return float(np.degrees(motion.head[motion.valid, axis].std()))


def _eye_sd(axis: int, motion: Behaviour) -> float:
    return float(np.degrees(motion.eye_rad[motion.valid, :, axis].mean(axis=1).std()))


def _head_speed(quantile: float, motion: Behaviour) -> float:
    """Speed between frames that are STEP_S apart: between neighbours, a third of it is the tracker's noise."""
    assert motion.head is not None
    step = round(STEP_S * motion.fps)
    speed, valid = head_speed_deg_s(motion.head[::step], motion.fps / step), motion.valid[::step]
    return float(np.quantile(speed[valid[1:] & valid[:-1]], quantile))


def _eye_head_correlation(motion: Behaviour) -> float:
    return correlation(motion.eye_rad[motion.valid, :, 0].mean(axis=1), motion.head_rad[motion.valid, 0])


def _blinks_per_minute(motion: Behaviour) -> float:
    return 60 * len(motion.blinks) * motion.fps / motion.valid.sum() if motion.has("lid") else np.nan


MEASURES = (
    ClipMeasure("head yaw, SD, deg", partial(_head_sd, 1)),
    ClipMeasure("head pitch, SD, deg", partial(_head_sd, 0)),
    ClipMeasure("head roll, SD, deg", partial(_head_sd, 2)),
    ClipMeasure("head speed over 0.2 s, median, deg/s", partial(_head_speed, 0.5)),
    ClipMeasure("head speed over 0.2 s, 90th percentile, deg/s", partial(_head_speed, 0.9)),
    ClipMeasure("eye-in-head yaw, SD, deg", partial(_eye_sd, 0), of_eyes=True),
    ClipMeasure("eye-in-head pitch, SD, deg", partial(_eye_sd, 1), of_eyes=True),
    ClipMeasure("correlation of eye-in-head and head yaw", _eye_head_correlation),
    ClipMeasure("blinks per minute", _blinks_per_minute),
)


def measure_clip(motion: Behaviour) -> list[float]:
    """All measures: each the mean over the windows of a clip, of at least WINDOW_S unless the clip is shorter."""
    count = max(1, int(len(motion) / motion.fps / WINDOW_S))
    edges = np.linspace(0, len(motion), count + 1).astype(int)
    rows = [
        [measure.compute(window) for measure in MEASURES]
        for start, end in pairwise(edges.tolist())
        if (window := _cut(motion, start, end)).valid.sum() > motion.fps
    ]
    return np.mean(rows, axis=0).tolist() if rows else [np.nan] * len(MEASURES)


def _cut(motion: Behaviour, start: int, end: int) -> Behaviour:
    fields = {
        name: value[start:end] for name in ("head", "gaze", "lid") if (value := getattr(motion, name)) is not None
    }
    return behaviour(motion.fps, fields, motion.valid[start:end])


def _measure_motion(motion: Motion) -> list[float]:
    return measure_clip(
        behaviour(motion.fps, {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}, motion.valid)
    )


def _measure_real(corpus: Corpus, settings: FitSettings, clip: Clip) -> list[float]:
    fit = fit_clip(corpus.observation(clip), settings)
    return [np.nan] * len(MEASURES) if fit.reject_reason else _measure_motion(fit.motion)


def measure_rows(workspace: Workspace) -> Iterator[tuple[str, list[list[float]]]]:
    """Name and measures of the clips of each row: truth, fitted motion, and the first sample of each model."""
    corpus, fit = Corpus(workspace.corpus), workspace.data("fit")
    clips = corpus.select("test", "unseen", take=0)
    yield "truth", [_measure_motion(corpus.truth(clip)) for clip in clips]
    yield "fitted", [_measure_motion(Motion.load(shard_path(fit / "motion", clip.id, ".npz"))) for clip in clips]
    for title, name in ROWS.items():
        files = [shard_path(workspace.data("sample", name), clip.id, ".npz") for clip in clips]
        samples = [Samples.load(path) for path in files]
        yield (
            title,
            [measure_clip(behaviour(each.fps, {"head": each.head[0], "gaze": each.gaze[0]})) for each in samples],
        )


def distances(real: Float[ndarray, "M C"], row: Float[ndarray, "M N"]) -> Float[ndarray, "M 2"]:
    """Distance of each measure, as tracked and at the best gain of the eyes; NaN where a row lacks the measure."""
    unit, value = PeopleValues(real).between_people, PeopleValues(row).medians
    found = []
    for measure, median, other, between in zip(MEASURES, PeopleValues(real).medians, value, unit, strict=True):
        gains = GAINS if measure.of_eyes else np.ones(1)
        found.append([abs(other - median) / between, float(np.min(np.abs(other - gains * median) / between))])
    return np.array(found)


def mean_distance(
    real: Float[ndarray, "M C"], row: Float[ndarray, "M N"], settings: BootstrapSettings
) -> tuple[float, float, float]:
    """Mean distance over the measures that a row has, and its interval over clips of both."""
    resampled = zip(*(resample_indices(each.shape[1], settings) for each in (real, row)), strict=True)
    draws = np.array([np.nanmean(distances(real[:, some], row[:, others])[:, 0]) for some, others in resampled])
    return float(np.nanmean(distances(real, row)[:, 0])), *percentile_interval(draws, settings)


def table(real: Float[ndarray, "M C"], rows: Mapping[str, Float[ndarray, "M N"]], settings: BootstrapSettings) -> str:
    """The table in Markdown."""
    people = PeopleValues(real)
    found = {name: (PeopleValues(row).medians, distances(real, row)) for name, row in rows.items()}
    lines = []
    for index, measure in enumerate(MEASURES):
        cells = [
            _cell(medians[index], found_distances[index], measure.of_eyes)
            for medians, found_distances in found.values()
        ]
        low, high = people.ranges[index]
        recorded = f"{people.medians[index]:.2f} ({low:.2f} to {high:.2f})"
        lines.append([measure.title, recorded, f"{people.between_people[index]:.2f}", *cells])
    means = [mean_distance(real, row, settings) for row in rows.values()]
    lines.append(["mean distance", "", "", *(f"{value:.2f} ({low:.2f} to {high:.2f})" for value, low, high in means)])
    return markdown_table(["measure", "real clips (range)", "apart", *rows], lines)


def _cell(value: float, distance: Float[ndarray, " 2"], of_eyes: bool) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f} [{distance[0]:.2f}{f', {distance[1]:.2f}' if of_eyes else ''}]"


def main() -> None:
    """Measure and print."""
    if not (FOLDER / "corpus").is_dir():
        raise InputError(f"{FOLDER / 'corpus'}: should be the tracked corpus of make real-videos, got none")
    workspace = Workspace.open(Path.cwd())
    settings = validate_section("fit", FitSettings, compose(["fit=video"])["fit"])
    corpus = Corpus(FOLDER / "corpus")
    spoken = [clip for clip in corpus.clips if corpus.annotation(clip).speaking]
    real = np.array(list(parallel_map(partial(_measure_real, corpus, settings), spoken, 1, "fit"))).T
    rows = {name: np.array(values).T for name, values in measure_rows(workspace)}
    bootstrap = workspace.settings("evaluate", EvaluateSettings).bootstrap
    print(table(real[:, np.isfinite(real).any(axis=0)], rows, bootstrap))


if __name__ == "__main__":
    run_command(main)
