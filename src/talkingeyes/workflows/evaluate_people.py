"""Comparison of any motion with recorded people: `talkingeyes evaluate MOTIONS --people DATA`.

Reads motion files (corpus/motion_files.py), the table of recorded fixations (evaluation/people/fixations.py), and what
says when the subject speaks and when it listens: the annotations of a corpus whose clips the files are named after, or
sounds of the same names. Baselines are rows, too: the people themselves, recorded again; uniform eyes; and with a
corpus its true motion and Random (the true motion of a training clip under another sound). Needs no trained model. If a
folder is given, writes people.json.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core import output_folder
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_files import MotionFields, motion_files, read_motions
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.detectors.behaviour import behaviour
from talkingeyes.evaluation.people.comparison import as_text, compare_with_people
from talkingeyes.evaluation.people.fixations import Person, read_people, split_people
from talkingeyes.evaluation.people.tracker import (
    CLOSED,
    TRACKER,
    GazeClip,
    record_again,
    record_person,
    uniform_gaze_deg,
)
from talkingeyes.physiology.gaze_population import STATES
from talkingeyes.workflows.evaluate import CONFIDENCE_LEVEL, MAX_NOTES, EvaluatedSound, annotate_sound, match_files

OUTPUT_FILES = re.compile(r"people\.json")
SILENCE_S = 2.0  # silence this long is listening; pauses within a turn are shorter
ANY_SPEAKER = "motions"
RERECORDED, UNIFORM, RANDOM, TRUTH, MOTIONS = "re-recorded", "uniform", "random", "truth", "motions"

Clips = Mapping[str, Sequence[GazeClip]]  # by speaker


@dataclass(frozen=True)
class PeopleResult:
    """The comparison as JSON (evaluation/people/comparison.py), the speakers of all rows as recorded, and notes."""

    content: dict[str, Any]
    rows: dict[str, list[Person]]
    notes: list[str]


@dataclass(frozen=True)
class _ReadSound:
    """A sound, when its subject speaks, and the gaze of its motions."""

    sound: EvaluatedSound
    annotation: Annotation
    clips: list[GazeClip]

    @property
    def speaker(self) -> str:
        return self.sound.takes[0].speaker if self.sound.takes else ANY_SPEAKER


def evaluate_people(
    motions: Path | str,
    people: Path | str,
    out: Path | str | None = None,
    *,
    reference: Path | str | None = None,
    sound: Path | str | None = None,
    n_resamples: int = 1000,
    seed: int = 0,
    force: bool = False,
    others: Mapping[str, Path] | None = None,
) -> PeopleResult:
    """Compare the motion files of a folder with recorded people.

    `reference`: a corpus whose clips the files are named after. `sound`: a folder of sounds named as the files. One of
    them is needed. `others`: more folders of motions, each a row of its name beside the same baselines (a baseline of
    the same name is replaced). Raises InputError (one line) for invalid folders, files or numbers.
    """
    folders = [Path(motions), *(others or {}).values()]
    check_request(folders, reference, sound, n_resamples, seed)
    output_path = None if out is None else output_folder.output_path(Path(out), OUTPUT_FILES, force)
    recorded = read_people(Path(people))
    corpus = None if reference is None else Corpus(Path(reference))
    notes: list[str] = []
    own, *further = [
        _read(usable_sounds(motion_files(folder), corpus, None if sound is None else Path(sound), notes), corpus, notes)
        for folder in folders
    ]
    clips = _baseline_rows(own, corpus, seed, notes) | {MOTIONS: _by_speaker(own)}
    clips |= {name: _by_speaker(each) for name, each in zip(others or {}, further, strict=True)}
    settings = BootstrapSettings(n_resamples=n_resamples, confidence_level=CONFIDENCE_LEVEL, seed=seed)
    rng = np.random.default_rng(seed)
    rows = {RERECORDED: [record_again(person, TRACKER, rng) for person in recorded]}
    rows |= {name: record_speakers(each, seed) for name, each in clips.items()}
    content = compare_with_people(recorded, rows, settings)
    reasons = {each["rows"][MOTIONS]["reason"]: state for state, each in content["states"].items()}
    notes += [f"{state}: {reason}" for reason, state in reasons.items() if reason]
    validation = [person.name for person in split_people(recorded)[1]]
    content |= {"validation_people": validation, "tracker": asdict(TRACKER), "notes": notes}
    if output_path is not None:
        with output_folder.atomic_folder(output_path) as folder:
            (folder / "people.json").write_text(json.dumps(content, indent=1))
    return PeopleResult(content, rows, notes)


def check_request(
    folders: Sequence[Path], reference: Path | str | None, sound: Path | str | None, n_resamples: int, seed: int
) -> None:
    """Raises InputError for folders that are none, numbers out of bounds, and motions without sounds."""
    if n_resamples < 20 or seed < 0:
        raise InputError(f"n_resamples and seed: should be at least 20 and 0, got {n_resamples} and {seed}")
    if reference is None and sound is None:
        raise InputError("--people: needs the sounds of the motions; give --reference CORPUS or --sound DIR")
    for folder in (*folders, *([Path(sound)] if sound else [])):
        if not folder.is_dir():
            raise InputError(f"{folder}: should be a folder, got none")


def usable_sounds(
    files: dict[str, list[Path]], corpus: Corpus | None, sound: Path | None, notes: list[str]
) -> list[EvaluatedSound]:
    """The sounds of the files; files without a sound are noted. Raises InputError if there is none."""
    matched, unmatched, more = match_files(files, corpus, sound)
    notes.extend(more)
    usable = [each for each in [*matched, *unmatched] if each.takes or each.sound is not None]
    silent = len(matched) + len(unmatched) - len(usable)
    if not usable:
        where = " or ".join(str(each) for each in (corpus and corpus.root, sound) if each)
        raise InputError(f"{where}: should hold the sounds of the motions, got none of {', '.join(list(files)[:3])}")
    if silent and not more:
        notes.append(f"{silent} names have no sound and are excluded")
    return usable


def _read(sounds: Sequence[EvaluatedSound], corpus: Corpus | None, notes: list[str]) -> list[_ReadSound]:
    """The motions of all sounds. Raises InputError if there is none."""
    found = []
    for each in sounds:
        annotation = corpus.annotation(each.takes[0]) if corpus and each.takes else annotate_sound(each.sound)
        assert annotation is not None
        found.append(_ReadSound(each, annotation, list(_clips(each.files, annotation, notes))))
    if not any(each.clips for each in found):
        raise InputError(f"the motions should hold gaze and head, got none ({notes[0] if notes else 'no file'})")
    return found


def _by_speaker(sounds: Sequence[_ReadSound]) -> Clips:
    row: dict[str, list[GazeClip]] = defaultdict(list)
    for each in sounds:
        row[each.speaker] += each.clips
    return row


def _baseline_rows(
    sounds: Sequence[_ReadSound], corpus: Corpus | None, seed: int, notes: list[str]
) -> dict[str, Clips]:
    """Clips of the baselines by speaker, as many as of the motions of the sounds."""
    rows: dict[str, dict[str, list[GazeClip]]] = {name: defaultdict(list) for name in (UNIFORM, RANDOM, TRUTH)}
    bank = [] if corpus is None or not corpus.has_truth else corpus.select("train", take=0)
    rng = np.random.default_rng(seed)
    for each in sounds:
        for clip in each.clips:
            gaze = uniform_gaze_deg(len(clip.state), clip.fps, rng)
            rows[UNIFORM][each.speaker].append(GazeClip(clip.fps, gaze, clip.state, np.zeros(len(gaze), bool)))
        if corpus is not None and corpus.has_truth:
            rows[TRUTH][each.speaker] += _clips(true_files(corpus, each.sound.takes), each.annotation, notes)
            others = [clip for clip in bank if clip.sound != each.sound.name]
            chosen = [others[index] for index in rng.integers(len(others), size=len(each.clips))] if others else []
            rows[RANDOM][each.speaker] += _clips(true_files(corpus, chosen), each.annotation, notes)
    return {name: speakers for name, speakers in rows.items() if any(speakers.values())}


def true_files(corpus: Corpus, clips: Sequence[Clip]) -> list[Path]:
    """The true motions of clips, those that exist."""
    paths = [shard_path(corpus.root / "truth", clip.id, ".npz") for clip in clips]
    return [path for path in paths if path.is_file()]


def record_speakers(clips: Clips, seed: int) -> list[Person]:
    """Record all speakers of a row with the simulated tracker."""
    rng = np.random.default_rng([seed, len(clips)])
    return [record_person(name, each, TRACKER, rng) for name, each in sorted(clips.items()) if each]


def _clips(paths: Sequence[Path], annotation: Annotation, notes: list[str]) -> Iterator[GazeClip]:
    """The gaze of all motions of the files; unreadable files are noted."""
    for path in paths:
        try:
            for motion in read_motions(path):
                yield gaze_clip(motion, annotation)
        except InputError as error:
            text = str(error)
            notes.append(text if str(path) in text else f"{path}: {text}")


def gaze_clip(motion: MotionFields, annotation: Annotation) -> GazeClip:
    """Gaze in space of a motion with the state of each frame. Raises InputError without head and gaze."""
    missing = [name for name in ("head", "gaze") if name not in motion.fields]
    if missing:
        raise InputError(f"should hold head and gaze, got no {' and no '.join(missing)}")
    found = behaviour(motion.fps, motion.fields, motion.valid)
    closed = np.zeros(len(found), bool) if found.lid is None else found.lid.mean(axis=1) > CLOSED
    state = conversational_state(annotation, len(found), motion.fps)
    return GazeClip(motion.fps, np.degrees(found.gaze_in_space_rad), state, closed | ~found.valid)


def conversational_state(annotation: Annotation, frames: int, fps: float) -> Int[ndarray, " T"]:
    """Index of STATES for each frame: listening in the partner's turns and in silences of SILENCE_S or more."""
    times_s: Float[ndarray, " T"] = np.arange(frames) / fps
    edges = [0.0, *(edge for span in annotation.speaking for edge in (span.start_s, span.end_s)), frames / fps]
    quiet = [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if end - start >= SILENCE_S]
    spans = [*quiet, *((span.start_s, span.end_s) for span in annotation.listening)]
    listening = np.zeros(frames, bool)
    for start, end in spans:
        listening |= (times_s >= start) & (times_s < end)
    return np.where(listening, STATES.index("listening"), STATES.index("speaking"))


def people_text(found: PeopleResult) -> str:
    """The tables as text for a terminal, with notes."""
    legend = (
        "value [ratio]: distance to the median of people / distance between two people (apart); halves: people against"
        " other people; * speakers pooled"
    )
    more = len(found.notes) - MAX_NOTES
    notes = [*found.notes[:MAX_NOTES], *([f"and {more} more notes"] if more > 0 else [])]
    return "\n".join([as_text(found.content), "", legend, *(f"note: {note}" for note in notes)])
