"""The Eyelid model as blend shapes: it moves the lids of every head, with three parameters per eye.

Both stages of the model are linear in their inputs, so the lids of a head need five shapes per eye: the four gaze
predictors, relative to gaze straight ahead, and the blink. The motion of skin beside the lid curves depends on the
head. If it has ARKit's lid shapes, each of the five is the least-squares mixture of them that best matches the model's
curves, so the skin folds as its sculptor intended, and the skin at the margins moves by what is left. Otherwise the
skin around the eye moves by construction. Only the
weight of the blink is not linear: it closes the opening that remains at the current gaze
(`model.EyelidModel.blink_weight`), measured on four lid landmarks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.head.eyelid.model import LOWER, POINTS, UPPER, EyelidModel, fit_eyelid_model, gaze_predictors
from talkingeyes.head.eyelid.postures import posture_grid
from talkingeyes.head.eyelid.region import TEMPORAL_AXES, EyelidRegion, eyelid_region
from talkingeyes.head.model import HeadModel, Landmarks

SIDES = ("left", "right")
PREDICTORS = ("SinSum", "SinDifference", "CosAzimuth", "CosElevation")
LID_SHAPES = tuple(f"lid{what}{side.title()}" for side in SIDES for what in (*PREDICTORS, "Blink"))
EYE_POINTS = ("outer", "upper_outer", "upper_inner", "inner", "lower_inner", "lower_outer")
AHEAD = gaze_predictors(np.zeros(2))
SCULPTED = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")
CORRECTIONS = 3  # rounds in which the margins are moved onto the curves
RIDGE = 1e-3  # relative to the mean square of a sculpted shape, because the shapes overlap


def has_eyelids(model: HeadModel) -> bool:
    """Whether a head has the shapes of the Eyelid model."""
    return LID_SHAPES[0] in model.expression_names


def lid_landmarks(model: HeadModel) -> Landmarks:
    """p1 to p6 of the eye aspect ratio of both eyes, derived from the lid curves of a head without landmarks."""
    third, two = (UPPER.stop - UPPER.start) // 3, 2 * (UPPER.stop - UPPER.start) // 3
    places = (UPPER.stop - 1, two, third, UPPER.start, LOWER.start + third, LOWER.start + two)
    curves = [eyelid_region(model, eye).curves for eye in range(2)]
    return Landmarks(
        tuple(f"{side}_eye_{point}" for side in SIDES for point in EYE_POINTS),
        np.concatenate([curve.corners[list(places)] for curve in curves]),
        np.concatenate([curve.barycentric[list(places)] for curve in curves]),
    )


def with_eyelids(
    model: HeadModel, eyelid_parameters: EyelidParameters, person: tuple[EyelidModel, EyelidModel] | None = None
) -> HeadModel:
    """Add the shapes of the Eyelid model of both eyes, built on the head's own lids, in the place of those it has.

    `person`: models of a person's left and right eye, whose curves the lids then follow in the size of the head's eyes.
    The resting lids stay those of the head.
    """
    kept = [index for index, name in enumerate(model.expression_names) if name not in LID_SHAPES]
    shapes = []
    for eye in range(2):
        around = eyelid_region(model, eye)
        built = fit_eyelid_model(posture_grid(around, eyelid_parameters))
        moved = _moved(built)
        curves = moved[:, :POINTS] if person is None else _moved(person[eye]) * _width_m(built) / _width_m(person[eye])
        if f"{SCULPTED[0]}Left" in model.expression_names:
            shapes.append(_mixture(model, around, curves * TEMPORAL_AXES[eye]))
        else:
            free = np.zeros((5, *model.template.shape))
            free[:, around.vertices] = (moved[:, POINTS:] + around.spread(curves - moved[:, :POINTS])) * TEMPORAL_AXES[
                eye
            ]
            shapes.append(free)
    return replace(
        model,
        expression=np.concatenate([model.expression[kept], *shapes]).astype(model.expression.dtype),
        expression_names=(*(model.expression_names[index] for index in kept), *LID_SHAPES),
    )


def _moved(lids: EyelidModel) -> Float[ndarray, "5 N 3"]:
    """Displacements of all points by the four predictors and the blink, +x to the temple."""
    return np.concatenate([lids.weights, lids.blink[None]])


def _width_m(lids: EyelidModel) -> float:
    """Distance of the corners of the eye."""
    return float(np.linalg.norm(lids.rest[UPPER][-1] - lids.rest[UPPER][0]))


def _mixture(model: HeadModel, around: EyelidRegion, curves: Float[ndarray, "5 P 3"]) -> Float[ndarray, "5 V 3"]:
    """Shapes of an eye that move its lids along `curves`, in head axes: mixtures of the sculpted ones, corrected."""
    side = SIDES[around.eye].title()
    sculpted = model.expression[[model.shape(f"{name}{side}") for name in SCULPTED]]
    lids = slice(UPPER.start, LOWER.stop)
    given, wanted = (points[:, lids].reshape(len(points), -1) for points in (around.curves.of(sculpted), curves))
    gram = given @ given.T
    ridge = RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    mix = np.linalg.solve(gram + ridge, given @ wanted.T).T
    shapes = np.tensordot(mix, sculpted, axes=1)
    for _ in range(CORRECTIONS):
        left = curves - around.curves.of(shapes)
        shapes[:, around.vertices] += around.spread(left)
    return np.asarray(shapes)


def eyelid_weights(
    model: HeadModel, gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"]
) -> dict[str, Float[ndarray, " T"]]:
    """Weights of the ten shapes for gaze and closure (`Motion.gaze`, `Motion.lid`)."""
    inputs = gaze_predictors(gaze_to_angles(gaze)) - AHEAD
    first = model.shape(LID_SHAPES[0])
    weights: dict[str, Float[ndarray, " T"]] = {}
    for eye, side in enumerate(SIDES):
        shapes = model.expression[first + 5 * eye : first + 5 * eye + 5]
        rest, gained = _opening(model, model.template, side), _opening(model, shapes, side)
        left_open = np.maximum(rest + inputs[:, eye] @ gained[:4], 0.0)
        blink = lid[:, eye] * left_open / -gained[4]
        columns = (*inputs[:, eye].T, blink)
        weights |= dict(zip(LID_SHAPES[5 * eye : 5 * eye + 5], columns, strict=True))
    return weights


def _opening(model: HeadModel, vertices: Float[ndarray, "*N V 3"], side: str) -> Float[ndarray, "*N"]:
    """Height of the upper above the lower lid landmarks of an eye; for a shape, the change of it."""
    height = model.landmarks.of(vertices)[..., 1]
    names = model.landmarks.names
    upper, lower = (
        height[..., [names.index(f"{side}_eye_{lid}_{at}") for at in ("outer", "inner")]].mean(axis=-1)
        for lid in ("upper", "lower")
    )
    return np.asarray(upper - lower)
