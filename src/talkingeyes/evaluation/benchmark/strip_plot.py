"""Strip plot: all metrics of one or several sets of motions, relative to the interval of the reference.

The difference to the reference value is divided by half the width of its interval: values between -1 and 1 lie within
the interval of the reference. Beyond 1 the axis is logarithmic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from talkingeyes.evaluation.benchmark.comparison import MetricResult

COLUMNS = 2
AXIS_LIMIT = 300.0


def plot_strips(tables: Mapping[str, Sequence[MetricResult]], colours: Mapping[str, str], path: Path) -> None:
    """Write a PNG of the rows of each named table; metrics without a reference value are omitted."""
    from matplotlib.figure import Figure

    shown = [(name, rows) for name, rows in _by_measure(tables).items() if any(row.reference for row in rows.values())]
    height = -(-len(shown) // COLUMNS)
    figure = Figure(figsize=(12.5, 1.4 + 0.24 * max(height, 4)), layout="constrained")
    for axis, start in zip(figure.subplots(1, COLUMNS, squeeze=False)[0], (0, height), strict=True):
        _strips(axis, shown[start : start + height], tables, colours)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if len(tables) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    figure.suptitle("difference to the reference, in half widths of its interval (grey: the interval)", fontsize=10)
    figure.savefig(path, dpi=110, format="png", metadata={"Software": None})


def _by_measure(tables: Mapping[str, Sequence[MetricResult]]) -> dict[str, dict[str, MetricResult]]:
    found: dict[str, dict[str, MetricResult]] = {}
    for name, rows in tables.items():
        for row in rows:
            found.setdefault(row.metric.name, {})[name] = row
    return found


def _strips(
    axis: Any,
    shown: Sequence[tuple[str, Mapping[str, MetricResult]]],
    names: Mapping[str, Any],
    colours: Mapping[str, str],
) -> None:
    axis.set_xscale("symlog", linthresh=1.0, linscale=0.7)
    axis.axvspan(-1, 1, color="0.9", zorder=0)
    axis.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    labelled = set()
    for place, (_, rows) in enumerate(shown):
        for index, name in enumerate(names):
            row = rows.get(name)
            if row is None or row.value is None or row.reference is None:
                continue
            colour = colours.get(name, "#d95f02")
            y = place + (0.0 if len(names) == 1 else 0.6 * (index / (len(names) - 1) - 0.5))
            half = max((row.reference.high - row.reference.low) / 2, 1e-9 + 1e-3 * abs(row.reference.value))
            low, value, high = (
                min(max((each - row.reference.value) / half, -AXIS_LIMIT), AXIS_LIMIT)
                for each in (row.value.low, row.value.value, row.value.high)
            )
            label = None if name in labelled else name
            labelled.add(name)
            axis.plot([low, high], [y, y], color=colour, linewidth=1.3, alpha=0.6)
            axis.plot(value, y, "o", color=colour, markersize=4, label=label)
    axis.set_yticks(range(len(shown)), [name for name, _ in shown], fontsize=7)
    axis.set_ylim(len(shown) - 0.4, -0.6)
    axis.set_xlim(-AXIS_LIMIT, AXIS_LIMIT)
    axis.tick_params(axis="x", labelsize=7)
    axis.grid(True, axis="y", color="0.94")
    axis.spines[["top", "right"]].set_visible(False)
