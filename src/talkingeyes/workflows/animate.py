"""`talkingeyes animate` and `talkingeyes.animate`: from speech to motion.

Reads a sound and a trained model. Returns animations. If a folder is given, writes sample_00.npz, .events.json and .mp4
of each sample, traces.png, sheet.png (the head at several times, one row per sample) and manifest.json (all inputs and
options). Synthesized text is also stored, as speech.wav and speech.json. The folder appears atomically, before the
films of a single sound are drawn, on all cores; they follow one by one, then manifest.json. Until then the file
films.unfinished is there, and the same call replaces the folder.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.animation.controls import Controls
from talkingeyes.animation.line_of_sight import check_forward_axis, to_forward_axes
from talkingeyes.animation.model_file import face_source, find_model
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core import output_folder
from talkingeyes.core.atomic_file import atomic_write, writing
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.run import code_digest, parallel_map
from talkingeyes.workflows import convert
from talkingeyes.workflows.render import check_look_of, load_shown_head

if TYPE_CHECKING:
    from talkingeyes.animation.animation import Animation
    from talkingeyes.animation.animator import Animator
    from talkingeyes.animation.dialogue import Dialogue
    from talkingeyes.core.motion import Motion
    from talkingeyes.rendering.render import HeadRenderer
    from talkingeyes.workflows.speak import SynthesizedSpeech

Speech = Path | str | Float[ndarray, " N"]  # a sound file, or a signal of 16 kHz mono

DEFAULT_CONTROLS = Controls()
VIDEO_PX = 256
FPS_BOUNDS = (10.0, 240.0)
MAX_SAMPLES = 1000
MANIFEST_FILE = "manifest.json"
UNFINISHED = "films.unfinished"
OWN_FILES = re.compile(
    r"sample_\d+(\.[a-z]+)?\.(npz|json|mp4|csv|glb|vrma|usda|npy|bvh)|(traces|sheet)\.png|manifest\.json|speech\.(wav|json)"
    r"|films\.unfinished|\.sample_\d+\.mp4\.\d+\.partial"
)
DIALOGUE_FOLDERS = re.compile("first|second")
SHEET_ROWS, SHEET_COLUMNS, SHEET_PX = 4, 8, 160
HASHED_MODULES = ("animation", "audio", "core", "head", "models", "physiology", "rendering", "training")


@dataclass(frozen=True)
class AnimationOptions:
    """Options of an animation. `formats` and `previews` (videos, plot, sheet) concern the written files.

    `flame` is the user's own FLAME file, which maps the face for formats on the FLAME head. `eyes` says what the
    forward axes of the eyes are in the formats: lines of sight (`visual`) or optical axes (`optical`); previews show
    the first. `eyelid` is a person's model (`talkingeyes eyelid fit`), for the heads of formats and previews; `look`
    that of the open head (`head.looks.LOOKS`).
    """

    samples: int = 3
    seed: int = 0
    fps: float = 25.0
    controls: Controls = DEFAULT_CONTROLS
    formats: tuple[str, ...] = ()
    previews: bool = True
    flame: Path | None = None
    eyes: str = "visual"
    eyelid: Path | None = None
    look: str | None = None

    def __post_init__(self) -> None:
        """Raises InputError (one line) for an invalid number or format."""
        if not 1 <= self.samples <= MAX_SAMPLES:
            raise InputError(f"samples: should be 1 to {MAX_SAMPLES}, got {self.samples}")
        if self.seed < 0:
            raise InputError(f"seed: should be 0 or more, got {self.seed}")
        if not (math.isfinite(self.fps) and FPS_BOUNDS[0] <= self.fps <= FPS_BOUNDS[1]):
            raise InputError(f"fps: should be {FPS_BOUNDS[0]:.0f} to {FPS_BOUNDS[1]:.0f}, got {self.fps}")
        convert.check_formats(self.formats)
        check_forward_axis(self.eyes)
        if self.flame is not None and not self.flame.is_file():
            raise InputError(f"{self.flame}: should be your FLAME file, got no file")
        if self.eyelid is not None:
            from talkingeyes.head.eyelid.person import load_person

            load_person(self.eyelid)
        check_look_of("anny", self.look)


def animate(
    speech: Speech,
    *,
    seed: int = 0,
    fps: float = 25.0,
    model: Path | str | None = None,
    controls: Controls = DEFAULT_CONTROLS,
) -> Animation:
    """Animate speech once. The result has a `save` method; the same seed gives the same result.

    `controls` sets targets, eye contact, liveliness, ... (docs/control.md). Raises InputError (one line) for an invalid
    sound, model or number.
    """
    return animate_samples(speech, 1, seed=seed, fps=fps, model=model, controls=controls)[0]


def animate_samples(
    speech: Speech,
    samples: int,
    *,
    seed: int = 0,
    fps: float = 25.0,
    model: Path | str | None = None,
    controls: Controls = DEFAULT_CONTROLS,
) -> list[Animation]:
    """Sample several animations of speech; the first equals that of `animate` with the same seed."""
    options = AnimationOptions(samples, seed, float(fps), controls)
    return sample_animations(load_performer(model), load_speech(speech), options)


def animate_to_folder(
    speech: Speech | SynthesizedSpeech,
    out: Path | str,
    *,
    samples: int = 3,
    seed: int = 0,
    fps: float = 25.0,
    model: Path | str | None = None,
    controls: Controls = DEFAULT_CONTROLS,
    formats: Sequence[str] = (),
    previews: bool = True,
    flame: Path | str | None = None,
    eyes: str = "visual",
    eyelid: Path | str | None = None,
    look: str | None = None,
    force: bool = False,
) -> list[Animation]:
    """Animate speech into a folder: motions, events, videos, a plot, and the chosen formats of `convert.FORMATS`.

    `eyes`, `eyelid` and `look` are as for `export`. `force` overwrites the output of an earlier call.
    """
    options = AnimationOptions(
        samples,
        seed,
        float(fps),
        controls,
        tuple(formats),
        previews,
        None if flame is None else Path(flame),
        eyes,
        None if eyelid is None else Path(eyelid),
        look,
    )
    return run_animation(speech, out, options, model, force)


def run_animation(
    speech: Speech | SynthesizedSpeech,
    out: Path | str,
    options: AnimationOptions,
    model: Path | str | None = None,
    force: bool = False,
) -> list[Animation]:
    """Animate speech into a folder, whose motions can be used while the films are drawn."""
    is_unfinished = os.path.isfile(Path(out, UNFINISHED))  # False for any name that cannot be one
    output_path = output_folder.output_path(Path(out), OWN_FILES, force or is_unfinished)
    sound = load_speech(speech)
    animations = sample_animations(load_performer(model), sound, options)
    manifest = build_manifest(sound, provenance_of(find_model(model)), options)
    with writing(output_path, "folder"):
        with output_folder.atomic_folder(output_path) as folder:
            _write_motions(folder, animations, sound, options, spoken_text(speech))
            (folder / UNFINISHED).touch()
        if options.previews:
            print(f"{out}: {len(animations)} motions are written, films follow", file=sys.stderr)
            for film in _films(output_path, animations, sound, options):
                print(f"{Path(out) / film}", file=sys.stderr)
        _write_manifest(output_path, manifest)
        (output_path / UNFINISHED).unlink()
    return animations


def run_dialogue(
    sounds: Sequence[Float[ndarray, " _"]],
    out: Path | str,
    options: AnimationOptions,
    model: Path | str | None = None,
    force: bool = False,
) -> list[Dialogue]:
    """Animate two speakers of a dialogue, into the folders `first` and `second`.

    `controls.person` names both speakers: `A,B`.
    """
    from talkingeyes.animation.dialogue import animate_dialogue

    output_path = output_folder.output_path(Path(out), DIALOGUE_FOLDERS, force)
    asked = options.controls.person
    persons = (None, None) if asked is None else asked.split(",")
    if len(persons) != 2:
        raise InputError(f"person: should be two in a dialogue (A,B), got {asked}")
    first, second = (replace(options.controls, person=each) for each in persons)
    dialogues = animate_dialogue(
        load_performer(model), sounds, options.samples, options.seed, options.fps, (first, second)
    )
    provenance = provenance_of(find_model(model))
    with output_folder.atomic_folder(output_path) as folder:
        pairs = (("first", first, sounds), ("second", second, sounds[::-1]))
        for name, controls, (own, other) in pairs:
            manifest = build_manifest(own, provenance, replace(options, controls=replace(controls, partner=other)))
            write_animation(folder / name, [getattr(each, name) for each in dialogues], own, options, manifest)
    return dialogues


def load_performer(model: Path | str | None) -> Animator:
    """Load a model from a folder of the train stage, or a packed file."""
    from talkingeyes.animation.animator import Animator

    return Animator.load(find_model(model))


def load_speech(speech: Speech | SynthesizedSpeech) -> Float[ndarray, " N"]:
    """The sound of a file, of synthesized speech, or the given signal."""
    if isinstance(speech, Path | str):
        return read_speech(speech)
    return speech if isinstance(speech, ndarray) else speech.sound


def spoken_text(speech: Speech | SynthesizedSpeech) -> SynthesizedSpeech | None:
    """The synthesized speech, if the input was text."""
    return None if isinstance(speech, Path | str | ndarray) else speech


def sample_animations(model: Animator, sound: Float[ndarray, " N"], options: AnimationOptions) -> list[Animation]:
    """Sample the animations of the options."""
    return model.perform(sound, options.samples, options.seed, options.fps, options.controls)


@dataclass(frozen=True)
class Provenance:
    """Identity of the code and the model of a result."""

    version: str
    code_sha256: str
    model_sha256: str


def provenance_of(model: Path) -> Provenance:
    """Provenance of this code with a model."""
    return Provenance(version("talkingeyes"), code_digest(HASHED_MODULES), _model_digest(model))


def build_manifest(sound: Float[ndarray, " N"], provenance: Provenance, options: AnimationOptions) -> dict[str, Any]:
    """All inputs of a result: code, model, sound and options; an open end of a span is null."""
    return {
        "schema": "talkingeyes.manifest/2",
        **asdict(provenance),
        "sound_sha256": hashlib.sha256(np.ascontiguousarray(sound).tobytes()).hexdigest(),
        **json.loads(json.dumps(asdict(options), default=_digest_of), parse_constant=lambda _: None),
    }


def _digest_of(value: object) -> object:
    if isinstance(value, ndarray):
        return {"sha256": hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}
    if isinstance(value, Path):
        return {"sha256": hashlib.sha256(value.read_bytes()).hexdigest()}
    raise TypeError(f"options: should contain plain values, arrays and files, got {type(value).__name__}")


def _model_digest(model: Path) -> str:
    """Digest of the files of a model and of its face: packed files, or all files of their folders."""
    digest = hashlib.sha256()
    for source in dict.fromkeys((model, face_source(model))):
        for path in [source] if source.is_file() else sorted(each for each in source.iterdir() if each.is_file()):
            digest.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def write_animation(
    output_path: Path,
    animations: Sequence[Animation],
    sound: Float[ndarray, " N"],
    options: AnimationOptions,
    manifest: dict[str, Any],
    *,
    one_process: bool = False,
) -> None:
    """Write the folder of a result atomically, with its films; `one_process` draws them here, without progress."""
    with writing(output_path, "folder"), output_folder.atomic_folder(output_path) as folder:
        _write_motions(folder, animations, sound, options, None)
        for _ in _films(folder, animations, sound, options, one_process) if options.previews else ():
            pass
        _write_manifest(folder, manifest)


def _write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    with atomic_write(folder / MANIFEST_FILE) as partial_file:
        partial_file.write_text(json.dumps(manifest, indent=1, allow_nan=False) + "\n")


def _write_motions(
    folder: Path,
    animations: Sequence[Animation],
    sound: Float[ndarray, " N"],
    options: AnimationOptions,
    spoken: SynthesizedSpeech | None,
) -> None:
    """Everything but films and manifest."""
    if spoken is not None:
        spoken.save(folder / "speech.wav")
    for index, performance in enumerate(animations):
        stem = folder / f"sample_{index:02d}"
        performance.save(stem.with_name(f"{stem.name}.npz"))
        for format in options.formats:
            convert.write_motion(
                performance.motion,
                performance.events,
                format,
                convert.sibling_name(stem, format),
                model=options.flame,
                eyes=options.eyes,
                eyelid=options.eyelid,
                look=options.look,
            )
    if options.previews:
        _draw(folder, animations, sound, options)


def _films(
    folder: Path,
    animations: Sequence[Animation],
    sound: Float[ndarray, " N"],
    options: AnimationOptions,
    one_process: bool = False,
) -> Iterator[str]:
    """Write the films one after the other, each drawn on all cores; yields the names of those that are there."""
    import joblib

    from talkingeyes.rendering.render import BLOCK_FRAMES, HeadRenderer
    from talkingeyes.rendering.video import write_video
    from talkingeyes.rendering.view import FRAMINGS

    head = load_shown_head(eyelid=options.eyelid, look=options.look)
    draw = partial(_draw_block, HeadRenderer(head, FRAMINGS["head"].view(VIDEO_PX, VIDEO_PX)))
    for index, performance in enumerate(animations):
        name, shown = f"sample_{index:02d}.mp4", to_forward_axes(performance.motion)
        blocks = [shown.cut(at, at + BLOCK_FRAMES) for at in range(0, len(shown), BLOCK_FRAMES)]
        jobs = min(joblib.cpu_count(), len(blocks))
        drawn = map(draw, blocks) if one_process else parallel_map(draw, blocks, jobs, name)
        write_video(folder / name, chain.from_iterable(drawn), shown.fps, sound)
        yield name


def _draw_block(renderer: HeadRenderer, motion: Motion) -> list[UInt8[ndarray, "H W 3"]]:
    return list(renderer.draw(motion))


def _draw(
    folder: Path, animations: Sequence[Animation], sound: Float[ndarray, " N"], options: AnimationOptions
) -> None:
    from PIL import Image

    from talkingeyes.rendering.contact_sheet import contact_sheet
    from talkingeyes.rendering.traces import plot_traces

    motions = [performance.motion for performance in animations]
    plot_traces(motions, sound, folder / "traces.png")
    times_s = [(column + 0.5) * motions[0].seconds / SHEET_COLUMNS for column in range(SHEET_COLUMNS)]
    shown = [to_forward_axes(motion) for motion in motions[:SHEET_ROWS]]
    head = load_shown_head(eyelid=options.eyelid, look=options.look)
    Image.fromarray(contact_sheet(head, shown, times_s, SHEET_PX)).save(folder / "sheet.png")
