"""Expression transfer between heads: least squares over corresponding points of the faces.

The faces are aligned by a similarity transform from joints and shared landmarks; each vertex of the source's face
corresponds to the nearest one of the target's. The map M (source shapes x target shapes) minimises the difference of
the displacements, sum |D_source - M D_target|^2, plus a small ridge, because shapes overlap. Gaze, lids, jaw and head
are angles and closures, which are independent of the head and are copied. The residual of the target is reported in
millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import expression_shape_names, shape_weights

RIDGE = 1e-3  # relative to the mean square of the target's displacements: keeps weights small where shapes overlap
FACE_RADIUS_M = 0.11  # extent of the face around the midpoint of the eyes, for a pupil distance of 63 mm
NEAR_M = 0.010  # points further apart do not correspond
PUPIL_DISTANCE_M = 0.063
EYES = ("left", "right")


@dataclass(frozen=True)
class SimilarityTransform:
    """target point = scale * source point + shift (both heads face the same way, so there is no rotation)."""

    scale: float
    shift: Float[ndarray, " 3"]

    def __call__(self, points: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
        return np.asarray(self.scale * points + self.shift)


@dataclass(frozen=True)
class ExpressionMap:
    """Weights of the target's shapes for each shape of the source, and their residual at weight 1."""

    source: str
    target: str
    source_names: tuple[str, ...]
    target_names: tuple[str, ...]
    weights: Float[ndarray, "S T"]
    points: int
    requested: Float[ndarray, "S C"]  # displacements of the points by the source, at the target's scale
    residual: Float[ndarray, "S C"]  # displacements that the target cannot reproduce

    @property
    def error_mm(self) -> Float[ndarray, " S"]:
        """Root mean square residual over the points, of each source shape at weight 1."""
        return _rms_mm(self.residual)

    @property
    def requested_mm(self) -> Float[ndarray, " S"]:
        """Root mean square displacement by each source shape, for comparison."""
        return _rms_mm(self.requested)

    def motion(self, motion: Motion) -> Motion:
        """Convert a motion to the target. Raises InputError if it is not a motion of the source."""
        mapped = self._weights_of(motion) @ self.weights
        return replace(motion, expression=mapped, expression_names=self.target_names, head_model=self.target)

    def _weights_of(self, motion: Motion) -> Float[ndarray, "T S"]:
        strange = [name for name in motion.expression_names if name not in self.source_names]
        if strange:
            raise InputError(
                f"motion: expression should be of the head {self.source}, got {strange[0]} of {motion.head_model}"
            )
        weights = np.zeros((len(motion), len(self.source_names)))
        weights[:, [self.source_names.index(name) for name in motion.expression_names]] = motion.expression
        return weights


def expression_map(source: HeadModel, target: HeadModel) -> ExpressionMap:
    """Fit the expression map between two heads. Raises InputError if their faces do not correspond."""
    alignment = align_heads(source, target)
    here, there = corresponding_vertices(source, target, alignment)
    source_names, target_names = expression_shape_names(source), expression_shape_names(target)
    asked = alignment.scale * _displacements(source, source_names, here)
    given = _displacements(target, target_names, there)
    weights = _least_squares(given, asked)
    return ExpressionMap(
        source=source.name,
        target=target.name,
        source_names=source_names,
        target_names=target_names,
        weights=weights,
        points=len(here),
        requested=asked,
        residual=asked - weights @ given,
    )


def lid_expression(
    model: HeadModel, gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"]
) -> Float[ndarray, "T C"]:
    """Expression weights that move the skin as the lids of a motion do, for players without lid shapes.

    The columns are those of `expression_shape_names`. Least squares over the skin, with the opening of both eyes
    counted as much as all of it: a face that is right but for half-open eyes does not blink.
    """
    weights = shape_weights(model, gaze, lid, np.zeros((len(lid), 3)))
    wanted, given = ([model.shape(name) for name in names] for names in (weights, expression_shape_names(model)))
    skin = model.vertices_of("skin", "lips", "brow")
    openings = np.sqrt(len(skin)) * _openings(model)
    moved = np.concatenate([model.expression[:, skin].reshape(len(openings), -1), openings], axis=1)
    mixture = _least_squares(moved[given], moved[wanted])
    return np.asarray(np.stack(list(weights.values()), axis=1) @ mixture)


def _openings(model: HeadModel) -> Float[ndarray, "S 2"]:
    """How much each shape opens the lids of both eyes, in metres."""
    heights = model.landmarks.of(model.expression)[..., 1]
    upper, lower = (
        [[model.landmarks.names.index(f"{side}_eye_{edge}_{at}") for at in ("outer", "inner")] for side in EYES]
        for edge in ("upper", "lower")
    )
    return np.asarray((heights[:, upper] - heights[:, lower]).mean(axis=-1))


def _least_squares(given: Float[ndarray, "T C"], asked: Float[ndarray, "S C"]) -> Float[ndarray, "S T"]:
    """Weights of the given displacements that make the asked ones, with a small ridge."""
    gram = given @ given.T
    ridge = RIDGE * np.trace(gram) / max(len(gram), 1)
    return np.asarray(np.linalg.solve(gram + ridge * np.eye(len(gram)), given @ asked.T).T)


def align_heads(source: HeadModel, target: HeadModel) -> SimilarityTransform:
    """Scale by the eye distance; shift by eyes and jaw, or by the landmarks of both heads."""
    scale = _eye_distance_m(target) / _eye_distance_m(source)
    shared = [name for name in source.landmarks.names if name in target.landmarks.names]
    if len(shared) < 3:
        return SimilarityTransform(scale, (target.joints[2:] - scale * source.joints[2:]).mean(axis=0))
    places = [
        head.landmarks.of(head.template)[[head.landmarks.names.index(name) for name in shared]]
        for head in (source, target)
    ]
    return SimilarityTransform(scale, (places[1] - scale * places[0]).mean(axis=0))


def corresponding_vertices(
    source: HeadModel, target: HeadModel, alignment: SimilarityTransform
) -> tuple[Int[ndarray, " K"], Int[ndarray, " K"]]:
    """Vertices of the source's face, and the nearest vertex of the target's skin for each.

    Raises InputError if a face is missing or the faces hardly overlap.
    """
    from scipy.spatial import cKDTree

    scale = _eye_distance_m(source) / PUPIL_DISTANCE_M
    middle = source.eye_centres.mean(axis=0)
    skin, goal = (head.vertices_of("skin", "lips", "brow") for head in (source, target))
    out = source.template[skin] - middle
    face = skin[(np.linalg.norm(out, axis=1) < FACE_RADIUS_M * scale) & (out[:, 2] > -0.02 * scale)]
    if not len(face) or not len(goal):
        raise InputError(f"heads {source.name} and {target.name}: should both have a face, got {len(face)} points")
    distance, nearest = cKDTree(target.template[goal]).query(alignment(source.template[face]))
    near = distance < NEAR_M * _eye_distance_m(target) / PUPIL_DISTANCE_M
    if near.sum() < 30:
        raise InputError(
            f"heads {source.name} and {target.name}: at least 30 points of the face should lie on each other, "
            f"got {near.sum()} of {len(face)}"
        )
    return face[near], goal[nearest[near]]


def _displacements(model: HeadModel, names: tuple[str, ...], vertices: Int[ndarray, " K"]) -> Float[ndarray, "S C"]:
    rows = [model.shape(name) for name in names]
    return np.asarray(model.expression[rows][:, vertices].reshape(len(rows), -1))


def _eye_distance_m(model: HeadModel) -> float:
    return float(np.linalg.norm(model.eye_centres[0] - model.eye_centres[1]))


def _rms_mm(displacements: Float[ndarray, "N C"]) -> Float[ndarray, " N"]:
    """Root mean square over points with three coordinates each."""
    points = displacements.reshape(len(displacements), -1, 3)
    return np.asarray(1e3 * np.sqrt((points**2).sum(axis=-1).mean(axis=-1)))
