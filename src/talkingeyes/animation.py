"""Speech file in, motions out: what `talkingeyes animate` and `talkingeyes.animate` do.

Reads a sound file and a trained model. Writes, if a folder is given, sample_00.npz, .events.json and .mp4 of each
sample, traces.png and sheet.png (the head at several times, a row a sample); the folder appears whole or not at
all.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import Float
from numpy import ndarray

from talkingeyes import conversion, output
from talkingeyes.audio.waveform import read_speech
from talkingeyes.errors import InputError
from talkingeyes.motion import Motion
from talkingeyes.run import progress

if TYPE_CHECKING:
    from talkingeyes.performance.perform import Performance

MODEL = Path("data", "train", "talkingeyes")
PICTURE_PX = 256
FPS_BOUNDS = (10.0, 240.0)
MOST_SAMPLES = 1000
OWN_FILES = re.compile(r"sample_\d+(\.[a-z]+)?\.(npz|json|mp4|csv|glb|vrma|usda|npy|bvh)|(traces|sheet)\.png")
SHEET_ROWS, SHEET_COLUMNS, SHEET_PX = 4, 8, 160


def animate(
    speech: Path | str,
    out: Path | str | None = None,
    *,
    samples: int = 3,
    seed: int = 0,
    fps: float = 25.0,
    blinks: str = "physio",
    model: Path | str = MODEL,
    formats: Sequence[str] = (),
    force: bool = False,
) -> list[Motion]:
    """`samples` motions for the speech in a file; the same seed gives the same motions.

    `blinks` is the profile of their rate: physio, paper or corpus (that of the training data).
    With `out`, they are also written there, with a drawing and a plot, and in the formats of `conversion.FORMATS` that
    are asked for; `force` replaces what an earlier call wrote.
    Raises InputError (one line) for a sound, a model, a number or a folder that will not do.
    """
    _check(samples, seed, fps)
    conversion.check_formats(formats)
    target = None if out is None else output.target(Path(out), OWN_FILES, force)
    sound = read_speech(speech)
    performances = _perform(Path(model), sound, samples, seed, float(fps), blinks)
    if target is not None:
        try:
            with output.appearing(target) as folder:
                _write(folder, performances, sound, formats)
        except OSError as error:
            raise InputError(f"{out}: should be a folder that can be written, got: {error.strerror or error}") from None
    return [performance.motion for performance in performances]


def _check(samples: int, seed: int, fps: float) -> None:
    if not 1 <= samples <= MOST_SAMPLES:
        raise InputError(f"samples: should be 1 to {MOST_SAMPLES}, got {samples}")
    if seed < 0:
        raise InputError(f"seed: should be 0 or more, got {seed}")
    if not (math.isfinite(fps) and FPS_BOUNDS[0] <= fps <= FPS_BOUNDS[1]):
        raise InputError(f"fps: should be {FPS_BOUNDS[0]:.0f} to {FPS_BOUNDS[1]:.0f}, got {fps}")


def _perform(
    model: Path, sound: Float[ndarray, " N"], samples: int, seed: int, fps: float, blinks: str
) -> list[Performance]:
    if not model.exists():
        raise InputError(f"{model}: no trained model here; run `make repro` first, or name a folder of the train stage")
    from talkingeyes.performance.direction import Direction
    from talkingeyes.performance.perform import Performer

    return Performer.load(model).perform(sound, samples, seed, fps, Direction(blinks=blinks))


def _write(folder: Path, performances: list[Performance], sound: Float[ndarray, " N"], formats: Sequence[str]) -> None:
    from PIL import Image

    from talkingeyes.export.traces import plot_traces
    from talkingeyes.export.video import write_video
    from talkingeyes.head.anny import open_head
    from talkingeyes.head.render import Painter
    from talkingeyes.head.sheet import contact_sheet
    from talkingeyes.head.view import FRAMINGS

    painter = Painter(open_head(), FRAMINGS["head"].view(PICTURE_PX, PICTURE_PX))
    for index, performance in enumerate(performances):
        motion, name = performance.motion, f"sample_{index:02d}"
        motion.save(folder / f"{name}.npz")
        performance.events.save(folder / f"{name}.events.json")
        for format in formats:
            conversion.write(motion, performance.events, format, conversion.beside(folder / name, format))
        pictures = iter(progress(painter.draw(motion), f"{name}.mp4", len(motion)))
        write_video(folder / f"{name}.mp4", pictures, motion.fps, sound)
    motions = [performance.motion for performance in performances]
    plot_traces(motions, sound, folder / "traces.png")
    times_s = [(column + 0.5) * motions[0].seconds / SHEET_COLUMNS for column in range(SHEET_COLUMNS)]
    Image.fromarray(contact_sheet(open_head(), motions[:SHEET_ROWS], times_s, SHEET_PX)).save(folder / "sheet.png")
