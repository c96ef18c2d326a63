"""Timing of gaze beside recorded conversations: `talkingeyes evaluate MOTIONS --people CONTACT --turns TURNS`.

Reads motion files and the two tables of recorded people (evaluation/people/conversations.py). Who has the turn comes
from a corpus whose clips the files are named after, or from sounds of the same names with two channels: the subject,
then the partner. Rows: the people by coder, then with a corpus Random (the true motion of a training clip under another
sound) and its true motion, then the motions. If a folder is given, writes timing.json.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.core import output_folder
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_files import MotionFields, motion_files
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.detectors.behaviour import behaviour
from talkingeyes.evaluation.measures.pooled import speaking_turns
from talkingeyes.evaluation.people.conversations import RATE_HZ, ConversationGaze, Turns, read_conversations
from talkingeyes.evaluation.people.timing import compare_timing, timing_table
from talkingeyes.evaluation.text_tables import aligned
from talkingeyes.workflows.evaluate import CONFIDENCE_LEVEL, MAX_NOTES, EvaluatedSound, read_noted
from talkingeyes.workflows.evaluate_people import MOTIONS, RANDOM, TRUTH, check_request, true_files, usable_sounds

OUTPUT_FILES = re.compile(r"timing\.json")


@dataclass(frozen=True)
class TimingResult:
    """All rows as JSON (evaluation/people/timing.py), and notes."""

    content: dict[str, Any]
    notes: list[str]


def evaluate_timing(
    motions: Path | str,
    people: Path | str,
    turns: Path | str,
    out: Path | str | None = None,
    *,
    reference: Path | str | None = None,
    sound: Path | str | None = None,
    n_resamples: int = 1000,
    seed: int = 0,
    force: bool = False,
    others: Mapping[str, Path] | None = None,
) -> TimingResult:
    """Compare the timing of gaze in a folder of motion files with recorded conversations.

    `people`: looks at the partner, `turns`: who speaks (CSV). `reference`: a corpus whose clips the files are named
    after. `sound`: a folder of sounds of two channels, named as the files. `others`: more folders of motions, each
    a row of its name. Raises InputError (one line) for invalid folders, files, tables or numbers.
    """
    folders = {MOTIONS: Path(motions), **(others or {})}
    check_request(list(folders.values()), reference, sound, n_resamples, seed)
    output_path = None if out is None else output_folder.output_path(Path(out), OUTPUT_FILES, force)
    recorded = read_conversations(Path(people), Path(turns))
    corpus = None if reference is None else Corpus(Path(reference))
    notes: list[str] = []
    rows = {row_name(coder): each for coder, each in recorded.items()}
    found = {
        name: _read(
            usable_sounds(motion_files(folder), corpus, None if sound is None else Path(sound), notes), corpus, notes
        )
        for name, folder in folders.items()
    }
    rows |= _baselines(found[MOTIONS], corpus, seed, notes)
    rows |= {name: [gaze for each in sounds for gaze in each.gazes] for name, sounds in found.items()}
    settings = BootstrapSettings(n_resamples=n_resamples, confidence_level=CONFIDENCE_LEVEL, seed=seed)
    content = compare_timing(rows, settings) | {"notes": notes}
    if output_path is not None:
        with output_folder.atomic_folder(output_path) as folder:
            (folder / "timing.json").write_text(json.dumps(content, indent=1))
    return TimingResult(content, notes)


def row_name(coder: str) -> str:
    """The row of the people by a coder, or where all agree."""
    return f"people, coder {coder}" if coder.isdigit() else f"people, {coder}"


@dataclass(frozen=True)
class _Sound:
    """A sound with its unit and turns, and the gaze of its motions."""

    sound: EvaluatedSound
    unit: str
    turns: Turns
    gazes: list[ConversationGaze]


def _read(sounds: Sequence[EvaluatedSound], corpus: Corpus | None, notes: list[str]) -> list[_Sound]:
    """The motions of all sounds. Raises InputError if there is none."""
    found = []
    for each in sounds:
        unit = each.takes[0].speaker if each.takes else each.name
        turns = conversation_turns(corpus, each)
        found.append(_Sound(each, unit, turns, list(_gazes(each.files, unit, turns, notes))))
    if not any(each.gazes for each in found):
        raise InputError(f"the motions should hold gaze and head, got none ({notes[0] if notes else 'no file'})")
    return found


def conversation_turns(corpus: Corpus | None, sound: EvaluatedSound) -> Turns:
    """Turns by the annotation of a clip, or by the level of both channels. Raises InputError without two channels."""
    if corpus is not None and sound.takes:
        annotation = corpus.conversation(sound.takes[0])
    else:
        from talkingeyes.audio.turn_taking import detect_turns
        from talkingeyes.audio.waveform import read_dialogue

        assert sound.sound is not None
        annotation = detect_turns(*read_dialogue(sound.sound))
    return Turns.of(speaking_turns(annotation), annotation.listening)


def _baselines(
    sounds: Sequence[_Sound], corpus: Corpus | None, seed: int, notes: list[str]
) -> dict[str, list[ConversationGaze]]:
    """Random and true motion of a corpus with truth, as many of random as motions of the sounds."""
    rows: dict[str, list[ConversationGaze]] = {RANDOM: [], TRUTH: []}
    if corpus is None or not corpus.has_truth:
        return rows
    rng, bank = np.random.default_rng(seed), corpus.select("train", take=0)
    for each in sounds:
        rows[TRUTH] += _gazes(true_files(corpus, each.sound.takes), each.unit, each.turns, notes)
        strangers: list[Clip] = [clip for clip in bank if clip.sound != each.sound.name]
        chosen = rng.integers(len(strangers), size=len(each.gazes)).tolist() if strangers else []
        rows[RANDOM] += _gazes(true_files(corpus, [strangers[index] for index in chosen]), each.unit, each.turns, notes)
    return rows


def _gazes(paths: Sequence[Path], unit: str, turns: Turns, notes: list[str]) -> Iterator[ConversationGaze]:
    """The gaze of all motions of the files; unreadable files are noted."""
    return read_noted(paths, lambda each: motion_gaze(each, unit, turns), notes)


def motion_gaze(motion: MotionFields, unit: str, turns: Turns) -> ConversationGaze:
    """Gaze states of a motion at RATE_HZ. Raises InputError without head and gaze."""
    missing = [name for name in ("head", "gaze") if name not in motion.fields]
    if missing:
        raise InputError(f"should hold head and gaze, got no {' and no '.join(missing)}")
    found = behaviour(motion.fps, motion.fields, motion.valid)
    frames = (np.arange(int(len(found) / motion.fps * RATE_HZ)) / RATE_HZ * motion.fps).astype(int)
    return ConversationGaze(unit, found.states.averted[frames], found.valid[frames], turns)


def timing_text(found: TimingResult) -> str:
    """The table as text for a terminal, a row a measure, with notes."""
    legend = "value (95 % interval over pairs or speakers); -: too few changes of turn, or no such time"
    more = len(found.notes) - MAX_NOTES
    notes = [*found.notes[:MAX_NOTES], *([f"and {more} more notes"] if more > 0 else [])]
    table = [list(row) for row in zip(*timing_table(found.content), strict=True)]
    return "\n".join([aligned(table), "", legend, *(f"note: {note}" for note in notes)])
