"""Draws the pictures of docs/eyelid.md, after Fig. 2, 5 and 6 of Elisei, Bailly & Casari (AVSP 2007).

Run     python docs/pictures/eyelid.py [VIDEO]      (extra `track`; some five minutes)
Writes  eyelid-parameters.png: effect of each parameter of the Eyelid model, both eyes in the same posture
        eyelid-capture.webp: the curves captured in three views of a rendered clip; the last row is a failure
        eyelid-tracks.png: the tracks captured from that clip, beside the truth
        eyelid-tracks-video.png: the tracks captured from a video, where one is given
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from numpy import ndarray
from PIL import Image

import talkingeyes as te
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.fitting.eyelid_capture import IMAGE_PX, open_head_lids
from talkingeyes.head.anny import anny_head
from talkingeyes.head.model import HeadModel
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.contact_sheet import static_motion
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing
from talkingeyes.workflows.capture import Capture, capture, draw_overlay

SECONDS, SEED, FPS = 8.0, 3, 25.0
YAWS_DEG, SIZE_PX = (0.0, 30.0, -30.0), 400
EYE_BAND_PX = (84, 200)  # height and width of the part of a view that shows the eyes
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
BLINK_CLOSURE = 0.5  # closure above which a blink is marked


@dataclass(frozen=True)
class Tracks:
    """Azimuth of the right eye (degrees, NaN where not trusted), its closure, and nodding of the head (degrees)."""

    azimuth: Float[ndarray, " T"]
    lid: Float[ndarray, " T"]
    nodding: Float[ndarray, " T"]

    @classmethod
    def of(cls, motion: Motion, trusted: ndarray | bool = True) -> Tracks:
        azimuth = np.degrees(rotation.gaze_to_angles(motion.gaze[:, RIGHT])[:, 0])
        nodding = np.degrees(rotation.gaze_to_angles(motion.head)[:, 1])
        return cls(np.where(trusted, azimuth, np.nan), motion.lid[:, RIGHT], nodding)


def main() -> None:
    """All pictures."""
    folder = Path(__file__).resolve().parent
    plot_parameters(anny_head(), folder / "eyelid-parameters.png")
    speech = package_file(EXAMPLE_SPEECH)
    motion = te.animate(speech, seed=SEED).motion.cut(0, round(SECONDS * FPS))
    with tempfile.TemporaryDirectory() as place:
        views = [render_view(motion, yaw, Path(place) / f"view{number}") for number, yaw in enumerate(YAWS_DEG)]
        found = capture(views, fps=FPS)
        shown = [
            list(draw_overlay(view, each, open_head_lids(), FPS)) for view, each in zip(views, found.views, strict=True)
        ]
    write_overlays(shown, found, folder / "eyelid-capture.webp")
    plot_tracks(captured(found), Tracks.of(motion), FPS, read_speech(speech), folder / "eyelid-tracks.png")
    if sys.argv[1:]:
        video = Path(sys.argv[1])
        seen = capture([video])
        plot_tracks(captured(seen), None, seen.motion.fps, read_speech(video), folder / "eyelid-tracks-video.png")


def captured(found: Capture) -> Tracks:
    """The tracks of a capture."""
    return Tracks.of(found.motion, found.tracks[RIGHT].trusted)


def render_view(motion: Motion, yaw_deg: float, folder: Path) -> Path:
    """Render a view of a motion as images in a folder."""
    folder.mkdir()
    view = Framing(0.285, (0.0, 0.030, 0.0), yaw_deg=yaw_deg).view(SIZE_PX, SIZE_PX)
    for frame, image in enumerate(HeadRenderer(anny_head(), view).draw(motion)):
        Image.fromarray(image).save(folder / f"{frame:04d}.png")
    return folder


def write_overlays(shown: list[list[UInt8[ndarray, "H W 3"]]], found: Capture, path: Path) -> None:
    """Two frames with open eyes, and one whose lids are almost closed."""
    lid = found.motion.lid[:, RIGHT]
    azimuth = rotation.gaze_to_angles(found.motion.gaze[:, RIGHT])[:, 0]
    is_open = lid < 0.2
    half = int(np.argmin(np.abs(lid - 0.75)))
    frames = [int(np.argmax(np.where(is_open, azimuth, -9))), int(np.argmin(np.where(is_open, azimuth, 9))), half]
    rows = []
    for frame in frames:
        row = []
        for images, view in zip(shown, found.views, strict=True):
            middle = np.mean([cut.corner + cut.scale * np.array(IMAGE_PX) / 2 for cut in view.cuts[frame]], axis=0)
            left, top = np.clip(np.round(middle - np.array(EYE_BAND_PX[::-1]) / 2).astype(int), 0, None)
            row.append(images[frame][top : top + EYE_BAND_PX[0], left : left + EYE_BAND_PX[1]])
        rows.append(np.hstack(row))
    picture = Image.fromarray(np.vstack(rows))
    picture.resize((2 * picture.width, 2 * picture.height), Image.Resampling.LANCZOS).save(path, quality=85)


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


def plot_tracks(found: Tracks, truth: Tracks | None, fps: float, sound: Float[ndarray, " N"], path: Path) -> None:
    """Write a PNG: sound, azimuth and blink of the right eye, nodding of the head, on one time axis."""
    times_s = np.arange(len(found.lid)) / fps
    names: Mapping[str, str] = {
        "azimuth": "azimuth of the\nright eye, degrees\n(subject's left up)",
        "lid": "blink of the\nright eye\n(1 is shut)",
        "nodding": "nodding of the\nhead, degrees\n(up is up)",
    }
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1.1, 1, 1, 1])
    axes[0].plot(np.arange(len(sound)) / SAMPLE_RATE, sound, color="0.35", linewidth=0.4)
    axes[0].set_yticks([])
    axes[0].set_ylabel("sound", rotation=0, ha="right", va="center")
    for axis, (field, name) in zip(axes[1:], names.items(), strict=True):
        if truth is not None:
            axis.plot(times_s, getattr(truth, field), color="0.6", linewidth=1.0, label="truth")
        axis.plot(times_s, getattr(found, field), color="C0", linewidth=1.2, label="captured")
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.grid(True, color="0.92")
    if truth is not None:
        axes[1].legend(loc="upper right", fontsize=8)
    shut = np.diff((found.lid > BLINK_CLOSURE).astype(int), prepend=0, append=0)
    for axis in axes:
        for start, stop in zip(np.flatnonzero(shut == 1), np.flatnonzero(shut == -1), strict=True):
            axis.axvspan(start / fps, stop / fps, color="C3", alpha=0.2, linewidth=0)
        axis.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("seconds; blinks are marked over all tracks")
    axes[-1].set_xlim(0.0, times_s[-1])
    figure.savefig(path, dpi=100, format="png", metadata={"Software": None})


if __name__ == "__main__":
    configure_environment()
    main()
