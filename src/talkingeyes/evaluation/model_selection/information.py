"""Information that speech gives about motion, in nats per second.

It is the log-likelihood of the events of true motion under a model, less that under its twin that was trained without
speech input. The head is scored given speech, gaze given speech and head, so the parts add up to the information about
the whole motion (chain rule). What moves like people whatever the sound has none; under another sound it is negative
for a model that relies on speech. Intervals are over speakers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, ratio_statistic
from talkingeyes.evaluation.text_tables import markdown_table

PARTS = ("head", "gaze")
COLUMNS = ("total", *PARTS)


@dataclass(frozen=True)
class ClipLikelihood:
    """Log-likelihood of the motion of one clip in nats; terms are named by part (`head_time`)."""

    clip: str
    speaker: str
    seconds: float
    terms: Mapping[str, float]


def information(
    with_speech: Sequence[ClipLikelihood], without_speech: Sequence[ClipLikelihood], settings: BootstrapSettings
) -> dict[str, Estimate]:
    """Information of speech about the same clips: `total`, that of each part, and of each term.

    `without_speech` may hold more clips.
    """
    twin = {each.clip: each for each in without_speech}
    speakers = sorted({each.speaker for each in with_speech})
    seconds = np.zeros(len(speakers))
    gained: dict[str, np.ndarray] = {}
    for each in with_speech:
        row = speakers.index(each.speaker)
        seconds[row] += each.seconds
        for term, value in each.terms.items():
            gained.setdefault(term, np.zeros(len(speakers)))[row] += value - twin[each.clip].terms[term]
    parts = {part: [of for term, of in gained.items() if term.startswith(f"{part}_")] for part in PARTS}
    sums = {part: np.sum(of, axis=0) for part, of in parts.items() if of}
    figures = {"total": np.sum(list(sums.values()), axis=0), **sums, **gained}
    return {
        name: bootstrap(ratio_statistic(values, seconds), len(speakers), settings) for name, values in figures.items()
    }


def mean_log_likelihood(terms: Sequence[Mapping[str, float]], seconds: Sequence[float]) -> dict[str, float]:
    """Log-likelihood of all clips in nats per second, `log_likelihood`, and that of each part; empty without terms.

    Unlike information it needs no twin; it ranks models that are trained on the same events.
    """
    figures = {}
    for part in PARTS:
        values = [value for clip in terms for term, value in clip.items() if term.startswith(f"{part}_")]
        if values:
            figures[f"log_likelihood_{part}"] = sum(values) / sum(seconds)
    return {"log_likelihood": sum(figures.values()), **figures} if figures else {}


def information_table(rows: Mapping[str, Mapping[str, Any]], titles: Mapping[str, str]) -> str:
    """Markdown table of the rows of the stage `information`: {row: {split: {sound: {figure: estimate}}}}.

    A part without a likelihood has an empty cell.
    """
    splits = list(next(iter(rows.values())))
    headings = ["", *(f"{split}: {column}" for split in splits for column in COLUMNS), f"{splits[-1]}: another sound"]
    lines = []
    for name, row in rows.items():
        cells = [_cell(row[split]["own"].get(column)) for split in splits for column in COLUMNS]
        other = row[splits[-1]].get("other", {}).get("total")
        lines.append([titles.get(name, name), *cells, _cell(other)])
    return markdown_table(headings, lines)


def _cell(estimate: Mapping[str, float] | None) -> str:
    return "" if estimate is None else "{value:.2f} ({low:.2f} to {high:.2f})".format(**estimate)
