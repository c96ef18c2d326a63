"""Stage `validate`: the metrics on val by which models and settings are selected (test and unseen are for `evaluate`).

Run: python -m pipelines.validate talkingeyes

Rows: a model, and what its figures are read beside: `truth` (another true take of the sound than the one that all are
compared with: how near two true motions are), `fitted` and `mismatched` (fitted motion of other sounds of the speaker).

Reads: the corpus index and truth, data/fit, data/embed, data/critic, data/train/<model>.

Writes: data/validate/<row>/metrics.json {metric: value}: Corr. of the samples of each part, and of the fitted motion
for comparison; distances of the distributions of eye speed and saccade amplitude from those of the truth (in a corpus
without truth: of the fitted motion), and their mean, `dynamics_distance`; the same for eccentricity of gaze,
`eccentricity_distance`; `metrics_worse`, the number of learnt metrics of the gaze benchmark by which the samples are
significantly worse than the truth, out of `metrics_comparable`; `tie` and `tie_fitted`, Corr. less that under other
sounds of the speaker; ratios of speed to the truth's; `diversity`, and its ratio to that of the true takes, where
sounds have several;
`motion_distance`, the mean absolute logarithm of the ratios of Diversity, eye speed, rest and head speed; of a network
with a likelihood, that of fitted motion, `log_likelihood`, in nats per second; nothing for a row without motion
(`truth` where no sound of val has two takes, `mismatched` where no speaker has two sounds). benchmark.json: the
benchmark itself.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.recordings import Recording, Recordings
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.sound_groups import SoundGroup, group_sounds
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.paired import (
    BenchmarkTable,
    PairedAccumulator,
    SoundStatistics,
    motion_behaviours,
    pair_with_truth,
    sample_behaviours,
    sound_statistics,
)
from talkingeyes.evaluation.measures.corr import CRITICS, SHUFFLED_SOUNDS, CorrScores, corr_scores
from talkingeyes.evaluation.measures.evaluators import Evaluators
from talkingeyes.evaluation.papers.talkingeyes_metrics import diversity
from talkingeyes.evaluation.report.information import mean_log_likelihood
from talkingeyes.evaluation.report.validation_metrics import (
    DynamicsDistances,
    MotionDynamics,
    ValidateSettings,
    dynamics_distances,
    motion_distance,
    speed_margins,
)
from talkingeyes.orchestration.run import InputPaths, Report, Workspace, main, parallel_map
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.motion_generators import (
    NetworkGenerator,
    Speech,
    TrainedGenerator,
    load_generator,
    required_inputs,
    training_speakers,
)

BATCH_SOUNDS = 16
REFERENCES = ("truth", "fitted", "mismatched")


@dataclass(frozen=True)
class RowMotions:
    """The motions of a row for one sound, its fitted motion, and other sounds of the speaker.

    `log_likelihood`: of the fitted motion in nats, by term; empty without one.
    """

    fitted: Recording
    motions: Samples
    others: Sequence[Recording]
    log_likelihood: dict[str, float]


@dataclass(frozen=True)
class SoundValidation:
    """Results of one sound: Corr. by critic, Diversity, dynamics, statistics of the benchmark."""

    scores: dict[str, CorrScores]
    fitted_scores: dict[str, CorrScores]
    diversity: float
    head_diversity: float
    true_diversity: float
    sampled: MotionDynamics
    truth: MotionDynamics
    fitted: MotionDynamics
    benchmark: SoundStatistics
    seconds: float
    log_likelihood: dict[str, float]


def run(workspace: Workspace, name: str) -> Report:
    """Validate in parallel over clips; each clip has its own seeds."""
    settings = workspace.settings("validate", ValidateSettings)
    paths = workspace.input_paths(name)
    with workspace.output("validate", name) as folder:
        work, benchmark = _sounds(paths, settings), PairedAccumulator()
        batches = [work[first : first + BATCH_SOUNDS] for first in range(0, len(work), BATCH_SOUNDS)]
        task = partial(validate_sounds, paths, settings)
        found = [one for batch in parallel_map(task, batches, workspace.jobs, f"validate {name}") for one in batch]
        for one in found:
            benchmark.add(one.benchmark)
        table = benchmark.table(settings.bootstrap)
        figures = _figures(found, table) if found else {}
        (folder / "metrics.json").write_text(json.dumps(figures, indent=1))
        (folder / "benchmark.json").write_text(table.json())
    return Report(metrics=figures, artifacts=[workspace.data("validate", name, "metrics.json")])


def _figures(found: Sequence[SoundValidation], table: BenchmarkTable) -> dict[str, float]:
    sampled, truth, fitted = (
        MotionDynamics.pooled([getattr(clip, name) for clip in found]) for name in ("sampled", "truth", "fitted")
    )
    diversities, margins = _diversities(found), speed_margins(sampled, truth, fitted)
    ratios = [margins[name] for name in ("eye_speed_ratio", "rest_ratio_truth", "head_speed_ratio")]
    if "diversity_ratio" in diversities:
        margins["motion_distance"] = motion_distance([diversities["diversity_ratio"], *ratios])
    return {
        **_corr([clip.scores for clip in found], ""),
        **_corr([clip.fitted_scores for clip in found], "_fitted"),
        **diversities,
        **margins,
        **_named(dynamics_distances(sampled, truth)),
        **mean_log_likelihood([clip.log_likelihood for clip in found], [clip.seconds for clip in found]),
        "metrics_worse": float(table.learnt.worse),
        "metrics_comparable": float(table.learnt.compared),
    }


def _sounds(paths: InputPaths, settings: ValidateSettings) -> list[SoundGroup]:
    """The sounds of val whose first take was fitted. Mismatched motion needs other sounds besides those that belong to
    it."""
    corpus = Corpus(paths.corpus)
    others = 2 * SHUFFLED_SOUNDS if paths.row == "mismatched" else SHUFFLED_SOUNDS
    found = group_sounds(corpus, paths.fit, paths.embed, ("val",), others, settings.seed)
    if not found:
        raise InputError(f"{corpus.root}: should contain a fitted clip in val, got none")
    return found


def validate_sounds(
    paths: InputPaths, settings: ValidateSettings, sounds: Sequence[SoundGroup]
) -> list[SoundValidation]:
    """Measure the motions of a row for some sounds; a model samples them in one batch."""
    clips = [Recordings([each.clip, *each.others], paths.fit, paths.embed)[:] for each in sounds]
    if paths.row in REFERENCES:
        pairs = [
            (sound, _reference(paths, sound, own, others)) for sound, (own, *others) in zip(sounds, clips, strict=True)
        ]
        return [measure_sound(paths, sound, motions) for sound, motions in pairs if motions is not None]
    generator, provider = _generator(paths.model), _conditioning_provider(paths)
    speeches = []
    for fitted, *_ in clips:
        clip = fitted.clip
        seeds = np.random.default_rng([settings.seed, *clip.id.encode()]).integers(2**31, size=settings.samples)
        conditioning = provider.clip_inputs(clip, len(fitted))
        speeches.append(Speech(np.array(fitted.speech), seeds.tolist(), clip.fps, conditioning))
    found = []
    for sound, given, sampled, (fitted, *others) in zip(
        sounds, speeches, generator.generate_batch(speeches), clips, strict=True
    ):
        likelihood = (
            generator.log_likelihood(given.embedding, fitted.head, fitted.gaze, given.conditioning)
            if isinstance(generator, NetworkGenerator)
            else {}
        )
        found.append(measure_sound(paths, sound, RowMotions(fitted, sampled, others, likelihood)))
    return found


def _reference(
    paths: InputPaths, sound: SoundGroup, fitted: Recording, others: Sequence[Recording]
) -> RowMotions | None:
    """The motions of a row that is no model; None for a sound without any."""
    motions: Sequence[Motion | Recording] = [fitted]
    if paths.row == "truth":
        motions = true_takes(paths, sound)[1:]
    elif paths.row == "mismatched":
        motions, others = others[:SHUFFLED_SOUNDS], others[SHUFFLED_SOUNDS:]
    return RowMotions(fitted, Samples.of(fitted.clip.fps, motions), others, {}) if motions else None


def measure_sound(paths: InputPaths, sound: SoundGroup, row: RowMotions) -> SoundValidation:
    """Measure the motions of a row for one sound."""
    corpus, clip, fitted = Corpus(paths.corpus), sound.clip, row.fitted
    frames = min(len(fitted), row.motions.head.shape[1])
    motions, own = row.motions.cropped(frames), Samples.of(clip.fps, [fitted]).cropped(frames)
    speech, evaluators = np.array(fitted.speech[:frames]), _load_evaluators(paths.critic)
    under = [np.array(other.speech) for other in row.others]
    scores = corr_scores(evaluators.critics, speech, under, motions.head, motions.gaze)
    takes = true_takes(paths, sound)
    true = takes[:1]
    annotation = corpus.annotation(clip)
    motion_sets = pair_with_truth(sample_behaviours(motions, annotation), motion_behaviours(true, annotation))
    return SoundValidation(
        scores,
        corr_scores(evaluators.critics, speech, under, own.head, own.gaze),
        _gaze_diversity(motions),
        diversity(motions.head),
        _gaze_diversity(Samples.of(clip.fps, takes).cropped(frames)),
        MotionDynamics.of(motions),
        MotionDynamics.of(Samples.of(clip.fps, true) if corpus.has_truth else own),
        MotionDynamics.of(own),
        sound_statistics(motion_sets, scores, evaluators.critics, evaluators.encoder, speech, under),
        len(fitted) / clip.fps,
        row.log_likelihood,
    )


def _gaze_diversity(motions: Samples) -> float:
    return diversity(motions.gaze.reshape(*motions.gaze.shape[:2], -1))


def true_takes(paths: InputPaths, sound: SoundGroup) -> list[Motion]:
    """True motions of all takes; in a corpus without truth, the fitted ones."""
    corpus = Corpus(paths.corpus)
    if corpus.has_truth:
        return [corpus.truth(take) for take in sound.takes]
    return [Motion.load(shard_path(paths.fit / "motion", take.id, ".npz")) for take in sound.takes]


@lru_cache(maxsize=1)
def _generator(folder: Path) -> TrainedGenerator:
    """The generator, loaded once per process."""
    return load_generator(folder)


@lru_cache(maxsize=1)
def _conditioning_provider(paths: InputPaths) -> ConditioningProvider:
    """The provider of the model's conditioning inputs."""
    generator, corpus = _generator(paths.model), Corpus(paths.corpus)
    conditioning_paths = ConditioningPaths(corpus, paths.embed)
    return ConditioningProvider(required_inputs(generator), training_speakers(generator), conditioning_paths)


@lru_cache(maxsize=1)
def _load_evaluators(folder: Path) -> Evaluators:
    """Evaluators, loaded once per process."""
    return Evaluators.load(folder)


def _corr(found: Sequence[dict[str, CorrScores]], of: str) -> dict[str, float]:
    """Corr. of each part under its own sound, and less that under other sounds of the speaker."""
    metrics: dict[str, float] = {}
    for part, critic in CRITICS.items():
        own, others = (
            _mean([float(getattr(scores[critic], name).mean()) for scores in found]) for name in ("matched", "others")
        )
        metrics |= {_name(f"corr{of}", part): own, _name(f"tie{of}", part): own - others}
    return metrics


def _diversities(found: Sequence[SoundValidation]) -> dict[str, float]:
    """Mean Diversity of eyes and head, and of the eyes over that of true takes; none of a row with one motion a
    sound."""
    with_takes = [clip for clip in found if not np.isnan(clip.true_diversity)]
    ratio = [sum(getattr(clip, name) for clip in with_takes) for name in ("diversity", "true_diversity")]
    values = {
        "diversity": _mean([clip.diversity for clip in found]),
        "diversity_head": _mean([clip.head_diversity for clip in found]),
        "diversity_ratio": ratio[0] / ratio[1] if with_takes else float("nan"),
    }
    return {name: value for name, value in values.items() if not np.isnan(value)}


def _name(figure: str, part: str) -> str:
    """Corr. of the eyes in the head is the paper's, and has the plain name."""
    return figure if part == "gaze" else f"{figure}_{part}"


def _named(found: DynamicsDistances) -> dict[str, float]:
    return {
        "dynamics_distance": found.mean,
        "eye_speed_distance": found.eye_speed,
        "saccade_amplitude_distance": found.saccade_amplitude,
        "eccentricity_distance": found.eccentricity,
    }


def _mean(values: list[float]) -> float:
    return float(np.mean(values))


if __name__ == "__main__":
    main(run)
