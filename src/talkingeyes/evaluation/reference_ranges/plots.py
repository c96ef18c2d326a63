"""Plots for the page of reference ranges: main sequence at four frame rates, distributions, timeline of one clip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.evaluation.measures.pooled import ClipData, PooledArrays
from talkingeyes.evaluation.measures.saccades import MAIN_SEQUENCE_GRID_DEG, sampled_log_peak_speed
from talkingeyes.physiology import saccades as main_sequence_model

RATES_FPS = (500, 120, 60, 25)
MOST_POINTS = 1500
AMPLITUDES_DEG = np.arange(0.0, 30.5, 1.0)
DWELLS_S = np.arange(0.0, 8.1, 0.4)
OURS, AWAY = "#d95f02", "#7570b3"
RECORDING_COLOURS = {"T": "0.7", "C": "0.35"}


def main_sequence(pool: PooledArrays, path: Path) -> None:
    """Write a PNG: peak speed by amplitude, one panel for each frame rate."""
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    for axis, fps in zip(figure.subplots(1, len(RATES_FPS), sharey=True), RATES_FPS, strict=True):
        amplitude, peak = pool[f"at{fps}.amplitude_deg"], pool[f"at{fps}.peak_deg_s"]
        every = max(1, len(amplitude) // MOST_POINTS)
        axis.loglog(amplitude[::every], peak[::every], ".", color=OURS, markersize=2, alpha=0.35, rasterized=True)
        axis.loglog(
            MAIN_SEQUENCE_GRID_DEG,
            np.degrees(main_sequence_model.peak_speed(np.radians(MAIN_SEQUENCE_GRID_DEG))),
            "--",
            color="0.2",
            linewidth=0.9,
        )
        axis.loglog(MAIN_SEQUENCE_GRID_DEG, np.exp(sampled_log_peak_speed(float(fps))), color="0.2", linewidth=1.2)
        axis.set_title(f"{fps} fps, {len(amplitude)} saccades", fontsize=9)
        axis.set_xlabel("amplitude, degrees", fontsize=8)
        axis.set_xlim(0.4, 45)
        axis.set_ylim(8, 900)
        axis.grid(True, color="0.92")
        axis.tick_params(labelsize=8)
    figure.axes[0].set_ylabel("peak speed, degrees per second", fontsize=8)
    _save(figure, path)


def distributions(pool: PooledArrays, recorded: Mapping[str, PooledArrays], path: Path) -> None:
    """Write a PNG: amplitudes and directions, with those of recorded people, and dwell times of both gaze states."""
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    grid = figure.add_gridspec(1, 3)
    amplitudes, dwells = figure.add_subplot(grid[0]), figure.add_subplot(grid[2])
    directions: Any = figure.add_subplot(grid[1], projection="polar")
    for name, each in recorded.items():
        _density(amplitudes, each["saccade.amplitude_deg"], AMPLITUDES_DEG, RECORDING_COLOURS[name], f"people ({name})")
        _rose(directions, each["saccade.direction_rad"], RECORDING_COLOURS[name])
    _density(amplitudes, pool["saccade.amplitude_deg"], AMPLITUDES_DEG, OURS, "corpus")
    eyes_alive = np.exp(
        -(np.maximum(AMPLITUDES_DEG, 1.0) - main_sequence_model.AMPLITUDE_MIN_DEG)
        / main_sequence_model.AMPLITUDE_MEAN_DEG
    )
    amplitudes.plot(AMPLITUDES_DEG, eyes_alive / (eyes_alive.sum()), ":", color="0.2", label="Eyes Alive, exponential")
    amplitudes.set_xlabel("amplitude, degrees", fontsize=8)
    amplitudes.set_ylabel("fraction per degree", fontsize=8)
    amplitudes.legend(fontsize=7, frameon=False)
    _rose(directions, pool["saccade.direction_rad"], OURS)
    directions.set_xticks(np.arange(8) * np.pi / 4, ["left", "", "up", "", "right", "", "down", ""], fontsize=8)
    directions.set_yticklabels([])
    directions.set_title("directions (subject's view)", fontsize=9)
    for averted, colour, name in ((False, OURS, "at the partner"), (True, AWAY, "averted")):
        chosen = (pool["dwell.averted"].astype(bool) == averted) & ~pool["dwell.cut"].astype(bool)
        _density(dwells, pool["dwell.s"][chosen], DWELLS_S, colour, name)
    dwells.set_xlabel("dwell time, seconds (uncensored)", fontsize=8)
    dwells.legend(fontsize=7, frameon=False)
    _save(figure, path)


def _density(axis: Any, values: Float[ndarray, " N"], edges: Float[ndarray, " E"], colour: str, label: str) -> None:
    share = np.histogram(values, edges)[0] / max(len(values), 1)
    axis.stairs(share, edges, color=colour, linewidth=1.3, label=f"{label}, {len(values)}")
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)


def _rose(axis: Any, direction_rad: Float[ndarray, " N"], colour: str) -> None:
    edges = (np.arange(17) - 0.5) * np.pi / 8
    share = np.histogram(np.mod(direction_rad + np.pi / 16, 2 * np.pi) - np.pi / 16, edges)[0] / max(
        len(direction_rad), 1
    )
    middle = np.arange(16) * np.pi / 8
    axis.plot(np.append(middle, 0.0), np.append(share, share[0]), color=colour, linewidth=1.3)


def timeline(clip_data: ClipData, sound: Float[ndarray, " N"], path: Path) -> None:
    """Write a PNG: sound and words, gaze in space with gaze states, head and lids on one time axis."""
    behaviour = clip_data.behaviour
    assert clip_data.annotation is not None and behaviour.head is not None and behaviour.lid is not None
    figure = Figure(figsize=(11.0, 6.2), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1, 1.3, 1.3, 0.8])
    times = behaviour.times_s
    axes[0].plot(np.arange(len(sound)) / SAMPLE_RATE, sound, color="0.4", linewidth=0.3)
    for word in clip_data.annotation.words:
        axes[0].text(word.start_s, 1.02, word.label, fontsize=6.5, rotation=35, transform=axes[0].get_xaxis_transform())
    for span in clip_data.annotation.listening:
        axes[0].axvspan(span.start_s, span.end_s, color="0.9")
    for name, column, colour in (("yaw, left up", 0, OURS), ("pitch", 1, AWAY)):
        axes[1].plot(times, np.degrees(behaviour.gaze_in_space_rad[:, column]), color=colour, linewidth=1.1, label=name)
        axes[2].plot(times, np.degrees(behaviour.head_rad[:, column]), color=colour, linewidth=1.1, label=name)
    axes[2].plot(times, np.degrees(behaviour.head[:, 2]), color="0.6", linewidth=1.0, label="roll")
    axes[3].plot(times, behaviour.lid.mean(axis=1), color="0.2", linewidth=1.1)
    states = behaviour.states
    for start, stop, averted in zip(states.onset_s, states.offset_s, states.dwell_averted, strict=True):
        if averted:
            axes[1].axvspan(start, stop, color="#f5d9c0", linewidth=0)
    labels = (
        "sound and words\n(grey: listening)",
        "gaze in space, degrees\n(shaded: averted)",
        "head, degrees",
        "lid closure",
    )
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label, fontsize=8)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks([])
    axes[1].legend(fontsize=7, frameon=False, ncols=2)
    axes[2].legend(fontsize=7, frameon=False, ncols=3)
    axes[3].set_xlabel("seconds", fontsize=8)
    axes[3].set_xlim(0, times[-1])
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=100, format="png", metadata={"Software": None})
