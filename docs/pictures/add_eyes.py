"""Draws docs/pictures/add_eyes.png: a face before and after `add-eyes`, as heads and as curves.

Run     python docs/pictures/add_eyes.py BEFORE.csv AFTER.csv docs/pictures/add_eyes.png     (docs/add_eyes.md)
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.head.anny import anny_head
from talkingeyes.rendering.contact_sheet import contact_sheet

START_S, END_S = 8.0, 16.0
SHOWN_S = (8.5, 9.5, 10.5, 11.5, 12.5, 13.2, 14.5, 15.5)
HEAD_PX = 200


def draw(before: Path, after: Path, out: Path) -> None:
    """Draw the figure."""
    motions = [to_forward_axes(read_motion(path).motion) for path in (before, after)]
    figure, axes = plt.subplots(4, 1, figsize=(12, 7.8), height_ratios=[3, 1, 1, 1], layout="constrained")
    axes[0].imshow(contact_sheet(anny_head(), motions, list(SHOWN_S), HEAD_PX))
    axes[0].set_axis_off()
    for motion, label, style in zip(motions, ("before", "after"), ("0.6", "C0"), strict=True):
        columns = dict(zip(arkit.NAMES, arkit.coefficients(motion).T, strict=True))
        outward = columns["eyeLookOutLeft"] - columns["eyeLookInLeft"]
        curves = {
            "left eye, degrees": np.degrees(arkit.LOOK_RANGE_RAD) * outward,
            "eyeBlinkLeft": columns["eyeBlinkLeft"],
            "jawOpen": columns["jawOpen"],
        }
        for axis, (name, values) in zip(axes[1:], curves.items(), strict=True):
            times = np.arange(len(values)) / motion.fps
            axis.plot(times, values, color=style, linewidth=3 if label == "before" else 1, label=label)
            axis.set(xlim=(START_S, END_S), ylabel=name)
    axes[1].legend(loc="upper right")
    axes[-1].set_xlabel("s")
    figure.savefig(out, dpi=100)


if __name__ == "__main__":
    draw(*map(Path, sys.argv[1:]))
