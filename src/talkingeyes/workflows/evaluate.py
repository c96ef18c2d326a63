"""Evaluation of any motion against a corpus: `talkingeyes evaluate`.

Reads motion files (corpus/motion_files.py) and a corpus with its true motion. Files named as clips of the corpus are
compared with the truth for the same sounds. Files for other sounds are compared with the truth of all test and unseen
sounds, and metrics that depend on speech need the sounds themselves. If a folder is given, writes benchmark.json,
benchmark.csv and strip.png. Memory does not grow with the number of clips. With the data folder of a finished pipeline
on the corpus, its frozen networks add Corr. for the sounds, and the distances that need a window encoder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core import output_folder
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_files import MotionFields, motion_files, read_motions
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.comparison import Accumulator, Comparison, MetricResult, extract
from talkingeyes.evaluation.benchmark.table import as_json, as_text, to_csv
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.detectors.behaviour import Behaviour, behaviour, with_references
from talkingeyes.evaluation.measures.corr import with_corr
from talkingeyes.evaluation.measures.features import add_features, gather_features
from talkingeyes.orchestration.run import parallel_map

if TYPE_CHECKING:
    from talkingeyes.evaluation.measures.evaluators import Evaluators

T = TypeVar("T")
OUTPUT_FILES = re.compile(r"benchmark\.(json|csv)|strip\.png")
HELD_OUT = ("test", "unseen")
SOUNDS = (".wav", ".flac", ".ogg", ".mp3", ".m4a")
CLIPS_PER_TASK = 32
CONFIDENCE_LEVEL = 0.95
MAX_NOTES = 5
SHUFFLED_SOUNDS = 2  # other sounds of the speaker for Corr.
RANDOM_COLOUR = "#7570b3"
MIN_SOUNDS = 10  # with fewer sounds, intervals are too narrow


@dataclass(frozen=True)
class EvaluatedSound:
    """A sound: its motion files, its takes and other sounds of the speaker in the corpus, takes of another speaker, and
    a file of the sound."""

    name: str
    files: tuple[Path, ...] = ()
    takes: tuple[Clip, ...] = ()
    others: tuple[str, ...] = ()
    random: tuple[Clip, ...] = ()
    sound: Path | None = None


@dataclass(frozen=True)
class SoundObservation:
    """Statistics of one sound: of the motions, of the reference and of random motion (None if there are none), and
    notes on rejected files."""

    motions: MotionStatistics | None
    reference: MotionStatistics | None
    random: MotionStatistics | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class MotionStatistics:
    """Sums and window features of all motions of a sound, at one frame rate."""

    fps: float
    sums: Float[ndarray, " K"]
    features: Float[ndarray, "W D"]

    @classmethod
    def of(cls, motions: Sequence[Behaviour]) -> MotionStatistics | None:
        """None if there are no motions."""
        return cls(motions[0].fps, extract(motions), gather_features(motions)) if motions else None


@dataclass(frozen=True)
class BenchmarkResult:
    """The table of metrics, that of random motion, and the data that they are based on.

    Random motion is the true motion of another speaker under another sound. A metric in which it is as good as the
    reference says nothing about motion that follows its sound. Empty for other sounds, and in a corpus of one speaker.
    """

    rows: list[MetricResult]
    random: list[MetricResult]
    fps: float
    reference_fps: float
    sounds: int
    paired: bool
    notes: list[str]


def evaluate(
    motions: Path | str,
    reference: Path | str,
    out: Path | str | None = None,
    *,
    sound: Path | str | None = None,
    truth: Path | str | None = None,
    evaluators: Path | str | None = None,
    n_resamples: int = 1000,
    seed: int = 0,
    jobs: int = 1,
    force: bool = False,
) -> BenchmarkResult:
    """Compute the benchmark of the motion files in a folder against a corpus.

    `sound`: a folder of sounds named as the motion files. `truth`: a folder of motion files of the corpus's clips to
    use instead of its true motion (e.g. data/fit/motion of a tracked corpus). `evaluators`: the data folder of a
    pipeline that has run on the corpus; its critics and its encoder add Corr. and the metrics that need features.

    Raises InputError (one line) for invalid folders, files or numbers.
    """
    if n_resamples < 20 or jobs < 1 or seed < 0:
        raise InputError(
            f"n_resamples, jobs and seed: should be at least 20, 1 and 0, got {n_resamples}, {jobs}, {seed}"
        )
    output_path = None if out is None else output_folder.output_path(Path(out), OUTPUT_FILES, force)
    corpus = Corpus(Path(reference))
    if not corpus.root.is_dir():
        raise InputError(
            f"{reference}: should be a corpus, got no folder; `dvc repro synthesize` writes data/synthesize"
        )
    true = corpus.root / "truth" if truth is None else Path(truth)
    if not true.is_dir():
        raise InputError(f"{true}: should contain true motion, got none; set a folder of reference motion with --truth")
    for folder in (Path(motions), *([Path(sound)] if sound else [])):
        if not folder.is_dir():
            raise InputError(f"{folder}: should be a folder, got none")
    references = ReferencePaths(corpus.root, true, None if evaluators is None else _with_networks(Path(evaluators)))
    settings = BootstrapSettings(n_resamples=n_resamples, confidence_level=CONFIDENCE_LEVEL, seed=seed)
    found = _measured(Path(motions), references, Path(sound) if sound else None, settings, jobs)
    if output_path is not None:
        with output_folder.atomic_folder(output_path) as folder:
            _write(found, folder)
    return found


@dataclass(frozen=True)
class ReferencePaths:
    """Paths of the reference: a corpus, its true motion, and the data of a pipeline with evaluators."""

    corpus: Path
    true: Path
    evaluators: Path | None


def _with_networks(data: Path) -> Path:
    for needed in (data / "critic" / "eyes", data / "embed" / "speech"):
        if not needed.is_dir():
            raise InputError(f"{data}: should be the data folder of a finished pipeline, got none with {needed}")
    return data


def _measured(
    motions: Path, references: ReferencePaths, sound: Path | None, settings: BootstrapSettings, jobs: int
) -> BenchmarkResult:
    corpus = Corpus(references.corpus)
    matched, unmatched, notes = match_files(motion_files(motions), corpus, sound)
    paired = bool(matched)
    if paired and unmatched:
        notes.append(
            f"{len(unmatched)} of {len(unmatched) + len(matched)} names are not clips of {corpus.root} and are excluded"
        )
    work = matched or [*unmatched, *_held_out(corpus)]
    chunks = [work[start : start + CLIPS_PER_TASK] for start in range(0, len(work), CLIPS_PER_TASK)]
    seen = parallel_map(partial(_observe_all, references), chunks, jobs, "evaluate")
    ours, theirs, chance = (MotionAccumulator(f"the {name}") for name in ("motions", "reference", "random motions"))
    for one in (one for chunk in seen for one in chunk):
        notes.extend(one.notes)
        if paired and (one.motions is None or one.reference is None):
            continue
        ours.add(one.motions)
        theirs.add(one.reference)
        chance.add(one.random)
    tally, other = ours.tally(notes), theirs.tally(notes)
    if tally.clips < MIN_SOUNDS:
        notes.append(f"intervals are over sounds and too narrow for {tally.clips}; use {MIN_SOUNDS} or more")
    rows = list(Comparison(tally, other, settings, paired).rows())
    random = list(Comparison(chance.tally(notes), other, settings, paired).rows()) if chance.any else []
    return BenchmarkResult(rows, random, tally.fps, other.fps, tally.clips, paired, notes)


class MotionAccumulator:
    """Accumulated statistics of motions, which must have one frame rate."""

    def __init__(self, whose: str) -> None:
        self.whose = whose
        self._tally: Accumulator | None = None

    def add(self, one: MotionStatistics | None) -> None:
        """Add one sound, if it has any motion."""
        if one is None:
            return
        self._tally = self._tally or Accumulator(one.fps)
        if self._tally.fps != one.fps:
            raise InputError(f"{self.whose} should have one frame rate, got {self._tally.fps:g} and {one.fps:g}")
        self._tally.add(one.sums, one.features)

    @property
    def any(self) -> bool:
        """Whether there is any motion."""
        return self._tally is not None

    def tally(self, notes: Sequence[str]) -> Accumulator:
        """The accumulated statistics. Raises InputError if there are none."""
        if self._tally is None:
            raise InputError(
                f"{self.whose} should hold a usable motion, got none" + (f" ({notes[0]})" if notes else "")
            )
        return self._tally


def match_files(
    files: dict[str, list[Path]], corpus: Corpus | None, sound: Path | None
) -> tuple[list[EvaluatedSound], list[EvaluatedSound], list[str]]:
    """Files for sounds of the corpus, with their takes; other files; and notes."""
    takes: dict[str, list[Clip]] = {}
    sound_of: dict[str, str] = {}
    said_by: dict[str, dict[str, None]] = {}
    for clip in corpus.clips if corpus else ():
        takes.setdefault(clip.sound, []).append(clip)
        said_by.setdefault(clip.speaker, {})[clip.sound] = None
        sound_of |= {clip.id: clip.sound, clip.sound: clip.sound}
    of_sound: dict[str, list[Path]] = {}
    unmatched, silent = [], 0
    for name, paths in files.items():
        if name in sound_of:
            of_sound.setdefault(sound_of[name], []).extend(paths)
            continue
        observation = (
            None
            if sound is None
            else next((sound / (name + end) for end in SOUNDS if (sound / (name + end)).is_file()), None)
        )
        silent += sound is not None and observation is None
        unmatched.append(EvaluatedSound(name, tuple(paths), sound=observation))
    matched = []
    for name, paths in sorted(of_sound.items()):
        speaker = takes[name][0].speaker
        strangers = [each for other, said in said_by.items() if other != speaker for each in said]
        random = _chosen(name, strangers, 1)
        others = _chosen(name, [each for each in said_by[speaker] if each != name], SHUFFLED_SOUNDS)
        of_stranger = tuple(takes[random[0]]) if random else ()
        matched.append(EvaluatedSound(name, tuple(paths), tuple(takes[name]), others, of_stranger))
    return matched, unmatched, [f"{silent} names have no sound in {sound}"] if silent else []


def _chosen(name: str, sounds: Sequence[str], count: int) -> tuple[str, ...]:
    """A few of the sounds, chosen at random, always the same ones for a sound of this name."""
    rng = np.random.default_rng([*name.encode()])
    return tuple(sounds[index] for index in rng.permutation(len(sounds))[:count])


def _held_out(corpus: Corpus) -> list[EvaluatedSound]:
    """The reference for motions of other sounds."""
    clips = corpus.select(*HELD_OUT) or corpus.clips
    takes: dict[str, list[Clip]] = {}
    for clip in clips:
        takes.setdefault(clip.sound, []).append(clip)
    return [EvaluatedSound(name, takes=tuple(each)) for name, each in takes.items()]


def _observe_all(references: ReferencePaths, chunk: Sequence[EvaluatedSound]) -> list[SoundObservation]:
    return [_observe(references, unit) for unit in chunk]


def _observe(references: ReferencePaths, unit: EvaluatedSound) -> SoundObservation:
    corpus = Corpus(references.corpus)
    annotation = corpus.annotation(unit.takes[0]) if unit.takes else annotate_sound(unit.sound)
    notes: list[str] = []
    reference = _reference(references.true, unit.takes, annotation, notes)
    other_take = reference[0] if reference else None
    motions = list(_behaviours(unit.files, annotation, other_take, notes))
    strangers = [shard_path(references.true, clip.id, ".npz") for clip in unit.random]
    random = list(_behaviours([path for path in strangers if path.is_file()], annotation, other_take, notes))
    rates = sorted({motion.fps for motion in motions})
    if len(rates) > 1:
        raise InputError(f"the motions should have one frame rate, got {rates[0]:g} and {rates[1]:g} for {unit.name}")
    found = [MotionStatistics.of(_judged(references.evaluators, unit, each)) for each in (motions, reference, random)]
    return SoundObservation(found[0], found[1], found[2], tuple(notes))


def _judged(data: Path | None, unit: EvaluatedSound, motions: list[Behaviour]) -> list[Behaviour]:
    """Motions with features of the networks and, if the sound was embedded at the motion's frame rate, Corr."""
    if data is None or not motions:
        return motions
    evaluators = _load_evaluators(data)
    motions = add_features(motions, evaluators.encoder)
    paths = [shard_path(data / "embed" / "speech", sound, ".npy") for sound in (unit.name, *unit.others)]
    fps = read_json(data / "embed" / "embedding.json", "embedding")["fps"]
    if not paths[0].is_file() or fps != motions[0].fps:
        return motions
    speech, *others = (np.load(path) for path in paths if path.is_file())
    return with_corr(motions, evaluators.critics, speech, others)


@lru_cache(maxsize=1)
def _load_evaluators(data: Path) -> Evaluators:
    """Evaluators, loaded once per process."""
    from talkingeyes.evaluation.measures.evaluators import Evaluators

    return Evaluators.load(data / "critic")


def _reference(true: Path, takes: Sequence[Clip], annotation: Annotation | None, notes: list[str]) -> list[Behaviour]:
    """The true takes of a sound, each with another take as its reference."""
    found = [shard_path(true, clip.id, ".npz") for clip in takes]
    plain = list(_behaviours([path for path in found if path.is_file()], annotation, None, notes))
    if takes and not plain:
        notes.append(f"{takes[0].sound}: no reference motion in {true}")
    return with_references(plain)


def _behaviours(
    paths: Sequence[Path], annotation: Annotation | None, reference: Behaviour | None, notes: list[str]
) -> Iterator[Behaviour]:
    """All motions of the files; unreadable files are noted."""
    return read_noted(paths, lambda each: behaviour(each.fps, each.fields, each.valid, annotation, reference), notes)


def read_noted(paths: Iterable[Path], convert: Callable[[MotionFields], T], notes: list[str]) -> Iterator[T]:
    """What is made of each motion of the files; a file that cannot be read or converted is noted."""
    for path in paths:
        try:
            yield from map(convert, read_motions(path))
        except InputError as error:
            text = str(error)
            notes.append(text if str(path) in text else f"{path}: {text}")


def annotate_sound(sound: Path | None) -> Annotation | None:
    """Speech in a sound file, by level; None without a file."""
    if sound is None:
        return None
    from talkingeyes.audio.voice_activity import detect_speech
    from talkingeyes.audio.waveform import read_speech

    return detect_speech(read_speech(sound))


def benchmark_text(found: BenchmarkResult) -> str:
    """The table as text for a terminal, with notes."""
    whose = "the truth under the same sounds" if found.paired else "the truth under other sounds"
    head = f"{found.sounds} sounds at {found.fps:g} fps, compared with {whose}; ! marks significant differences"
    failed = [row.metric.name for row in found.random if row.worse]
    if failed:
        ours = sum(bool(row.worse) for row in found.rows if row.metric.name in failed)
        head += (
            "\nrandom is the true motion of other speakers under other sounds: it is worse in "
            f"{len(failed)} metrics (what follows the sound or the speaker; a few by chance), "
            f"the motions in {ours} of these"
        )
    more = len(found.notes) - MAX_NOTES
    notes = [*found.notes[:MAX_NOTES], *([f"and {more} more notes"] if more > 0 else [])]
    return "\n".join([as_text(found.rows, found.random), "", head, *(f"note: {note}" for note in notes)])


def _write(found: BenchmarkResult, folder: Path) -> None:
    from talkingeyes.evaluation.report.plots import plot_strips

    metadata = {
        "fps": found.fps,
        "reference_fps": found.reference_fps,
        "sounds": found.sounds,
        "same_sounds": found.paired,
        "notes": found.notes,
    }
    (folder / "benchmark.json").write_text(as_json(found.rows, metadata, found.random))
    (folder / "benchmark.csv").write_text(to_csv(found.rows, found.random))
    rows = {"motions": found.rows, **({"random": found.random} if found.random else {})}
    plot_strips(rows, {"random": RANDOM_COLOUR}, folder / "strip.png")
