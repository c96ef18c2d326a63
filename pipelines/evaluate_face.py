"""Face metrics of a row of `evaluate`: the true takes, the fitted ones, or the samples of a face model.

Compared with the true motion (in a corpus without truth: with the fitted) on the vertices of the open head. The emotion
classifier is trained on true faces of the train split, again for each row: a second or two for the default corpus.
Reads the corpus, data/fit, for a model data/sample/<model>. Not a command.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.papers.probtalk3d_metrics import (
    EmotionClassifier,
    FaceCase,
    FaceMetrics,
    crop_faces,
    emotion_features,
    face_metrics,
)
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.run import InputPaths, parallel_map

# Starting a process takes as long as evaluating this number of faces.
FACES_PER_PROCESS = 400
REAL_ROWS = ("truth", "fitted")


def has_face_samples(sample: Path) -> bool:
    """Whether the samples of `sample` are faces."""
    path = next(sample.glob("*/*.npz"), None)
    if path is None:
        return False
    with np.load(path, allow_pickle=False) as file:
        return "jaw" in file.files


def has_face(paths: InputPaths, clip: Clip) -> bool:
    """Whether motions of the corpus have an expression, even if it is neutral."""
    return bool(Motion.load(shard_path(paths.fit / "motion", clip.id, ".npz")).expression_names)


def measure_faces(
    paths: InputPaths, sounds: Sequence[Sequence[Clip]], jobs: int, seed: int, training: InputPaths | None = None
) -> list[FaceMetrics]:
    """Metrics of each sound; `sounds` holds the fitted takes of each, take 0 first; `seed` of the halves for diversity.

    `training`: where the train split is, for a corpus without one.
    """
    classifier = train_emotion_classifier(training or paths, min(jobs, 1 + len(sounds) // FACES_PER_PROCESS))
    measure = partial(_measure, paths, classifier, seed)
    return list(parallel_map(measure, list(sounds), jobs, f"evaluate {paths.row}: face"))


def train_emotion_classifier(paths: InputPaths, jobs: int) -> EmotionClassifier | None:
    """Train the classifier on the train split; None if it has fewer than two emotions."""
    clips = Corpus(paths.corpus).select("train")
    if len({clip.emotion for clip in clips}) < 2:
        return None
    seen = list(parallel_map(partial(_features, paths), clips, jobs, "evaluate: emotions"))
    known = [(row, clip.emotion) for row, clip in zip(seen, clips, strict=True) if row is not None]
    return EmotionClassifier.fit(np.array([row for row, _ in known]), [emotion for _, emotion in known])


@cache
def _surface() -> FaceSurface:
    """The face surface, created once per process."""
    return FaceSurface(anny_head())


def _features(paths: InputPaths, clip: Clip) -> Float[ndarray, " F"] | None:
    corpus = Corpus(paths.corpus)
    path = shard_path(paths.fit / "motion", clip.id, ".npz")
    if not corpus.has_truth and not path.exists():
        return None
    motion = corpus.truth(clip) if corpus.has_truth else Motion.load(path)
    return np.asarray(emotion_features(_surface(), stack_faces([motion]))[0])


def _measure(paths: InputPaths, classifier: EmotionClassifier | None, seed: int, takes: Sequence[Clip]) -> FaceMetrics:
    corpus, clip = Corpus(paths.corpus), takes[0]
    fitted = [Motion.load(shard_path(paths.fit / "motion", take.id, ".npz")) for take in takes]
    true = [corpus.truth(take) for take in takes] if corpus.has_truth else fitted
    truth = stack_faces(true)
    if paths.row in REAL_ROWS:
        samples = truth if paths.row == "truth" else stack_faces(fitted)
    else:
        samples = FaceSamples.load(shard_path(paths.sample, clip.id, ".npz"))
    frames = min(samples.jaw.shape[1], truth.jaw.shape[1])
    case = FaceCase(
        samples=crop_faces(samples, frames),
        includes_reference=paths.row == "truth" or (paths.row == "fitted" and not corpus.has_truth),
        truth=crop_faces(truth, frames),
        valid=true[0].valid[:frames],
        annotation=corpus.annotation(clip),
        sound=corpus.speech(clip),
        seed=(seed, *clip.id.encode()),
    )
    return face_metrics(_surface(), classifier, case)


def stack_faces(motions: Sequence[Motion]) -> FaceSamples:
    """The faces of motions as samples, cut to the shortest."""
    frames, first = min(map(len, motions)), motions[0]
    jaw, expression = (
        np.stack([getattr(motion, name)[:frames].astype(float) for motion in motions]) for name in ("jaw", "expression")
    )
    return FaceSamples(first.fps, jaw, expression, first.expression_names, first.head_model)
