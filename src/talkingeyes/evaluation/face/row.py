"""The face's part of a row: the figures of one sound, and of all sounds with intervals over them.

Compared with the true motion (in a corpus without truth: the fitted). MVE and LVE average over frames, the others over
sounds, as in ProbTalk3D's text. The mean face wins MVE and every multi-sample error, a shut mouth closes on every
bilabial: read a row beside truth, fitted and baselines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, mean_of, ratio_of
from talkingeyes.evaluation.face.emotion import EmotionClassifier, features, recognised
from talkingeyes.evaluation.face.surface import Surface
from talkingeyes.evaluation.face.talking import Talking, talking
from talkingeyes.evaluation.face.vertices import VertexErrors, halves_diversity, vertex_errors
from talkingeyes.evaluation.seeds import Measured, SeededEstimate, mean_of_known, seeded

OVER_FRAMES = ("mve", "lve", "lve_squared")


@dataclass(frozen=True)
class FaceCase:
    """One sound. `own`: the samples are real motions of this very sound, the first of them what is compared with."""

    samples: FaceSamples
    own: bool
    truth: FaceSamples  # all takes
    valid: Bool[ndarray, " T"]
    annotation: Annotation
    sound: Float[ndarray, " N"]
    seed: tuple[int, ...]  # of the halves


@dataclass(frozen=True)
class FaceFigures:
    """One sound; `errors` is None where there is no second motion to compare with. NaN where a figure is undefined."""

    errors: VertexErrors | None
    talking: Talking
    diversity: float
    diversity_truth: float
    emotion: str
    hits: float  # share of the samples whose emotion was told; NaN where nobody can


def measure_face(surface: Surface, classifier: EmotionClassifier | None, case: FaceCase) -> FaceFigures:
    """The figures of one sound."""
    compared = range(int(case.own), len(case.samples.jaw))
    told = classifier.tell(features(surface, case.samples)) if classifier else []
    own = halves_diversity(surface, case.samples, np.random.default_rng(case.seed))
    return FaceFigures(
        errors=vertex_errors(surface, case.truth, case.samples, compared, case.valid) if compared else None,
        talking=talking(surface, case.samples, case.annotation, case.sound),
        diversity=own,
        diversity_truth=halves_diversity(surface, case.truth, np.random.default_rng(case.seed)),
        emotion=case.annotation.emotion,
        hits=float(np.mean([each == case.annotation.emotion for each in told])) if told else float("nan"),
    )


def cropped_faces(faces: FaceSamples, frames: int) -> FaceSamples:
    """The first frames."""
    jaw, expression = faces.jaw[:, :frames], faces.expression[:, :frames]
    return FaceSamples(faces.fps, jaw, expression, faces.expression_names, faces.head_model)


def summarise_face(sounds: Sequence[FaceFigures], settings: BootstrapSettings) -> dict[str, Estimate]:
    """All figures over sounds; one that no sound allows is left out. `diversity_ratio`: to that of the true takes."""
    found = _statistics(sounds)
    return {name: bootstrap(each, each.count, settings) for name, each in found.items()}


def summarise_seeds(seeds: Sequence[Sequence[FaceFigures]], settings: BootstrapSettings) -> dict[str, SeededEstimate]:
    """The same sounds under several seeds: the mean of all, its interval over sounds, and the range over seeds."""
    found = seeded([_statistics(each) for each in seeds])
    return {name: each.estimate(settings) for name, each in found.items()}


def _statistics(sounds: Sequence[FaceFigures]) -> dict[str, Measured]:
    """Every figure that some sound allows."""
    errors = [each.errors for each in sounds if each.errors is not None]
    frames = np.array([each.frames for each in errors], float)
    found: dict[str, Measured] = {}
    for name in (field.name for field in fields(VertexErrors) if field.name != "frames"):
        values = np.array([getattr(each, name) for each in errors])
        found[name] = Measured(
            ratio_of(values * frames, frames) if name in OVER_FRAMES else mean_of(values), len(values)
        )
    for name in (field.name for field in fields(Talking)):
        found[name] = mean_of_known(np.array([getattr(each.talking, name) for each in sounds]))
    own, truth = (np.array([getattr(each, name) for each in sounds]) for name in ("diversity", "diversity_truth"))
    several = ~np.isnan(own + truth)
    found["diversity"] = mean_of_known(own)
    if truth[several].all():
        found["diversity_ratio"] = Measured(ratio_of(own[several], truth[several]), int(several.sum()))
    known = [each for each in sounds if not np.isnan(each.hits)]
    hits, emotions = np.array([each.hits for each in known]), np.array([each.emotion for each in known])
    found["emotion_recognised"] = Measured(lambda drawn: recognised(hits[drawn], emotions[drawn]), len(known))
    return {name: each for name, each in found.items() if each.count}
