"""The Eyelid model of one eye: lid curves from two gaze angles and one blink parameter, fitted to labelled curves.

Elisei, Bailly & Casari (AVSP 2007), section 5.2. Stage one: linear regression of the centred 3D coordinates on
sin(a1+a2), sin(a1-a2), cos(a1), cos(a2), with a1 the azimuth and a2 the elevation of gaze. Stage two: the first
principal component of the residual, which corresponds to a blink. The paper leaves the scale of this component open.
Here it follows `Motion.lid`: 0 is the opening of postures held with open eyes, 1 the closure at which the lids meet at
the current gaze, and negative values are wider.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core.errors import InputError

UPPER = slice(0, 15)  # points of the joined curves of a posture, each from the inner to the outer corner
LOWER = slice(15, 30)
ANCHOR = slice(30, 39)
POINTS = 39
MIDDLE = slice(4, 11)  # of a lid: the points at which the opening is measured, away from the corners


@dataclass(frozen=True)
class LabelledPostures:
    """N postures of one eye: gaze from the iris contour, and the joined upper, lower and brow-anchor curves.

    `held` marks postures of a gaze held with open eyes, `shut` those with closed lids; the others are arbitrary.
    """

    angles_rad: Float[ndarray, "N 2"]
    curves: Float[ndarray, "N P 3"]
    held: Bool[ndarray, " N"]
    shut: Bool[ndarray, " N"]

    def at(self, rows: ndarray) -> LabelledPostures:
        """Select postures by a mask or by indices."""
        return LabelledPostures(self.angles_rad[rows], self.curves[rows], self.held[rows], self.shut[rows])


@dataclass(frozen=True)
class ExplainedVariance:
    """Fraction of the variance of the coordinates explained by stage one, and by both stages."""

    stage_one: float
    both_stages: float

    @property
    def of_residual(self) -> float:
        """Fraction of the residual of stage one that stage two explains."""
        return (self.both_stages - self.stage_one) / (1.0 - self.stage_one)


@dataclass(frozen=True)
class EyelidModel:
    """curves = rest + (predictors - centre) W + v blink, metres in the head; v = 1 closes the lids at centred gaze."""

    rest: Float[ndarray, "P 3"]
    centre: Float[ndarray, " 4"]
    weights: Float[ndarray, "4 P 3"]
    blink: Float[ndarray, "P 3"]
    mean_blink: float  # mean v of the labels: the constant in stage one, which does not model blinks

    def gaze_only_curves(self, angles_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N P 3"]:
        """Stage one: the curves predicted from gaze."""
        return np.asarray(self.rest + np.tensordot(gaze_predictors(angles_rad) - self.centre, self.weights, axes=1))

    def curves(self, angles_rad: Float[ndarray, "*N 2"], lid: Float[ndarray, "*N"]) -> Float[ndarray, "*N P 3"]:
        """The curves at a gaze and a closure as in `Motion.lid`."""
        blink = self.blink_weight(angles_rad, lid)[..., None, None] * self.blink
        return np.asarray(self.gaze_only_curves(angles_rad) + blink)

    def blink_weight(self, angles_rad: Float[ndarray, "*N 2"], lid: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
        """Weight v of the blink component for a closure: smaller for an eye that already looks down."""
        return np.asarray(lid * lid_opening_m(self.gaze_only_curves(angles_rad)) / -lid_opening_m(self.blink))

    def lid(self, angles_rad: Float[ndarray, "*N 2"], curves: Float[ndarray, "*N P 3"]) -> Float[ndarray, "*N"]:
        """Closure that best fits curves at a known gaze; the inverse of `curves`."""
        left = curves - self.gaze_only_curves(angles_rad)
        weight = (left * self.blink).sum(axis=(-2, -1)) / (self.blink**2).sum()
        return np.asarray(weight / self.blink_weight(angles_rad, np.ones_like(weight)))


def gaze_predictors(angles_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 4"]:
    """sin(a1+a2), sin(a1-a2), cos(a1), cos(a2)."""
    azimuth, elevation = angles_rad[..., 0], angles_rad[..., 1]
    return np.stack(
        [np.sin(azimuth + elevation), np.sin(azimuth - elevation), np.cos(azimuth), np.cos(elevation)], axis=-1
    )


def lid_opening_m(curves: Float[ndarray, "*N P 3"]) -> Float[ndarray, "*N"]:
    """Mean height of the upper above the lower lid around their middle, metres."""
    gap = curves[..., UPPER, 1][..., MIDDLE] - curves[..., LOWER, 1][..., MIDDLE]
    return np.asarray(gap.mean(axis=-1))


def fit_eyelid_model(labels: LabelledPostures) -> EyelidModel:
    """Fit both stages to labelled postures. Raises InputError if the postures do not determine them."""
    if len(labels.curves) < 7 or not labels.held.any() or not labels.shut.any():
        raise InputError(
            "eyelid: labels should be at least 7 postures, with held gazes and shut lids among them, got "
            f"{len(labels.curves)}, {labels.held.sum()} held, {labels.shut.sum()} shut"
        )
    mean, inputs = labels.curves.mean(axis=0), gaze_predictors(labels.angles_rad)
    centre = inputs.mean(axis=0)
    flat = (labels.curves - mean).reshape(len(inputs), -1)
    weights, _, rank, _ = np.linalg.lstsq(inputs - centre, flat, rcond=1e-6)
    if rank < 4:
        raise InputError(f"eyelid: gaze of the labels should vary in azimuth and elevation, got rank {rank} of 4")
    left = flat - (inputs - centre) @ weights
    component = left.T @ np.linalg.eigh(left @ left.T)[1][:, -1]
    component /= np.linalg.norm(component)
    score = left @ component
    held, shut = score[labels.held].mean(), score[labels.shut].mean()
    shape = mean.shape
    return EyelidModel(
        rest=mean + held * component.reshape(shape),
        centre=centre,
        weights=weights.reshape(4, *shape),
        blink=(shut - held) * component.reshape(shape),
        mean_blink=float(-held / (shut - held)),
    )


def explained_variance(model: EyelidModel, labels: LabelledPostures) -> ExplainedVariance:
    """Variance explained on training or held-out postures, with the best-fitting score of each posture in stage two."""
    around = labels.curves - labels.curves.mean(axis=0)
    total = (around**2).sum()
    left = labels.curves - model.gaze_only_curves(labels.angles_rad)
    score = (left * model.blink).sum(axis=(1, 2)) / (model.blink**2).sum()
    one = left - model.mean_blink * model.blink
    both = left - score[:, None, None] * model.blink
    return ExplainedVariance(float(1 - (one**2).sum() / total), float(1 - (both**2).sum() / total))
