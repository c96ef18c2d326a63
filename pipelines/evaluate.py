"""Stage `evaluate`: the metrics of one row of Table III, on sounds that no model was trained or selected on.

Run: python -m pipelines.evaluate talkingeyes

Rows: `truth` (the true motion; its takes are its samples), `fitted` (the training targets, an upper bound),
`mismatched` (fitted motion of other sounds of the speaker), or a model. A face model has only the part `face`; truth
and fitted have it besides the others (`evaluate_face`).

Reads: the corpus, data/fit, data/embed, data/critic, for a model data/sample/<model>.

Writes: data/evaluate/<row>/metrics.json {split: {part: {metric: {value, low, high, speakers_low, speakers_high}}}}, the
intervals over sounds and over speakers (those of the face over sounds alone); speed.csv (fraction of frames that are
faster); on both splits together aversion.json: what speech tells about gaze aversion, and the row's motion about the
true one; emotion.json, in a corpus with emotions: how often that of the sound is recognised from head and gaze;
benchmark.json: the gaze benchmark, compared with all takes of the truth (in a corpus without truth: with the
fitted motion). A corpus without truth has an empty row `truth`.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.evaluate_face import REAL_ROWS, has_face, has_face_samples, measure_faces
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.fitted_clips import motion_path
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.sound_groups import SoundGroup, group_sounds
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.paired import (
    MotionSets,
    PairedAccumulator,
    SoundStatistics,
    motion_behaviours,
    pair_with_truth,
    sample_behaviours,
    sound_statistics,
)
from talkingeyes.evaluation.bootstrap import Estimate
from talkingeyes.evaluation.detectors.behaviour import with_references
from talkingeyes.evaluation.measures.corr import CRITICS, SHUFFLED_SOUNDS, CorrScores, corr_scores
from talkingeyes.evaluation.measures.evaluators import Evaluators
from talkingeyes.evaluation.papers.probtalk3d_metrics import EmotionClassifier, summarise_face
from talkingeyes.evaluation.papers.talkingeyes_metrics import (
    ClipMetrics,
    EvaluateSettings,
    EvaluationCase,
    clip_metrics,
    summarise,
)
from talkingeyes.evaluation.report.emotion import (
    EMOTION_FILE,
    EmotionalSound,
    emotion_recognised,
    head_gaze_features,
)
from talkingeyes.evaluation.report.information import (
    LIVE_LOOKAHEAD_S,
    SoundAversion,
    aversion_information,
    aversion_prediction,
    changes_per_s,
    shift_in_time,
    sound_aversion,
)
from talkingeyes.orchestration.run import InputPaths, Report, Workspace, main, parallel_map

SPLITS = ("test", "unseen")
# Speeds at which the distribution is written.
SPEEDS_DEG_S = np.geomspace(0.1, 1000, 81)
# Sounds of the train split that hazards of real gaze are fitted to: seven hours.
MAX_TRAINING_SOUNDS = 3000
# Starting a process takes as long as evaluating about twenty sounds.
SOUNDS_PER_PROCESS = 40


@dataclass(frozen=True)
class SoundResult:
    """Results of a sound: metrics by part, statistics for the benchmark, when gaze is averted (`reference`: that of the
    truth), and what its emotion is recognised from."""

    figures: dict[str, ClipMetrics]
    benchmark: SoundStatistics
    aversion: SoundAversion
    reference: SoundAversion
    emotion: EmotionalSound


def run(workspace: Workspace, name: str, training: Workspace | None = None) -> Report:
    """Evaluate in parallel over sounds, which are independent.

    `training`: where the train split is, for a corpus without one.
    """
    settings = workspace.settings("evaluate", EvaluateSettings)
    paths = workspace.input_paths(name)
    found: dict[str, dict[str, list[ClipMetrics]]] = {split: {part: [] for part in CRITICS} for split in SPLITS}
    work = held_out_sounds(paths, settings)
    of_face = has_face_samples(paths.sample)
    eyes = [] if of_face else work
    evaluators = Evaluators.load(paths.critic) if eyes else None
    jobs = min(workspace.jobs, 1 + len(work) // SOUNDS_PER_PROCESS)
    task = partial(evaluate, paths, evaluators, settings.benchmark_samples)
    measured = parallel_map(task, eyes, jobs, f"evaluate {name}")
    benchmark, aversions, references = PairedAccumulator(), list[SoundAversion](), list[SoundAversion]()
    emotions: list[EmotionalSound] = []
    for item, one in zip(eyes, measured, strict=True):
        if one is None:
            continue
        benchmark.add(one.benchmark)
        aversions.append(one.aversion)
        references.append(one.reference)
        emotions.append(one.emotion)
        for part, of_part in one.figures.items():
            found[item.takes[0].split][part].append(of_part)
    figures: dict[str, dict[str, Mapping[str, Estimate]]] = {
        split: {part: summarise(part, clips, settings.bootstrap) for part, clips in parts.items() if clips}
        for split, parts in found.items()
    }
    if of_face or name in REAL_ROWS:
        for split, of_split in _faces(paths, work, settings, jobs).items():
            figures[split]["face"] = of_split
    with workspace.output("evaluate", name) as folder:
        (folder / "metrics.json").write_text(json.dumps(_plain(figures), indent=1))
        (folder / "benchmark.json").write_text(benchmark.table(settings.bootstrap).json())
        if aversions:
            of_aversion = _aversion(training or workspace, name, aversions, references, settings)
            (folder / "aversion.json").write_text(json.dumps(of_aversion, indent=1))
            if of_emotion := _emotion(paths.critic, emotions, settings):
                (folder / "emotion.json").write_text(json.dumps(of_emotion, indent=1))
        _write_speeds(folder / "speed.csv", found)
    return Report(metrics=_flat(figures), artifacts=[workspace.data("evaluate", name, "metrics.json")])


def _aversion(
    training: Workspace,
    row: str,
    sounds: Sequence[SoundAversion],
    references: Sequence[SoundAversion],
    settings: EvaluateSettings,
) -> dict[str, Any]:
    """Information of speech about gaze aversion, and what a model's motions tell about that of the reference. Real
    motion has a take for most sounds, too few to fit the regression, which is fitted to that of the train split too;
    its row has the most that a live model can follow besides."""
    further: list[SoundAversion] = []
    if row in REAL_ROWS:
        corpus, fit = Corpus(training.corpus), training.data("fit")
        clips = [each for each in corpus.select("train", take=0) if motion_path(fit, each).exists()]
        measure = partial(_real_aversion, row, corpus.root, fit)
        further = list(parallel_map(measure, clips[:MAX_TRAINING_SOUNDS], training.jobs, f"aversion {row}"))
    bounds_s = {"information": np.inf} | ({"live_information": LIVE_LOOKAHEAD_S} if further else {})
    found = {
        name: aversion_information(sounds, settings.bootstrap, further, ahead_s) for name, ahead_s in bounds_s.items()
    }
    shifted = [shift_in_time(each, settings.seed) for each in (sounds, further)]
    found["shifted_information"] = aversion_information(shifted[0], settings.bootstrap, shifted[1])
    if row not in REAL_ROWS:
        found["prediction"] = aversion_prediction(sounds, references, settings.bootstrap)
    return {name: asdict(each) for name, each in found.items()} | {"changes_per_s": changes_per_s(sounds)}


def _real_aversion(row: str, root: Path, fit: Path, clip: Clip) -> SoundAversion:
    corpus = Corpus(root)
    motion = corpus.truth(clip) if row == "truth" else Motion.load(motion_path(fit, clip))
    return sound_aversion(clip.speaker, motion_behaviours([motion], corpus.annotation(clip)))


def _emotion(critic: Path, sounds: Sequence[EmotionalSound], settings: EvaluateSettings) -> dict[str, Any]:
    """How often the emotion is recognised, and chance; empty if the critics' corpus has fewer than two emotions."""
    if not (critic / EMOTION_FILE).exists():
        return {}
    classifier = EmotionClassifier.load(critic / EMOTION_FILE)
    chance = 1 / len({each.emotion for each in sounds})
    return {"recognised": asdict(emotion_recognised(classifier, sounds, settings.bootstrap)), "chance": chance}


def _faces(
    paths: InputPaths, work: Sequence[SoundGroup], settings: EvaluateSettings, jobs: int
) -> dict[str, dict[str, Estimate]]:
    """Metrics of the face, by split; empty if motions have no face."""
    if not work or not has_face(paths, work[0].takes[0]):
        return {}
    measured = measure_faces(paths, [item.takes for item in work], jobs, settings.seed)
    pairs = list(zip(work, measured, strict=True))
    by_split = {split: [one for item, one in pairs if item.takes[0].split == split] for split in SPLITS}
    return {split: summarise_face(ones, settings.bootstrap) for split, ones in by_split.items() if ones}


def held_out_sounds(paths: InputPaths, settings: EvaluateSettings) -> list[SoundGroup]:
    """The sounds of test and unseen whose first take was fitted."""
    corpus = Corpus(paths.corpus)
    if paths.row == "truth" and not corpus.has_truth:
        return []
    found = group_sounds(corpus, paths.fit, paths.embed, SPLITS, settings.mismatched_samples, settings.seed)
    if not found:
        raise InputError(f"{corpus.root}: should contain a fitted clip in {' or '.join(SPLITS)}, got none")
    return found


@dataclass(frozen=True)
class EvaluatedSound:
    """One sound of a row: the compared motions, the scores of the critics, and its metrics by part."""

    case: EvaluationCase
    samples: Samples  # uncropped
    true: list[Motion] | None
    speech: Float[ndarray, "T C"]
    others: list[np.ndarray]
    scores: dict[str, CorrScores]
    figures: dict[str, ClipMetrics]


def evaluate_sound(paths: InputPaths, evaluators: Evaluators, item: SoundGroup) -> EvaluatedSound | None:
    """Evaluate one sound; None if the row has no motion for it (a speaker with one sound has no mismatch)."""
    corpus, clip = Corpus(paths.corpus), item.takes[0]
    takes = Recordings(item.takes, paths.fit, paths.embed)[:]
    fitted = Samples.of(clip.fps, takes)
    true = [corpus.truth(take) for take in item.takes] if corpus.has_truth else None
    truth = Samples.of(clip.fps, true) if true else None
    samples = _samples(paths, item, fitted, truth)
    if samples is None:
        return None
    frames = min(len(takes[0]), *(each.head.shape[1] for each in (samples, fitted, truth or fitted)))
    speech, others = np.array(takes[0].speech[:frames]), _other_sounds(paths, item)
    case = EvaluationCase(
        speaker=clip.speaker,
        samples=samples.cropped(frames),
        includes_reference=paths.row in ("truth", "fitted"),
        fitted=fitted.cropped(frames),
        truth=truth.cropped(frames) if truth else None,
        valid=takes[0].valid[:frames],
    )
    scores, fitted_corr_scores = (
        corr_scores(evaluators.critics, speech, sounds, each.head, each.gaze)
        for each, sounds in ((case.samples, others), (case.fitted, ()))
    )
    return EvaluatedSound(case, samples, true, speech, others, scores, clip_metrics(case, scores, fitted_corr_scores))


def evaluate(
    paths: InputPaths, evaluators: Evaluators | None, benchmark_samples: int, item: SoundGroup
) -> SoundResult | None:
    """Metrics of one sound and its benchmark statistics; None if the row has no motion for it."""
    assert evaluators is not None
    seen = evaluate_sound(paths, evaluators, item)
    if seen is None:
        return None
    motion_sets = _compared(paths, item, seen.samples, seen.true, benchmark_samples)
    counts = sound_statistics(
        motion_sets, seen.scores, evaluators.critics, evaluators.encoder, seen.speech, seen.others
    )
    row, reference = (
        sound_aversion(item.clip.speaker, each) for each in (motion_sets.evaluated, motion_sets.reference)
    )
    emotion = EmotionalSound(item.clip.speaker, item.clip.emotion, head_gaze_features(seen.case.samples))
    return SoundResult(seen.figures, counts, row, reference, emotion)


def _compared(
    paths: InputPaths, item: SoundGroup, samples: Samples, true: list[Motion] | None, count: int
) -> MotionSets:
    annotation = Corpus(paths.corpus).annotation(item.clip)
    of_truth = motion_behaviours(true or (), annotation)
    if of_truth and paths.row == "truth":
        both = with_references(of_truth)
        return MotionSets(both, both)
    fits = []
    if paths.row == "fitted" or not of_truth:
        fits = motion_behaviours(
            [Motion.load(shard_path(paths.fit / "motion", take.id, ".npz")) for take in item.takes], annotation
        )
    first_samples = Samples(samples.fps, samples.head[:count], samples.gaze[:count])
    return pair_with_truth(
        fits if paths.row == "fitted" else sample_behaviours(first_samples, annotation), of_truth or fits
    )


def _other_sounds(paths: InputPaths, item: SoundGroup) -> list[np.ndarray]:
    """Embeddings of a few other sounds of the speaker; none for mismatched motion, which may belong to them."""
    others = [] if paths.row == "mismatched" else item.others[:SHUFFLED_SOUNDS]
    return [np.array(each.speech) for each in Recordings(others, paths.fit, paths.embed)]


def _samples(paths: InputPaths, item: SoundGroup, fitted: Samples, truth: Samples | None) -> Samples | None:
    if paths.row == "truth":
        return truth
    if paths.row == "fitted":
        return fitted
    if paths.row == "mismatched":
        others = Recordings(item.others, paths.fit, paths.embed)[:]
        return Samples.of(item.takes[0].fps, others) if others else None
    return Samples.load(shard_path(paths.sample, item.takes[0].id, ".npz"))


def _plain(table: Mapping[str, Mapping[str, Mapping[str, Estimate]]]) -> Any:
    return {
        split: {part: {name: asdict(each) for name, each in figures.items()} for part, figures in parts.items()}
        for split, parts in table.items()
    }


def _flat(table: Mapping[str, Mapping[str, Mapping[str, Estimate]]]) -> dict[str, float]:
    return {
        f"{split}/{part}/{name}": estimate.value
        for split, parts in table.items()
        for part, figures in parts.items()
        for name, estimate in figures.items()
    }


def _write_speeds(path: Path, found: dict[str, dict[str, list[ClipMetrics]]]) -> None:
    """Write the fraction of frames faster than each of SPEEDS_DEG_S, over both splits."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["part", "speed_deg_s", "share_faster"])
        for part in CRITICS:
            speeds = [clip.speed for split in SPLITS for clip in found[split][part]]
            ordered = np.sort(np.concatenate(speeds)) if speeds else np.zeros(0)
            for speed in SPEEDS_DEG_S if len(ordered) else ():
                share = 1 - np.searchsorted(ordered, speed, side="right") / len(ordered)
                writer.writerow([part, f"{speed:.4g}", f"{share:.6g}"])


if __name__ == "__main__":
    main(run)
