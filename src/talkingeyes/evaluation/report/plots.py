"""Plots of the report: metrics with intervals, traces of one sound, distributions of speed, code usage; strips.

A strip plot shows all benchmark metrics of several sets of motions, relative to the interval of the reference. The
difference to the reference value is divided by half the width of its interval: values between -1 and 1 lie within the
interval of the reference. Beyond 1 the axis is logarithmic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray

from talkingeyes.core.kinematics import STILL_THRESHOLD_DEG_S
from talkingeyes.core.rotation import direction_to_angles, gaze_in_space, rotvec_to_direction
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.papers.table3 import TITLES, MethodMetrics, metric_of, order_rows
from talkingeyes.evaluation.text_tables import Column

COLOURS = {
    "truth": "#111111",
    "fitted": "#8a8a8a",
    "mismatched": "#c9b037",
    "mean": "#a6761d",
    "random": "#7570b3",
    "similar": "#1f78b4",
    "aligned_replay": "#80b1d3",
    "pieced_replay": "#a6cee3",
    "untrained": "#bdbdbd",
    "vae": "#66a61e",
    "talkingeyes_paper": "#e7298a",
    "talkingeyes": "#b2182b",
    "talkingeyes_events": "#d95f02",
    "talkingeyes_live": "#1b9e77",
}
PANELS = (
    Column("Diversity / truth\neye-in-head", "gaze/diversity_ratio"),
    Column("L2 to fitted\neye-in-head, radians", "gaze/l2"),
    Column("Corr.\neye-in-head", "gaze/corr"),
    Column("Corr.\ngaze in space", "gaze_in_space/corr"),
    Column("Corr.\nhead", "head/corr"),
    Column("Eye speed\n/ truth", "gaze/speed_ratio"),
    Column("Gaze in space\nstill, fraction", "gaze_in_space/still_fraction"),
)
PARTS = {"gaze": "eye-in-head", "gaze_in_space": "gaze in space", "head": "head"}


@dataclass(frozen=True)
class Trace:
    """Several motions of one sound, with a title."""

    title: str
    samples: Samples


def plot_metrics(rows: Mapping[str, MethodMetrics], path: Path) -> None:
    """Plot metrics of all rows with intervals; a line marks the true motion (for L2 and Corr.: the fitted motion)."""
    names = order_rows(rows)
    figure = Figure(figsize=(12.5, 1.6 + 0.36 * len(names)), layout="constrained")
    axes = figure.subplots(1, len(PANELS), sharey=True)
    height = np.arange(len(names))[::-1]
    for axis, column in zip(axes, PANELS, strict=True):
        for split, marker, shift in (("test", "o", 0.13), ("unseen", "D", -0.13)):
            for name, y in zip(names, height, strict=True):
                found = metric_of(column, rows[name], split)
                if found:
                    colour = COLOURS.get(name, "black")
                    axis.plot([found["low"], found["high"]], [y + shift] * 2, color=colour, linewidth=1.4, alpha=0.7)
                    face = colour if split == "test" else "white"
                    axis.plot(found["value"], y + shift, marker, color=colour, markerfacecolor=face, markersize=5)
        _mark_reference(axis, rows, column)
        axis.set_title(column.heading, fontsize=9)
        axis.grid(True, axis="x", color="0.92")
        axis.tick_params(axis="y", length=0)
        axis.tick_params(axis="x", labelsize=8)
        axis.locator_params(axis="x", nbins=4)
    axes[0].set_yticks(height, [TITLES.get(name, name) for name in names])
    axes[0].set_ylim(-0.6, len(names) - 0.4)
    figure.supxlabel(
        "filled: test, new sentences; open: unseen speakers; bars: intervals over clips; dotted: reference on test",
        fontsize=8,
        color="0.35",
    )
    _save(figure, path)


def _mark_reference(axis: Any, rows: Mapping[str, MethodMetrics], column: Column) -> None:
    row = "fitted" if column.metric.endswith(("/corr", "/l2")) else "truth"
    found = metric_of(column, rows.get(row, {}), "test")
    if found:
        axis.axvline(found["value"], color="0.3", linewidth=0.9, linestyle=":", zorder=0)


def plot_traces(traces: Sequence[Trace], sound: Float[ndarray, " N"], sample_rate: int, path: Path) -> None:
    """Plot yaw of eyes, gaze in space and head over time: one column per method, one colour per sample."""
    figure = Figure(figsize=(3.4 * len(traces) + 0.6, 7.2), layout="constrained")
    axes = figure.subplots(
        4, len(traces), sharex=True, sharey="row", squeeze=False, gridspec_kw={"height_ratios": [0.5, 1, 1, 1]}
    )
    sound_s = np.arange(len(sound)) / sample_rate
    for column, trace in zip(axes.T, traces, strict=True):
        column[0].plot(sound_s, sound, color="0.55", linewidth=0.3, rasterized=True)
        column[0].set_title(trace.title, fontsize=11)
        column[0].set_yticks([])
        for axis, angles in zip(column[1:], yaw_deg(trace.samples).values(), strict=True):
            times_s = np.arange(angles.shape[1]) / trace.samples.fps
            for index, line in enumerate(angles):
                axis.plot(times_s, line, color=f"C{index}", linewidth=1.1, alpha=0.9)
            axis.grid(True, color="0.92")
        column[-1].set_xlabel("seconds")
    for axis, label in zip(axes[:, 0], ("sound", *yaw_deg(traces[0].samples)), strict=True):
        axis.set_ylabel(label)
    axes[-1, 0].set_xlim(0, sound_s[-1])
    _save(figure, path)


def yaw_deg(samples: Samples) -> dict[str, Float[ndarray, "S T"]]:
    """Yaw of eyes, gaze in space and head in degrees, positive to the subject's left, by axis label."""
    eye = direction_to_angles(rotvec_to_direction(samples.gaze))[..., 0].mean(axis=-1)
    space = gaze_in_space(samples.head, samples.gaze)[..., 0].mean(axis=-1)
    head = direction_to_angles(rotvec_to_direction(samples.head))[..., 0]
    labels = (f"{title}, yaw °" for title in PARTS.values())
    return {label: np.degrees(angles) for label, angles in zip(labels, (eye, space, head), strict=True)}


def plot_speed_distributions(speeds: Mapping[str, Mapping[str, Float[ndarray, "2 N"]]], path: Path) -> None:
    """Plot the fraction of frames faster than a speed; `speeds` {row: {part: speeds and fractions}}."""
    figure = Figure(figsize=(12.5, 4.4), layout="constrained")
    axes = figure.subplots(1, len(PARTS), sharey=True)
    names = [name for name in order_rows({name: {} for name in speeds}) if speeds[name]]
    for axis, (part, title) in zip(axes, PARTS.items(), strict=True):
        for name in names:
            speed, share = speeds[name][part]
            wide = name in ("truth", "talkingeyes_events")
            shown = np.where(share > 0, share, np.nan)
            axis.loglog(
                speed, shown, color=COLOURS.get(name), linewidth=2.2 if wide else 1.2, label=TITLES.get(name, name)
            )
        axis.axvline(STILL_THRESHOLD_DEG_S, color="0.4", linewidth=0.9, linestyle=":")
        axis.text(STILL_THRESHOLD_DEG_S * 0.9, 1.5e-4, "still", color="0.4", fontsize=8, ha="right")
        axis.set_title(title, fontsize=11)
        axis.set_xlabel("speed, degrees per second")
        axis.grid(True, which="major", color="0.9")
        axis.set_xlim(0.3, 1000)
        axis.set_ylim(1e-4, 1.3)
    axes[0].set_ylabel("fraction of faster frames")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", frameon=False, fontsize=9)
    _save(figure, path)


def plot_code_usage(counts: Mapping[str, Float[ndarray, " K"]], path: Path) -> None:
    """Plot the usage of codes on the train split, most used first; uniform usage would be flat."""
    figure = Figure(figsize=(7.5, 4.0), layout="constrained")
    axis = figure.subplots()
    for name, used in counts.items():
        share = np.sort(used)[::-1] / max(used.sum(), 1)
        seen = int((used > 0).sum())
        known = share[share > 0]
        entropy = -(known * np.log(known)).sum()
        label = f"{name}: {seen} of {len(used)} codes in use, perplexity {np.exp(entropy):.0f}"
        axis.semilogy(np.arange(1, len(share) + 1), np.where(share > 0, share, np.nan), linewidth=1.8, label=label)
    axis.set_xlabel("code, most used first")
    axis.set_ylabel("fraction of uses")
    axis.grid(True, color="0.92")
    axis.legend(frameon=False)
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_axisbelow(True)
    figure.savefig(path, dpi=110, format="png", metadata={"Software": None})


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
