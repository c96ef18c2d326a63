"""Draws the animated picture of the README: three samples of one sentence, side by side, from the packaged model.

Run     python docs/pictures/samples.py [FOLDER]
Writes  samples.webp
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

from PIL import Image

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.head.looks import dressed_head
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS
from talkingeyes.workflows.animate import animate_samples

SECONDS, SAMPLES, SIZE_PX, EVERY = 8.0, 3, 300, 2  # every second frame of 25 per second


def draw(folder: Path) -> None:
    """Write the picture."""
    head = dressed_head()
    renderer = HeadRenderer(head, FRAMINGS["head"].view(SIZE_PX, SIZE_PX))
    sound = str(files("moonshine_voice") / "assets/two_cities.wav")
    rows = []
    for animation in animate_samples(sound, SAMPLES, seed=0):
        shown = to_forward_axes(animation.motion).cut(0, round(SECONDS * animation.motion.fps))
        rows.append(list(renderer.draw(shown))[::EVERY])
    pictures = []
    for frames in zip(*rows, strict=True):
        picture = Image.new("RGB", (SIZE_PX * SAMPLES, SIZE_PX))
        for place, frame in enumerate(frames):
            picture.paste(Image.fromarray(frame), (SIZE_PX * place, 0))
        pictures.append(picture)
    pictures[0].save(
        folder / "samples.webp",
        save_all=True,
        append_images=pictures[1:],
        duration=round(EVERY * 40),
        loop=0,
        quality=70,
    )


if __name__ == "__main__":
    configure_environment()
    draw(Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent))
