"""Draws the two pictures of docs/eyelid.md, after Fig. 2 and 6 of Elisei, Bailly & Casari (AVSP 2007).

Run     python docs/pictures/eyelid.py CORPUS [FOLDER]     (a synthetic corpus, as data/synthesize)
Writes  eyelid-parameters.png: effect of each parameter of the Eyelid model, both eyes in the same posture
        eyelid-tracks.png: the true motion of the first long test clip that blinks
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.store import Corpus
from talkingeyes.head.anny import anny_head
from talkingeyes.head.model import HeadModel
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.contact_sheet import static_motion
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing

SECONDS = 8.0
LEAST_BLINKS = 3
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


def main() -> None:
    """Both pictures."""
    corpus = Corpus(Path(sys.argv[1]))
    folder = Path(sys.argv[2]) if sys.argv[2:] else Path(__file__).resolve().parent
    plot_parameters(anny_head(), folder / "eyelid-parameters.png")
    for clip in corpus.select("test", take=0):
        blinks = [blink for blink in corpus.truth_events(clip).blinks if blink.onset_s < SECONDS - 0.3]
        motion = corpus.truth(clip)
        if motion.seconds >= SECONDS and len(blinks) >= LEAST_BLINKS:
            path = folder / "eyelid-tracks.png"
            plot_tracks(motion, corpus.speech(clip), corpus.annotation(clip), (0.0, SECONDS), path)
            print(f"{path.name}: clip {clip.id}")
            return


def plot_parameters(head: HeadModel, path: Path) -> None:
    """Write a PNG with each of the three parameters of both eyes at either extreme."""
    postures = np.array(list(POSTURES.values()))
    middle = head.eye_centres.mean(axis=0)
    view = Framing(0.046, (0.0, float(middle[1]), float(middle[2]))).view(WIDTH_PX, HEIGHT_PX)
    figure = Figure(figsize=(9.6, 6.3), layout="constrained")
    pictures = HeadRenderer(head, view).draw(static_motion(gaze_deg=postures[:, :2], lid=postures[:, 2]))
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


if __name__ == "__main__":
    configure_environment()
    main()
