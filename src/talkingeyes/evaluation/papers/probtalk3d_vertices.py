"""Vertex errors and diversity of a talking face: MVE, LVE, FDD, MEE, CE, Diversity (ProbTalk3D, eq. 6 to 10).

With d a displacement in millimetres, x the truth and y_s one of S samples:
    mve              mean over frames and vertices of |x - y_1|                                   (eq. 6)
    lve              mean over frames of the maximum of |x - y_1| over the lips, mm               (eq. 7)
    lve_squared      the same of |x - y_1|^2, mm2, as reported by CodeTalker, FaceDiffuser and ProbTalk3D's code
    fdd_signed       f(x) - f(y_1), mm2, f the mean over the upper face of the SD over time of |d|^2, as in their code:
                     above 0 if the truth moves more; clips of opposite sign cancel out
    fdd_absolute     |f(x) - f(y_1)| of each clip
    mee              lve of the mean of all samples (eq. 8); also squared
    ce               the smallest lve of the samples of a clip (eq. 9); also squared
    diversity        mean of |y_s - y_s'| over pairs from two random halves of the samples, frames, vertices (eq. 10)
Eq. 6 and 10 leave open whether the norm is over a vertex or a whole frame; the published code uses the vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface, frame_blocks


@dataclass(frozen=True)
class VertexErrors:
    """Errors of one clip, as means over its valid frames, and their number. In mm; squared errors and FDD in mm2."""

    frames: int
    mve: float
    lve: float
    lve_squared: float
    mee: float
    mee_squared: float
    ce: float
    ce_squared: float
    fdd_signed: float
    fdd_absolute: float


def vertex_errors(
    surface: FaceSurface, truth: FaceSamples, samples: FaceSamples, compared: Sequence[int], valid: Bool[ndarray, " T"]
) -> VertexErrors:
    """Errors of the `compared` samples against the first true take; MVE, LVE and FDD use the first of them."""
    first = compared[0]
    whole = _Mean()
    lips, squared = _Mean(), _Mean()
    mean_lips, mean_squared = _Mean(), _Mean()
    of_truth, of_sample = DynamicsAccumulator(), DynamicsAccumulator()
    for frames in frame_blocks(len(valid)):
        seen = valid[frames]
        true = surface.displacement_mm(truth, 0, frames, "face")[seen]
        shown = surface.displacement_mm(samples, first, frames, "face")[seen]
        whole.add(vertex_error(true, shown))
        upper = surface.upper_face_index
        of_truth.add(true[:, upper])
        of_sample.add(shown[:, upper])
        true_lips = surface.displacement_mm(truth, 0, frames, "lips")[seen]
        all_lips = np.stack([surface.displacement_mm(samples, s, frames, "lips")[seen] for s in compared])
        errors = lip_error(true_lips, all_lips)
        of_mean = lip_error(true_lips, all_lips.mean(axis=0))
        lips.add(errors)
        squared.add(np.square(errors))
        mean_lips.add(of_mean)
        mean_squared.add(np.square(of_mean))
    dynamics = of_truth.deviation() - of_sample.deviation()
    return VertexErrors(
        frames=int(valid.sum()),
        mve=float(whole.value),
        lve=float(lips.value[0]),
        lve_squared=float(squared.value[0]),
        mee=float(mean_lips.value),
        mee_squared=float(mean_squared.value),
        ce=float(lips.value.min()),
        ce_squared=float(squared.value.min()),
        fdd_signed=dynamics,
        fdd_absolute=abs(dynamics),
    )


def split_half_diversity(surface: FaceSurface, samples: FaceSamples, rng: np.random.Generator) -> float:
    """Eq. 10: mean distance of paired samples of two random halves; NaN with fewer than two samples."""
    count, frames, _ = samples.jaw.shape
    order, half = rng.permutation(count).tolist(), count // 2
    apart = _Mean()
    for one, other in zip(order[:half], order[half : 2 * half], strict=True):
        for at in frame_blocks(frames):
            pair = [surface.displacement_mm(samples, s, at, "face") for s in (one, other)]
            apart.add(vertex_error(*pair))
    return float(apart.value) if half else float("nan")


def vertex_error(one: Float[ndarray, "*#B T N 3"], other: Float[ndarray, "*#B T N 3"]) -> Float[ndarray, "*#B T"]:
    """Mean vertex distance in each frame."""
    return np.asarray(_distance(one, other).mean(axis=-1))


def lip_error(one: Float[ndarray, "*#B T N 3"], other: Float[ndarray, "*#B T N 3"]) -> Float[ndarray, "*#B T"]:
    """Largest distance of a lip vertex in each frame."""
    return np.asarray(_distance(one, other).max(axis=-1))


def _distance(one: Float[ndarray, "*#B N 3"], other: Float[ndarray, "*#B N 3"]) -> Float[ndarray, "*#B N"]:
    away = one - other
    return np.asarray(np.sqrt(np.einsum("...d,...d->...", away, away)))


class DynamicsAccumulator:
    """SD over time of squared displacements, accumulated block by block."""

    def __init__(self) -> None:
        self._frames = 0
        self._sum: ndarray = np.zeros(1)
        self._of_squares: ndarray = np.zeros(1)

    def add(self, moved_mm: Float[ndarray, "T N 3"]) -> None:
        """Add a block of frames."""
        squared = np.square(moved_mm).sum(axis=-1)
        self._frames += len(squared)
        self._sum = self._sum + squared.sum(axis=0)
        self._of_squares = self._of_squares + np.square(squared).sum(axis=0)

    def deviation(self) -> float:
        """Mean SD over vertices, in mm2."""
        count = max(self._frames, 1)
        variance = self._of_squares / count - np.square(self._sum / count)
        return float(np.sqrt(np.maximum(variance, 0.0)).mean())


class _Mean:
    """Running mean over the last axis of successive arrays; NaN if there are none."""

    def __init__(self) -> None:
        self._sum: ndarray = np.zeros(())
        self._count = 0

    def add(self, values: Float[ndarray, "*B T"]) -> None:
        self._sum = self._sum + values.sum(axis=-1)
        self._count += values.shape[-1]

    @property
    def value(self) -> Float[ndarray, "*B"]:
        return np.asarray(self._sum / self._count if self._count else self._sum * np.nan)
