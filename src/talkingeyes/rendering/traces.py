"""Plot of several motions of one sound over time: waveform, gaze in space, eye-in-head, head, lids."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion

ENVELOPE_COLUMNS = 2000


def plot_traces(motions: Sequence[Motion], sound: Float[ndarray, " N"], path: Path) -> None:
    """Write a PNG: one colour per motion, angles in degrees (yaw to the subject's left, pitch up), time in seconds."""
    from matplotlib.figure import Figure

    traces = [_traces(motion) for motion in motions]
    figure = Figure(figsize=(11, 9.5), layout="constrained")
    axes = figure.subplots(len(traces[0]) + 1, 1, sharex=True, height_ratios=[0.8] + [1.0] * len(traces[0]))
    envelope = _envelope(sound)
    axes[0].fill_between(envelope[:, 0], envelope[:, 1], envelope[:, 2], color="0.45", linewidth=0)
    axes[0].set_ylabel("sound", rotation=0, ha="right", va="center")
    axes[0].set_yticks([])
    for axis, name in zip(axes[1:], traces[0], strict=True):
        for index, (motion, trace) in enumerate(zip(motions, traces, strict=True)):
            times_s = np.arange(len(motion)) / motion.fps
            axis.plot(times_s, trace[name], color=f"C{index % 10}", linewidth=1.0, alpha=0.85, label=f"sample {index}")
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.grid(True, color="0.92")
        axis.set_axisbelow(True)
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("seconds")
    axes[-1].set_xlim(0, max(motion.seconds for motion in motions))
    if len(motions) > 1:
        handles, labels = axes[1].get_legend_handles_labels()
        figure.legend(handles[:10], labels[:10], loc="outside upper center", ncols=10, frameon=False)
    figure.savefig(path, dpi=110, format="png", metadata={"Software": None})


def _traces(motion: Motion) -> dict[str, Float[ndarray, " T"]]:
    """Traces by label, averaged over both eyes."""
    space = np.degrees(rotation.gaze_in_space(motion.head, motion.gaze)).mean(axis=1)
    eye = np.degrees(rotation.gaze_to_angles(motion.gaze)).mean(axis=1)
    head = np.degrees(rotation.gaze_to_angles(motion.head))
    return {
        "gaze in space\nyaw, degrees": space[:, 0],
        "gaze in space\npitch, degrees": space[:, 1],
        "eye in head\nyaw, degrees": eye[:, 0],
        "eye in head\npitch, degrees": eye[:, 1],
        "head\nyaw, degrees": head[:, 0],
        "head\npitch, degrees": head[:, 1],
        "lids\n1 is shut": motion.lid.mean(axis=1),
    }


def _envelope(sound: Float[ndarray, " N"]) -> Float[ndarray, "K 3"]:
    """Time, minimum and maximum of each column."""
    edges = np.linspace(0, len(sound), min(ENVELOPE_COLUMNS, len(sound)) + 1).astype(int)
    lowest, highest = (extreme.reduceat(sound, edges[:-1]) for extreme in (np.minimum, np.maximum))
    return np.stack([edges[:-1] / SAMPLE_RATE, lowest, highest], axis=1)
