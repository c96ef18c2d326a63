"""Draws static-eyes.webp: one performance with its eyes at rest, and with generated eyes (TalkingEyes, Fig. 6).

Run     python docs/pictures/static_eyes.py [MODEL [OUT.webp]]     (MODEL: a trained model, as data/train/talkingeyes)
Reads   the sentence of the README's picture; without MODEL, the packaged model
The columns are moments at which the mouth is open; among these, the ones with the most different gaze in the head.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS
from talkingeyes.workflows.animate import animate_samples

COLUMNS, SIZE_PX, QUALITY = 4, 260, 85
OPEN_LID, OPEN_MOUTH = 0.2, 0.6  # largest closure of the lids, quantile of the angle of the jaw


def moments(motion: Motion, count: int) -> list[int]:
    """Frames with open mouth and open lids whose directions of gaze are furthest from each other, in order."""
    jaw, angles = motion.jaw[:, 0], gaze_to_angles(motion.gaze).mean(axis=1)
    peaks = np.flatnonzero((jaw[1:-1] >= jaw[:-2]) & (jaw[1:-1] > jaw[2:])) + 1
    able = peaks[(jaw[peaks] > np.quantile(jaw, OPEN_MOUTH)) & (motion.lid[peaks].max(axis=1) < OPEN_LID)]
    chosen = [int(able[np.linalg.norm(angles[able], axis=1).argmax()])]
    while len(chosen) < count:
        away = np.linalg.norm(angles[able][:, None] - angles[chosen], axis=-1).min(axis=1)
        chosen.append(int(able[away.argmax()]))
    return sorted(chosen)


def main() -> None:
    """One sample, twice."""
    model = Path(sys.argv[1]) if sys.argv[1:] else None
    out = Path(sys.argv[2]) if sys.argv[2:] else Path(__file__).with_name("static-eyes.webp")
    sound = str(files("moonshine_voice") / "assets/two_cities.wav")
    moving = to_forward_axes(animate_samples(sound, 1, seed=0, model=model)[0].motion)
    still = replace(moving, gaze=np.zeros_like(moving.gaze), lid=np.zeros_like(moving.lid))
    frames = moments(moving, COLUMNS)
    head = anny_head()
    renderer = HeadRenderer(head, FRAMINGS["face"].centred_on(head.eye_centres).view(SIZE_PX, SIZE_PX))
    size = (COLUMNS * SIZE_PX / 100, 2 * SIZE_PX / 100 + 0.3)
    figure, axes = plt.subplots(2, COLUMNS, figsize=size, layout="constrained")
    for row, (name, motion) in enumerate({"eyes at rest": still, "generated eyes": moving}.items()):
        for axis, frame in zip(axes[row], frames, strict=True):
            axis.imshow(next(renderer.draw(motion.cut(frame, frame + 1))))
            axis.set(xticks=[], yticks=[], title=f"{frame / motion.fps:.2f} s" if row == 0 else "")
        axes[row, 0].set_ylabel(name)
    figure.savefig(out, dpi=100, pil_kwargs={"quality": QUALITY})
    for frame in frames:
        yaw, pitch = np.degrees(gaze_to_angles(moving.gaze[frame])).mean(axis=0)
        print(f"{frame / moving.fps:.2f} s: gaze in the head {yaw:+.0f}, {pitch:+.0f} degrees (left, up)")


if __name__ == "__main__":
    configure_environment()
    main()
