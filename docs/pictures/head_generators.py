"""Draws head-vae-vqvae.webp: heads of a VAE and of a VQ-VAE for one sound (TalkingEyes, Fig. 7).

Run     python -m pipelines.experiment experiment=paper_tables target=train@talkingeyes_paper
        python -m pipelines.experiment experiment=paper_tables target=train@vqvae_head
        python docs/pictures/head_generators.py build/tables/data [OUT.webp]
Reads   train/talkingeyes_paper (head: VAE), train/vqvae_head, the corpus and its embedding
Writes  the picture; prints range and speed of each head
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS
from talkingeyes.training.motion_generators import load_generator

MODELS = {"VAE": "talkingeyes_paper", "VQ-VAE": "vqvae_head"}
SAMPLES, COLUMNS, SIZE_PX, QUALITY = 5, 6, 170, 85
SECONDS = 8.0
AXES = ("yaw", "pitch")


def heads(data: Path) -> tuple[float, dict[str, np.ndarray]]:
    """Frame rate, and rotations (S, T, 3) of the first long test clip: recorded, and of both models."""
    corpus = Corpus(data / "synthesize")
    clip = next(each for each in corpus.select("test", take=0) if each.seconds >= SECONDS)
    embedding = np.load(shard_path(data / "embed" / "speech", clip.sound, ".npy"))
    frames = round(SECONDS * clip.fps)
    found = {"truth": corpus.truth(clip).head[None, :frames]}
    for name, model in MODELS.items():
        generator = load_generator(data / "train" / model)
        found[name] = generator.generate(embedding, list(range(SAMPLES)), clip.fps).head[:, :frames]
    print(f"clip {clip.id}")
    return clip.fps, found


def main() -> None:
    """Frames of the first sample, and the angles of all samples."""
    data, out = (
        Path(sys.argv[1]),
        Path(sys.argv[2] if sys.argv[2:] else Path(__file__).with_name("head-vae-vqvae.webp")),
    )
    fps, found = heads(data)
    model = anny_head()
    renderer = HeadRenderer(model, FRAMINGS["head"].centred_on(model.eye_centres).view(SIZE_PX, SIZE_PX))
    size = ((COLUMNS + 4) * SIZE_PX / 100, 3 * SIZE_PX / 100 + 0.4)
    figure, axes = plt.subplots(
        3, COLUMNS + 2, figsize=size, layout="constrained", width_ratios=[1.0] * COLUMNS + [2.0] * 2, squeeze=False
    )
    at = np.linspace(0.1, 0.9, COLUMNS) * SECONDS
    for row, (name, rotations) in zip(axes, found.items(), strict=True):
        _draw_frames(row[:COLUMNS], renderer, rotations[0], fps, at)
        row[0].set_ylabel(name)
        degrees = np.degrees(gaze_to_angles(rotations))
        for index, axis in enumerate(row[COLUMNS:]):
            axis.plot(np.arange(degrees.shape[1]) / fps, degrees[..., index].T, linewidth=0.9)
            axis.set(ylim=(-17, 17), xlim=(0, SECONDS))
            axis.grid(True, color="0.9")
        spread, speed = degrees.std(axis=1).mean(axis=0), fps * np.abs(np.diff(degrees, axis=1)).mean(axis=(0, 1))
        print(
            f"{name}: standard deviation over time {spread[0]:.1f} (yaw), {spread[1]:.1f} (pitch) degrees; "
            f"speed {speed[0]:.1f}, {speed[1]:.1f} degrees a second"
        )
    titles = [*(f"{second:.1f} s" for second in at), *(f"{label}, degrees" for label in AXES)]
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title)
    for axis in axes[-1, COLUMNS:]:
        axis.set_xlabel("seconds")
    figure.savefig(out, dpi=100, pil_kwargs={"quality": QUALITY})


def _draw_frames(axes: np.ndarray, renderer: HeadRenderer, head: np.ndarray, fps: float, at: np.ndarray) -> None:
    chosen = np.round(at * fps).astype(int)
    shown = Motion.of(fps, head[chosen], np.zeros((len(chosen), 2, 3)))
    for axis, picture in zip(axes, renderer.draw(shown), strict=True):
        axis.imshow(picture)
        axis.set(xticks=[], yticks=[])


if __name__ == "__main__":
    configure_environment()
    main()
