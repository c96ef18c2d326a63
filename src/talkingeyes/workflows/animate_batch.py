"""Batch animation: `talkingeyes animate lines/*.wav -o DIR`.

Each sound gets its own folder in DIR, written as by `animate.write_animation`, with the name of the sound. The tables
summary.csv and summary.json (file, seconds, samples, seed, status, reason) list the results. A failure does not stop
the others. Finished results with the same sound, model, options and code are kept, so an interrupted run resumes. The
seed of a sound follows from the seed of the run and from the sound, so the result does not depend on other sounds,
their order and the number of jobs. `animate FILE --seed` with the seed of the table gives the same motions.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.model_file import find_model
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.core import output_folder
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.run import parallel_map
from talkingeyes.workflows import animate
from talkingeyes.workflows.animate import MANIFEST_FILE, OWN_FILES, AnimationOptions, Provenance

if TYPE_CHECKING:
    from talkingeyes.animation.animator import Animator

SOUND_SUFFIXES = (
    ".wav",
    ".flac",
    ".ogg",
    ".oga",
    ".opus",
    ".mp3",
    ".m4a",
    ".aac",
    ".aiff",
    ".mp4",
)  # searched in a folder
SUMMARIES = ("summary.csv", "summary.json")
PARTIAL = re.compile(r"\..+\.\d+\.partial")
DONE, SKIPPED, FAILED = "done", "skipped", "failed"


@dataclass(frozen=True)
class BatchResult:
    """Result of a sound; `reason` explains a failure."""

    file: str
    seconds: float
    samples: int
    seed: int
    status: str
    reason: str = ""


@dataclass(frozen=True)
class _Task:
    speech: Path
    output_path: Path
    model: Path
    provenance: Provenance
    options: AnimationOptions
    force: bool


def animate_all(
    speech: Sequence[Path | str],
    out: Path | str,
    options: AnimationOptions,
    *,
    model: Path | str | None = None,
    jobs: int = 1,
    force: bool = False,
) -> list[BatchResult]:
    """Animate the sounds, or those in folders; returns a result for each, in the order of their names.

    `force` overwrites results with other inputs or options. Raises InputError (one line) before any work is done.
    """
    if jobs < 1:
        raise InputError(f"jobs: should be 1 or more, got {jobs}")
    sounds = find_sounds([Path(path) for path in speech])
    folder = _folder(Path(out), sounds)
    found = find_model(model).absolute()  # worker processes may be those of a call made in another folder
    animate.load_performer(found)  # report an invalid model once, not for every sound
    provenance = animate.provenance_of(found)
    folder.mkdir(parents=True, exist_ok=True)
    tasks = [_Task(path, folder / name, found, provenance, options, force) for name, path in sounds.items()]
    lines = list(parallel_map(_animate_sound, tasks, jobs, "animate"))
    _write_summary(folder, lines)
    return lines


def find_sounds(paths: Sequence[Path]) -> dict[str, Path]:
    """Sounds by the names of their results; a folder is replaced by the sounds in it."""
    listed: list[Path] = []
    for path in paths:
        inside = (
            [each for each in sorted(path.iterdir()) if each.suffix.lower() in SOUND_SUFFIXES]
            if path.is_dir()
            else [path]
        )
        if not inside:
            raise InputError(f"{path}: should hold sounds ({', '.join(SOUND_SUFFIXES)}), got none")
        listed += inside
    found: dict[str, Path] = {}
    for path in sorted(listed, key=lambda each: (each.stem, str(each))):
        if path.stem in found:
            raise InputError(f"{path}: another sound is called {path.stem} too: {found[path.stem]}")
        if path.stem in SUMMARIES or path.stem.startswith("."):
            raise InputError(f"{path}: should have another name, because its results would be called {path.stem}")
        found[path.stem] = path
    return found


def _folder(out: Path, sounds: dict[str, Path]) -> Path:
    """The folder of all results: new, empty, or that of an earlier run, whose partial results are removed."""
    folder = output_folder.output_path(out, re.compile(".+"), force=True)
    earlier = sorted(folder.iterdir()) if folder.is_dir() else []
    for path in earlier:
        ours = path.name in SUMMARIES or (path / MANIFEST_FILE).is_file() or PARTIAL.fullmatch(path.name)
        if not ours:
            raise InputError(
                f"{out}: should be a new or empty folder, or that of an earlier run, got {path.name} in it"
            )
    for path in earlier:
        if PARTIAL.fullmatch(path.name):
            shutil.rmtree(path)
    return folder


def _animate_sound(task: _Task) -> BatchResult:
    """Animate one sound, unless it is up to date."""
    line = BatchResult(task.speech.name, 0.0, task.options.samples, task.options.seed, FAILED)
    try:
        sound = read_speech(task.speech)
        options = replace(task.options, seed=derive_seed(task.options.seed, sound))
        line = replace(line, seconds=round(len(sound) / SAMPLE_RATE, 3), seed=options.seed)
        manifest = animate.build_manifest(sound, task.provenance, options)
        if _is_up_to_date(task.output_path, manifest):
            return replace(line, status=SKIPPED)
        output_path = output_folder.output_path(task.output_path, OWN_FILES, task.force)
        animations = animate.sample_animations(_performer(task.model, task.provenance), sound, options)
        animate.write_animation(output_path, animations, sound, options, manifest, one_process=True)
        return replace(line, status=DONE)
    except Exception as error:  # any error is reported in the table; the other sounds continue
        said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        return replace(line, reason=" ".join(said.split()))


def derive_seed(seed: int, sound: Float[ndarray, " N"]) -> int:
    """The seed of a sound: a hash of the seed of the run and the sound, so that sounds of a run get different
    blinks."""
    sound_digest = hashlib.sha256(np.ascontiguousarray(sound).tobytes()).digest()
    return int.from_bytes(hashlib.sha256(f"{seed}:".encode() + sound_digest).digest()[:4], "big") >> 1


@lru_cache(maxsize=1)
def _performer(model: Path, provenance: Provenance) -> Animator:
    """The model, loaded once per process; a changed model (by its provenance) is loaded again."""
    return animate.load_performer(model)


def _is_up_to_date(folder: Path, manifest: dict[str, Any]) -> bool:
    try:
        found = read_json(folder / MANIFEST_FILE, "manifest")
    except InputError:
        return False
    return bool(found == json.loads(json.dumps(manifest)))


def _write_summary(folder: Path, lines: Sequence[BatchResult]) -> None:
    from talkingeyes.core.atomic_file import atomic_write

    rows = [asdict(line) for line in lines]
    table = io.StringIO()
    writer = csv.DictWriter(table, [field.name for field in fields(BatchResult)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    for name, text in zip(SUMMARIES, (table.getvalue(), json.dumps(rows, indent=1) + "\n"), strict=True):
        with atomic_write(folder / name) as partial:
            partial.write_text(text)
