"""Speech in, motion out: what `talkingeyes animate` and `talkingeyes.animate` do.

Reads a sound and a trained model. Gives performances; writes, if a folder is given, sample_00.npz, .events.json and
.mp4 of each sample, traces.png, sheet.png (the head at several times, a row a sample) and made_of.json, what they were
made from; the folder appears whole or not at all. Text that was spoken stands there too, as speech.wav and speech.json.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.direction import Direction
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core import output
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.run import code_digest, progress
from talkingeyes.workflows import convert

if TYPE_CHECKING:
    from talkingeyes.animation.dialogue import Dialogue
    from talkingeyes.animation.perform import Performance, Performer
    from talkingeyes.workflows.speak import SpokenText

Speech = Path | str | Float[ndarray, " N"]  # a sound file, or 16 kHz mono

MODEL = Path("data", "train", "talkingeyes")
MODELS_OWN = Direction()
PICTURE_PX = 256
FPS_BOUNDS = (10.0, 240.0)
MOST_SAMPLES = 1000
MADE_OF = "made_of.json"
OWN_FILES = re.compile(
    r"sample_\d+(\.[a-z]+)?\.(npz|json|mp4|csv|glb|vrma|usda|npy|bvh)|(traces|sheet)\.png|made_of\.json|speech\.(wav|json)"
)
DIALOGUE = re.compile("first|second")
SHEET_ROWS, SHEET_COLUMNS, SHEET_PX = 4, 8, 160
ROOMS = ("animation", "audio", "core", "head", "models", "physiology", "rendering", "training")


@dataclass(frozen=True)
class Order:
    """What is asked for; `formats` and `pictures` (films, plot, sheet) are of what is written.

    `flame` is the user's own FLAME file, which maps a face for the formats that show it on FLAME.
    """

    samples: int = 3
    seed: int = 0
    fps: float = 25.0
    direction: Direction = MODELS_OWN
    formats: tuple[str, ...] = ()
    pictures: bool = True
    flame: Path | None = None

    def __post_init__(self) -> None:
        """Raises InputError (one line) for a number or a format that will not do."""
        if not 1 <= self.samples <= MOST_SAMPLES:
            raise InputError(f"samples: should be 1 to {MOST_SAMPLES}, got {self.samples}")
        if self.seed < 0:
            raise InputError(f"seed: should be 0 or more, got {self.seed}")
        if not (math.isfinite(self.fps) and FPS_BOUNDS[0] <= self.fps <= FPS_BOUNDS[1]):
            raise InputError(f"fps: should be {FPS_BOUNDS[0]:.0f} to {FPS_BOUNDS[1]:.0f}, got {self.fps}")
        convert.check_formats(self.formats)
        if self.flame is not None and not self.flame.is_file():
            raise InputError(f"{self.flame}: should be your FLAME file, got no file")


def animate(
    speech: Speech,
    *,
    seed: int = 0,
    fps: float = 25.0,
    model: Path | str = MODEL,
    direction: Direction = MODELS_OWN,
) -> Performance:
    """One performance of speech, which knows how to `save` itself; the same seed gives the same.

    `direction` is what is asked of it besides: targets, eye contact, liveliness, ... (docs/control.md).
    Raises InputError (one line) for a sound, a model or a number that will not do.
    """
    return animate_samples(speech, 1, seed=seed, fps=fps, model=model, direction=direction)[0]


def animate_samples(
    speech: Speech,
    samples: int,
    *,
    seed: int = 0,
    fps: float = 25.0,
    model: Path | str = MODEL,
    direction: Direction = MODELS_OWN,
) -> list[Performance]:
    """Several performances of speech; the first is what `animate` gives with the same seed."""
    order = Order(samples, seed, float(fps), direction)
    return perform(performer(Path(model)), heard(speech), order)


def animate_into(
    speech: Speech | SpokenText,
    out: Path | str,
    *,
    samples: int = 3,
    seed: int = 0,
    fps: float = 25.0,
    model: Path | str = MODEL,
    direction: Direction = MODELS_OWN,
    formats: Sequence[str] = (),
    pictures: bool = True,
    flame: Path | str | None = None,
    force: bool = False,
) -> list[Performance]:
    """The same as a folder: motions, events, films, a plot, and the formats of `conversion.FORMATS` asked for.

    `force` replaces what an earlier call wrote.
    """
    order = Order(
        samples, seed, float(fps), direction, tuple(formats), pictures, None if flame is None else Path(flame)
    )
    return carry_out(speech, out, order, model, force)


def carry_out(
    speech: Speech | SpokenText, out: Path | str, order: Order, model: Path | str = MODEL, force: bool = False
) -> list[Performance]:
    """An order as a folder."""
    target = output.target(Path(out), OWN_FILES, force)
    sound = heard(speech)
    performances = perform(performer(Path(model)), sound, order)
    write(target, performances, sound, order, made_of(sound, origin_of(Path(model)), order), spoken_of(speech))
    return performances


def carry_out_dialogue(
    sounds: Sequence[Float[ndarray, " _"]],
    out: Path | str,
    order: Order,
    model: Path | str = MODEL,
    force: bool = False,
) -> list[Dialogue]:
    """An order for two people who talk with each other, as the folders `first` and `second`.

    Whom it asks for by name are two: `A,B`.
    """
    from talkingeyes.animation.dialogue import converse

    target = output.target(Path(out), DIALOGUE, force)
    asked = order.direction.person
    persons = (None, None) if asked is None else asked.split(",")
    if len(persons) != 2:
        raise InputError(f"person: should be two in a dialogue (A,B), got {asked}")
    first, second = (replace(order.direction, person=each) for each in persons)
    dialogues = converse(performer(Path(model)), sounds, order.samples, order.seed, order.fps, (first, second))
    origin = origin_of(Path(model))
    with output.appearing(target) as folder:
        pairs = (("first", first, sounds), ("second", second, sounds[::-1]))
        for name, direction, (own, other) in pairs:
            made = made_of(own, origin, replace(order, direction=replace(direction, partner=other)))
            write(folder / name, [getattr(each, name) for each in dialogues], own, order, made)
    return dialogues


def performer(model: Path) -> Performer:
    """The model in a folder of the train stage, or in a packed file."""
    from talkingeyes.animation.perform import Performer

    return Performer.load(model)


def heard(speech: Speech | SpokenText) -> Float[ndarray, " N"]:
    """The sound of a file or of spoken text, or the sound itself."""
    if isinstance(speech, Path | str):
        return read_speech(speech)
    return speech if isinstance(speech, ndarray) else speech.sound


def spoken_of(speech: Speech | SpokenText) -> SpokenText | None:
    """Text that was spoken, if it was one."""
    return None if isinstance(speech, Path | str | ndarray) else speech


def perform(model: Performer, sound: Float[ndarray, " N"], order: Order) -> list[Performance]:
    """The performances of an order."""
    return model.perform(sound, order.samples, order.seed, order.fps, order.direction)


@dataclass(frozen=True)
class Origin:
    """What makes results: the code and the model."""

    version: str
    code_sha256: str
    model_sha256: str


def origin_of(model: Path) -> Origin:
    """This code with a model."""
    return Origin(version("talkingeyes"), code_digest(ROOMS), _model_digest(model))


def made_of(sound: Float[ndarray, " N"], origin: Origin, order: Order) -> dict[str, Any]:
    """All that a result follows from: code, model, sound, what is asked for."""
    return {
        "schema": "talkingeyes.made_of/1",
        **asdict(origin),
        "sound_sha256": hashlib.sha256(np.ascontiguousarray(sound).tobytes()).hexdigest(),
        **json.loads(json.dumps(asdict(order), default=_digest_of)),
    }


def _digest_of(value: object) -> object:
    if isinstance(value, ndarray):
        return {"sha256": hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}
    if isinstance(value, Path):
        return {"sha256": hashlib.sha256(value.read_bytes()).hexdigest()}
    raise TypeError(f"an order should hold plain values, arrays and files, got {type(value).__name__}")


def _model_digest(model: Path) -> str:
    """Of a packed file, or of the files in a folder and in that of the face beside it."""
    from talkingeyes.animation.face import beside

    if model.is_file():
        return hashlib.sha256(model.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    for folder in filter(None, (model, beside(model))):
        for path in sorted(each for each in folder.iterdir() if each.is_file()):
            digest.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def write(
    target: Path,
    performances: Sequence[Performance],
    sound: Float[ndarray, " N"],
    order: Order,
    made: dict[str, Any],
    spoken: SpokenText | None = None,
    bars: bool = True,
) -> None:
    """The folder of a result, whole or not at all; `bars` show how far its films are."""
    try:
        with output.appearing(target) as folder:
            if spoken is not None:
                spoken.save(folder / "speech.wav")
            for index, performance in enumerate(performances):
                _write_sample(folder / f"sample_{index:02d}", performance, sound, order, bars)
            if order.pictures:
                _draw(folder, performances, sound)
            (folder / MADE_OF).write_text(json.dumps(made, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"{target}: should be a folder that can be written, got: {error.strerror or error}") from None


def _write_sample(stem: Path, performance: Performance, sound: Float[ndarray, " N"], order: Order, bars: bool) -> None:
    from talkingeyes.head.anny import open_head
    from talkingeyes.rendering.render import Painter
    from talkingeyes.rendering.video import write_video
    from talkingeyes.rendering.view import FRAMINGS

    motion = performance.motion
    performance.save(stem.with_name(f"{stem.name}.npz"))
    for format in order.formats:
        convert.write(motion, performance.events, format, convert.beside(stem, format), model=order.flame)
    if order.pictures:
        painter = Painter(open_head(), FRAMINGS["head"].view(PICTURE_PX, PICTURE_PX))
        drawn = painter.draw(motion)
        pictures = progress(drawn, f"{stem.name}.mp4", len(motion)) if bars else drawn
        write_video(stem.with_name(f"{stem.name}.mp4"), iter(pictures), motion.fps, sound)


def _draw(folder: Path, performances: Sequence[Performance], sound: Float[ndarray, " N"]) -> None:
    from PIL import Image

    from talkingeyes.head.anny import open_head
    from talkingeyes.rendering.sheet import contact_sheet
    from talkingeyes.rendering.traces import plot_traces

    motions = [performance.motion for performance in performances]
    plot_traces(motions, sound, folder / "traces.png")
    times_s = [(column + 0.5) * motions[0].seconds / SHEET_COLUMNS for column in range(SHEET_COLUMNS)]
    Image.fromarray(contact_sheet(open_head(), motions[:SHEET_ROWS], times_s, SHEET_PX)).save(folder / "sheet.png")
