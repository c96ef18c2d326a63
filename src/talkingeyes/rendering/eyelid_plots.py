"""Two figures of the Eyelid model: effect of each parameter, and tracks over sound (the paper's Fig. 2 and 6).

Elisei, Bailly & Casari (AVSP 2007). The parameter sheet shows both eyes of a head in the same posture. The tracks are
those of the paper's figure: sound with its words, azimuth and blink of the right eye, nodding.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.head.model import HeadModel
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing

RIGHT = 1
POSTURES = {  # degrees to the subject's left and up, closure
    "looking at the right": (-25.0, 0.0, 0.0),
    "looking at the left": (25.0, 0.0, 0.0),
    "looking downward": (0.0, -22.0, 0.0),
    "looking upward": (0.0, 16.0, 0.0),
    "narrowing eyelids": (0.0, 0.0, 0.55),
    "widening eyelids": (0.0, 0.0, -0.3),
}
WIDTH_PX, HEIGHT_PX = 480, 190
BLINK_CLOSURE = 0.3  # closure above which a blink is marked


def plot_parameters(head: HeadModel, path: Path) -> None:
    """Write a PNG with each of the three parameters of both eyes at either extreme."""
    angles = np.radians([posture[:2] for posture in POSTURES.values()])
    gaze = np.repeat(rotation.angles_to_gaze(angles)[:, None], 2, axis=1)
    lid = np.repeat([[posture[2]] for posture in POSTURES.values()], 2, axis=1)
    motion = Motion.of(fps=1.0, head=np.zeros((len(lid), 3)), gaze=gaze, lid=lid)
    middle = head.eye_centres.mean(axis=0)
    view = Framing(0.046, (0.0, float(middle[1]), float(middle[2]))).view(WIDTH_PX, HEIGHT_PX)
    figure = Figure(figsize=(9.6, 6.3), layout="constrained")
    FigureCanvasAgg(figure)
    pictures = HeadRenderer(head, view).draw(motion)
    for axis, name, image in zip(figure.subplots(3, 2).flat, POSTURES, pictures, strict=True):
        axis.imshow(image)
        axis.set_axis_off()
        axis.set_title(name, fontsize=10)
    figure.savefig(path, dpi=100, format="png", metadata={"Software": None})


def plot_tracks(
    motion: Motion, sound: Float[ndarray, " N"], annotation: Annotation, span_s: tuple[float, float], path: Path
) -> None:
    """Write a PNG: sound and words, azimuth and blink of the right eye, nodding of the head, on one time axis."""
    times_s = np.arange(len(motion)) / motion.fps
    azimuth = np.degrees(rotation.gaze_to_angles(motion.gaze[:, RIGHT])[:, 0])
    nodding = np.degrees(rotation.gaze_to_angles(motion.head)[:, 1])
    tracks = {
        "azimuth of the\nright eye, degrees\n(subject's left up)": azimuth,
        "blink of the\nright eye\n(1 is shut)": motion.lid[:, RIGHT],
        "nodding of the\nhead, degrees\n(up is up)": nodding,
    }
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1.1, 1, 1, 1])
    axes[0].plot(np.arange(len(sound)) / SAMPLE_RATE, sound, color="0.35", linewidth=0.4)
    axes[0].set_yticks([])
    axes[0].set_ylabel("sound", rotation=0, ha="right", va="center")
    for word in annotation.words:
        if span_s[0] <= word.start_s < span_s[1]:
            axes[0].text(
                word.start_s, 1.02, word.label, fontsize=7, rotation=30, transform=axes[0].get_xaxis_transform()
            )
    for axis, (name, track) in zip(axes[1:], tracks.items(), strict=True):
        axis.plot(times_s, track, color="C0", linewidth=1.2)
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.grid(True, color="0.92")
    shut = np.diff((motion.lid[:, RIGHT] > BLINK_CLOSURE).astype(int), prepend=0, append=0)
    for axis in axes:
        for start, stop in zip(np.flatnonzero(shut == 1), np.flatnonzero(shut == -1), strict=True):
            axis.axvspan(start / motion.fps, stop / motion.fps, color="C3", alpha=0.2, linewidth=0)
        axis.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("seconds; blinks are marked over all tracks")
    axes[-1].set_xlim(*span_s)
    figure.savefig(path, dpi=100, format="png", metadata={"Software": None})
