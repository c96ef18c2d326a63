"""The face of a row of `evaluate`: of the true takes, the fitted ones, or the samples of a model of the face.

Compared with the true motion (in a corpus without truth: the fitted) on the vertices of the open head. The classifier
of emotions learns from true faces of the train split, anew for each row: a second or two for the default corpus.
Reads the corpus, data/fit, for a model data/sample/<model>. No command of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.evaluation.face.emotion import EmotionClassifier, features
from talkingeyes.evaluation.face.row import FaceCase, FaceFigures, cropped_faces, measure_face
from talkingeyes.evaluation.face.surface import Surface
from talkingeyes.head.anny import open_head
from talkingeyes.orchestration.run import each

# Starting a process takes as long as looking at so many faces.
FACES_WORTH_A_PROCESS = 400
REAL = ("truth", "fitted")


@dataclass(frozen=True)
class FaceSources:
    """Where the things lie; `seed` of the halves that diversity is taken of."""

    row: str
    corpus: Path
    fit: Path
    sample: Path
    seed: int


def gives_face(sample: Path) -> bool:
    """Whether what `sample` drew is faces."""
    path = next(sample.glob("*/*.npz"), None)
    if path is None:
        return False
    with np.load(path, allow_pickle=False) as file:
        return "jaw" in file.files


def shows_face(sources: FaceSources, clip: Clip) -> bool:
    """Whether motions of the corpus have faces: an expression, if only at rest."""
    return bool(Motion.load(sharded(sources.fit / "motion", clip.id, ".npz")).expression_names)


def measure_faces(sources: FaceSources, sounds: Sequence[Sequence[Clip]], jobs: int) -> list[FaceFigures]:
    """The figures of each sound, of which the fitted takes are given, the first of them take 0."""
    classifier = learn_emotions(sources, min(jobs, 1 + len(sounds) // FACES_WORTH_A_PROCESS))
    measure = partial(_measure, sources, classifier)
    return list(each(measure, list(sounds), jobs, f"evaluate {sources.row}: face"))


def learn_emotions(sources: FaceSources, jobs: int) -> EmotionClassifier | None:
    """From the train split; None where it has less than two emotions."""
    clips = Corpus(sources.corpus).select("train")
    if len({clip.emotion for clip in clips}) < 2:
        return None
    seen = list(each(partial(_features, sources), clips, jobs, "evaluate: emotions"))
    known = [(row, clip.emotion) for row, clip in zip(seen, clips, strict=True) if row is not None]
    return EmotionClassifier.learn(np.array([row for row, _ in known]), [emotion for _, emotion in known])


@cache
def _surface() -> Surface:
    """Once a process."""
    return Surface(open_head())


def _features(sources: FaceSources, clip: Clip) -> Float[ndarray, " F"] | None:
    corpus = Corpus(sources.corpus)
    path = sharded(sources.fit / "motion", clip.id, ".npz")
    if not corpus.has_truth and not path.exists():
        return None
    motion = corpus.truth(clip) if corpus.has_truth else Motion.load(path)
    return np.asarray(features(_surface(), stacked_faces([motion]))[0])


def _measure(sources: FaceSources, classifier: EmotionClassifier | None, takes: Sequence[Clip]) -> FaceFigures:
    corpus, clip = Corpus(sources.corpus), takes[0]
    fitted = [Motion.load(sharded(sources.fit / "motion", take.id, ".npz")) for take in takes]
    true = [corpus.truth(take) for take in takes] if corpus.has_truth else fitted
    truth = stacked_faces(true)
    if sources.row in REAL:
        samples = truth if sources.row == "truth" else stacked_faces(fitted)
    else:
        samples = FaceSamples.load(sharded(sources.sample, clip.id, ".npz"))
    frames = min(samples.jaw.shape[1], truth.jaw.shape[1])
    case = FaceCase(
        samples=cropped_faces(samples, frames),
        own=sources.row == "truth" or (sources.row == "fitted" and not corpus.has_truth),
        truth=cropped_faces(truth, frames),
        valid=true[0].valid[:frames],
        annotation=corpus.annotation(clip),
        sound=corpus.speech(clip),
        seed=(sources.seed, *clip.id.encode()),
    )
    return measure_face(_surface(), classifier, case)


def stacked_faces(motions: Sequence[Motion]) -> FaceSamples:
    """The faces of motions as samples, cut to the shortest."""
    frames, first = min(map(len, motions)), motions[0]
    jaw, expression = (
        np.stack([getattr(motion, name)[:frames].astype(float) for motion in motions]) for name in ("jaw", "expression")
    )
    return FaceSamples(first.fps, jaw, expression, first.expression_names, first.head_model)
