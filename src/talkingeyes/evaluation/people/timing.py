"""When people avert gaze in a conversation: by turns, around changes of turn, and how much turns tell about it.

For each person: the share of time averted in own turns, in the partner's and in neither; looks away a minute; how long
looks at the partner and away last (Kaplan & Meier 1958: the recording cuts the last one). Around starts and ends of own
turns: the share averted by lag, with its rise and its fall (windows of `measures/partner_gaze.py`). A change counts if
the turns before and after it last MIN_TURN_S, as long as the window before it reaches back.

Information of turns: the log-likelihood of the state (averted or not) given the time to the nearest start or end of an
own turn, less that under the turns of SHIFT_S before. Both are estimated from the other units (pairs or speakers), as
shares of frames in classes of 0.5 s, so gaze that ignores turns has 0, whatever its amount. In nats per second, with
one state a second: successive frames are nearly the same state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    Estimate,
    bootstrap,
    percentile_interval,
    ratio_statistic,
    resample_indices,
)
from talkingeyes.evaluation.measures.metric import safe_divide
from talkingeyes.evaluation.measures.partner_gaze import (
    AFTER_TURN_S,
    AT_ONSET_S,
    BEFORE_ONSET_S,
    averted_around,
    kaplan_meier_median,
    share_in_window,
)
from talkingeyes.evaluation.people.conversations import NEITHERS, OWN, PARTNERS, RATE_HZ, ConversationGaze, Turns

LAGS_S = np.arange(-30, 31) / 10
MIN_TURN_S = 2.0
MIN_TIME_S = 60.0  # of a row in own turns, the partner's or neither's
MIN_CHANGES = 20  # of turn in a row; below, curves are noise
REACH_S, CLASS_S = 3.0, 0.5
SHIFT_S = 60.0
ROLES = 3
START, END = range(2)
LAG_CLASSES = round(2 * REACH_S / CLASS_S)
CLASSES = 2 * LAG_CLASSES + ROLES
PRIOR = 0.5  # Krichevsky & Trofimov 1981, of each state in each class


@dataclass(frozen=True)
class Sums:
    """Sums over the people of U units; dwells are lists, one for each unit."""

    units: tuple[str, ...]
    averted: Float[ndarray, "U 3 2"]  # by role: averted frames, known frames
    onsets: Float[ndarray, " U"]
    changes: Float[ndarray, "U 2"]  # starts and ends of own turns
    curves: Float[ndarray, "U 2 2 L"]  # by kind of change: averted frames, known frames
    dwells: list[Float[ndarray, "N 3"]]  # seconds, averted, cut

    @classmethod
    def of(cls, people: Sequence[ConversationGaze]) -> Sums:
        """Sums by unit, in order of the names."""
        units = tuple(sorted({each.unit for each in people}))
        found = cls(
            units,
            np.zeros((len(units), ROLES, 2)),
            np.zeros(len(units)),
            np.zeros((len(units), 2)),
            np.zeros((len(units), 2, 2, len(LAGS_S))),
            [np.zeros((0, 3)) for _ in units],
        )
        for each in people:
            found._add(units.index(each.unit), each)
        return found

    def _add(self, row: int, gaze: ConversationGaze) -> None:
        role = gaze.turns.role(len(gaze.averted))
        for who in range(ROLES):
            within = gaze.known & (role == who)
            self.averted[row, who] += (gaze.averted & within).sum(), within.sum()
        self.onsets[row] += (np.diff(gaze.steady.astype(int)) > 0).sum()
        for kind, times_s in enumerate(gaze.turns.changes(MIN_TURN_S)):
            seen = [time_s for time_s in times_s if 0 < time_s < len(gaze.averted) / RATE_HZ]
            self.changes[row, kind] += len(seen)
            self.curves[row, kind] += averted_around(gaze.averted, gaze.known, RATE_HZ, np.array(seen), LAGS_S)
        self.dwells[row] = np.concatenate([self.dwells[row], _dwells(gaze.steady)])

    def chosen(self, units: Int[ndarray, " N"]) -> Sums:
        """The sums of some units, which may repeat, as one unit."""
        arrays = (each[units].sum(axis=0)[None] for each in (self.averted, self.onsets, self.changes, self.curves))
        averted, onsets, changes, curves = arrays
        dwells = [np.concatenate([self.dwells[unit] for unit in units])]
        return Sums(("all",), averted, onsets, changes, curves, dwells)


def _dwells(averted: Bool[ndarray, " T"]) -> Float[ndarray, "N 3"]:
    """Duration, state, and whether the end is cut off, of all dwells but the first, whose onset is not seen."""
    change = np.concatenate([np.flatnonzero(np.diff(averted)) + 1, [len(averted)]])
    lengths = np.diff(change) / RATE_HZ
    return np.stack([lengths, averted[change[:-1]], np.arange(len(lengths)) == len(lengths) - 1], axis=1)


@dataclass(frozen=True)
class TimingMeasure:
    """A measure of a group of people; NaN where the data do not suffice."""

    name: str
    title: str
    unit: str
    compute: Callable[[Sums], float]


def _share(role: int) -> Callable[[Sums], float]:
    def share(sums: Sums) -> float:
        averted, known = sums.averted[0, role]
        return float(averted / known) if known >= MIN_TIME_S * RATE_HZ else np.nan

    return share


def _looks_away(sums: Sums) -> float:
    return float(60 * RATE_HZ * sums.onsets[0] / sums.averted[0, :, 1].sum())


def _dwell(averted: bool) -> Callable[[Sums], float]:
    def median_s(sums: Sums) -> float:
        seconds, state, cut = sums.dwells[0].T
        chosen = state == averted
        return kaplan_meier_median(seconds[chosen], cut[chosen] > 0)

    return median_s


def _change(kind: int, to: tuple[float, float], sign: int) -> Callable[[Sums], float]:
    def change(sums: Sums) -> float:
        if sums.changes[0, kind] < MIN_CHANGES:
            return np.nan
        after, before = (share_in_window(sums.curves[0, kind], window, LAGS_S) for window in (to, BEFORE_ONSET_S))
        return float(sign * (after - before))

    return change


MEASURES: Sequence[TimingMeasure] = (
    TimingMeasure("own", "averted in own turns", "fraction", _share(OWN)),
    TimingMeasure("partners", "averted in the partner's turns", "fraction", _share(PARTNERS)),
    TimingMeasure("neithers", "averted in neither's", "fraction", _share(NEITHERS)),
    TimingMeasure("looks_away", "looks away", "1/min", _looks_away),
    TimingMeasure("look", "look at the partner, median", "s", _dwell(False)),
    TimingMeasure("aversion", "aversion, median", "s", _dwell(True)),
    TimingMeasure("start_rise", "rise at starts of own turns", "fraction", _change(START, AT_ONSET_S, 1)),
    TimingMeasure("end_fall", "fall at ends of own turns", "fraction", _change(END, AFTER_TURN_S, -1)),
)
INFORMATION = "information"
SCHEMA = "talkingeyes.timing/1"


def compare_timing(rows: Mapping[str, Sequence[ConversationGaze]], settings: BootstrapSettings) -> dict[str, Any]:
    """All rows with people, as JSON; a row without frames is left out."""
    titles = {each.name: {"title": each.title, "unit": each.unit} for each in MEASURES}
    titles[INFORMATION] = {"title": "information of turns about aversion", "unit": "nats/s"}
    found = {name: timing_row(people, settings) for name, people in rows.items() if people}
    return {"schema": SCHEMA, "lags_s": LAGS_S.tolist(), "measures": titles, "rows": found}


def timing_table(content: Mapping[str, Any]) -> list[list[str]]:
    """The table of all rows, with its heading."""
    titles = [
        each["title"] + (f", {each['unit']}" if each["unit"] != "fraction" else "")
        for each in content["measures"].values()
    ]
    table = [["", *titles, "starts, ends", "hours"]]
    for name, row in content["rows"].items():
        cells = [_cell(measure, row["measures"].get(measure)) for measure in content["measures"]]
        changes = "{start}, {end}".format(**row["changes"])
        table.append([name, *cells, changes, f"{row['seconds'] / 3600:.1f}"])
    return table


def _cell(measure: str, found: Mapping[str, float] | None) -> str:
    if found is None:
        return "-"
    digits = {INFORMATION: 4, "looks_away": 1}.get(measure, 2)
    return "{value:.{0}f} ({low:.{0}f} to {high:.{0}f})".format(digits, **found)


def timing_row(people: Sequence[ConversationGaze], settings: BootstrapSettings) -> dict[str, Any]:
    """All measures of a row as JSON, with intervals over units; and the share averted by lag."""
    sums = Sums.of(people)
    count = len(sums.units)
    values, *resampled = (
        _measured(sums.chosen(units)) for units in (np.arange(count), *resample_indices(count, settings))
    )
    estimates = {
        each.name: asdict(Estimate(float(value), *percentile_interval(draws, settings)))
        for each, value, draws in zip(MEASURES, values, np.transpose(resampled), strict=True)
        if np.isfinite(value)
    }
    if count > 1:
        estimates[INFORMATION] = asdict(turn_information(people, settings))
    averted, counted = np.moveaxis(sums.curves.sum(axis=0), 1, 0)
    changes = sums.changes.sum(axis=0).astype(int).tolist()
    return {
        "units": count,
        "people": len(people),
        "seconds": float(sums.averted[..., 1].sum() / RATE_HZ),
        "changes": dict(zip(("start", "end"), changes, strict=True)),
        "measures": estimates,
        "curves": {
            kind: [None if not np.isfinite(each) else round(float(each), 4) for each in curve]
            for kind, curve in zip(("start", "end"), safe_divide(averted, counted), strict=True)
        },
    }


def _measured(sums: Sums) -> Float[ndarray, " M"]:
    return np.array([each.compute(sums) for each in MEASURES])


def turn_classes(turns: Turns, frames: int) -> Int[ndarray, " T"]:
    """For each frame the class of its lag to the nearest start or end of an own turn; beyond REACH_S, who speaks."""
    role = turns.role(frames)
    edges = np.array([(edge, kind) for span in turns.own for kind, edge in enumerate((span.start_s, span.end_s))])
    if not len(edges):
        return np.asarray(2 * LAG_CLASSES + role)
    times_s = (np.arange(frames) + 0.5) / RATE_HZ
    edge_s, kind = edges.T
    nearest = np.abs(times_s[:, None] - edge_s).argmin(axis=1)
    lag_s = times_s - edge_s[nearest]
    within = np.abs(lag_s) < REACH_S
    lag_class = np.floor((lag_s + REACH_S) / CLASS_S).astype(int)
    return np.where(within, kind[nearest].astype(int) * LAG_CLASSES + lag_class, 2 * LAG_CLASSES + role)


def turn_information(people: Sequence[ConversationGaze], settings: BootstrapSettings) -> Estimate:
    """Information of turns about aversion in nats per second, with its interval over units (two or more)."""
    units = sorted({each.unit for each in people})
    lengths = [len(each.averted) for each in people]
    owner = np.repeat([units.index(each.unit) for each in people], lengths)
    averted, known = (np.concatenate([getattr(each, name) for each in people]) for name in ("averted", "known"))
    own = np.concatenate([turn_classes(each.turns, length) for each, length in zip(people, lengths, strict=True)])
    shifted = np.roll(own, round(SHIFT_S * RATE_HZ))
    gains = []
    for classes in (own, shifted):
        counts = np.zeros((len(units), CLASSES, 2))
        np.add.at(counts, (owner[known], classes[known], averted[known].astype(int)), 1)
        others = counts.sum(axis=0) - counts + PRIOR
        gains.append((counts * np.log(others / others.sum(axis=-1, keepdims=True))).sum(axis=(1, 2)))
    states = np.bincount(owner[known], minlength=len(units)).astype(float)
    return bootstrap(ratio_statistic(gains[0] - gains[1], states), len(units), settings)
