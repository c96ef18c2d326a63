"""LightGazeFit: eye rotations whose projected pupils match the observed ones, given the head pose (paper, eq. 1 to 4).

    L = ||y_hat - y||^2 + w_reg ||p_eye||^2 + w_sym ||p_l - p_r||^2     per frame, p_eye = (p_l, p_r) in R^6

p_l and p_r are rotation vectors (radians, eye-in-head). Hidden pupils (NaN) are excluded from the first term. If one
eye is hidden, the symmetry term makes it follow the other; if both are hidden, the solution is 0 and carries no
information.

The paper does not give the unit of y. In pixels of a crop of 224, a radian moves the pupil by about 15 px, so the
weights 1e-4 and 1e-2 pull the eyes together by less than 0.01 %: they determine only what the data do not, namely
torsion and a hidden eye. With the crop scaled to [-1, 1] (`unit_px: 112`) the symmetry term would halve the difference
between the eyes, which is real (the axes of the eyeballs differ by some 9 degrees).

Two solvers minimise this objective: `solve_adam` as in the paper, and `solve_newton`, Gauss-Newton with the analytic
Jacobian, some hundred times faster (benchmarks/fitting.py). `solve_listing` enforces Listing's law instead of favouring
it: without torsion, two parameters per eye match the two image coordinates exactly, in closed form and without weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field, model_validator

from talkingeyes.core.rotation import direction_to_rotvec, rotvec_to_direction, rotvec_to_matrix
from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import EYE_CENTRES, PUPIL_OFFSET_M

Positive = Annotated[float, Field(gt=0)]
DIAGONAL = np.arange(6)
BLOCK_FRAMES = 4096  # frames solved together
PAPER_REGULARISATION, PAPER_SYMMETRY = 1e-4, 1e-2  # lambda_1 and lambda_2 of eq. 1
SMALL_RAD = 1e-4  # below it, sin a / a and similar terms are evaluated at this angle (error 1e-9)


class NewtonSettings(Settings):
    """Gauss-Newton: maximum steps, convergence tolerance (radians, largest step of a frame), minimum damping."""

    steps: Annotated[int, Field(gt=0)]
    tolerance_rad: Positive
    damping: Positive


class AdamSettings(Settings):
    """Adam as in the paper: learning rate; stops if L falls by less than `tolerance` (relative) in `patience` steps."""

    learning_rate: Positive
    tolerance: Positive
    patience: Annotated[int, Field(gt=0)]
    steps: Annotated[int, Field(gt=0)]


class LightGazeFitSettings(Settings):
    """Solver, weights of eq. 1 (null for `listing`, which has none), and pixels per unit of y."""

    solver: Literal["newton", "adam", "listing"]
    regularisation: Annotated[float, Field(gt=0)] | None
    symmetry: Annotated[float, Field(ge=0)] | None
    unit_px: Positive
    newton: NewtonSettings
    adam: AdamSettings

    @model_validator(mode="after")
    def _weights_act(self) -> LightGazeFitSettings:
        for name in ("regularisation", "symmetry"):
            if (getattr(self, name) is None) != (self.solver == "listing"):
                bound = "null" if self.solver == "listing" else "a number"
                raise bounds_error(f"{name} should be {bound} for solver={self.solver}", getattr(self, name))
        return self

    def with_adam(self) -> LightGazeFitSettings:
        """The paper's solver, with the weights of these settings or the paper's."""
        regularisation, symmetry = self.weights
        return self.model_copy(update={"solver": "adam", "regularisation": regularisation, "symmetry": symmetry})

    @property
    def weights(self) -> tuple[float, float]:
        """Weights of eq. 1 in the reported objective; the paper's for `listing`."""
        return (
            PAPER_REGULARISATION if self.regularisation is None else self.regularisation,
            PAPER_SYMMETRY if self.symmetry is None else self.symmetry,
        )


@dataclass(frozen=True)
class PupilObservations:
    """Input of a fit of T frames: observed pupils (NaN where hidden), head pose and camera."""

    pupils: Float[ndarray, "T 2 2"]
    head: Float[ndarray, "T 3"]
    translation: Float[ndarray, "T 3"]
    camera: Camera

    @property
    def seen(self) -> Bool[ndarray, "T 2"]:
        """Which pupils were observed."""
        return np.asarray(np.isfinite(self.pupils).all(axis=-1))

    def frame_range(self, start: int, stop: int) -> PupilObservations:
        """Observations of the frames from `start` up to `stop`."""
        at = slice(start, stop)
        return PupilObservations(self.pupils[at], self.head[at], self.translation[at], self.camera)


@dataclass(frozen=True)
class Solution:
    """Fitted eye-in-head rotation vectors, the objective of each frame, and the number of solver steps."""

    gaze: Float[ndarray, "T 2 3"]
    objective: Float[ndarray, " T"]
    steps: int


def fit_gaze(observations: PupilObservations, settings: LightGazeFitSettings) -> Solution:
    """Fit gaze with the configured solver."""
    solvers = {"adam": solve_adam, "newton": solve_newton, "listing": solve_listing}
    return solvers[settings.solver](observations, settings)


def solve_listing(observations: PupilObservations, settings: LightGazeFitSettings) -> Solution:
    """Fit gaze under Listing's law, in blocks of frames, so that working memory does not grow with the clip."""
    blocks = [
        observations.frame_range(start, start + BLOCK_FRAMES)
        for start in range(0, len(observations.head), BLOCK_FRAMES)
    ]
    gaze = [ray_gaze(block) for block in blocks]
    values = [_Problem.of(block, settings).value(found) for block, found in zip(blocks, gaze, strict=True)]
    return Solution(np.concatenate(gaze), np.concatenate(values), 1)


def solve_newton(observations: PupilObservations, settings: LightGazeFitSettings) -> Solution:
    """Fit gaze by Gauss-Newton, in blocks of frames, so that working memory does not grow with the clip."""
    blocks = [
        observations.frame_range(start, start + BLOCK_FRAMES)
        for start in range(0, len(observations.head), BLOCK_FRAMES)
    ]
    parts = [_newton(block, settings) for block in blocks]
    return Solution(
        np.concatenate([part.gaze for part in parts]),
        np.concatenate([part.objective for part in parts]),
        max(part.steps for part in parts),
    )


def _newton(observations: PupilObservations, settings: LightGazeFitSettings) -> Solution:
    """Gauss-Newton over all frames at once: one 6 x 6 system per frame, starting from `ray_gaze`.

    Levenberg damping: a frame whose objective would rise keeps its state and increases the damping of its next step.
    """
    newton = settings.newton
    problem = _Problem.of(observations, settings)
    gaze = ray_gaze(observations)
    frames = len(gaze)
    damping = np.full(frames, newton.damping)
    term = problem.linearise(gaze)
    step = 0
    for step in range(1, newton.steps + 1):
        system = term.hessian.copy()
        system[:, DIAGONAL, DIAGONAL] += damping[:, None]
        change = -np.linalg.solve(system, term.gradient[..., None])[..., 0]
        candidate = gaze + change.reshape(frames, 2, 3)
        if np.abs(change).max() < newton.tolerance_rad:  # the last step needs no derivatives
            value = problem.value(candidate)
            better = value <= term.objective
            return Solution(
                np.where(better[:, None, None], candidate, gaze), np.where(better, value, term.objective), step
            )
        following = problem.linearise(candidate)
        better = following.objective <= term.objective
        if better.all():
            gaze, term = candidate, following
        else:
            gaze = np.where(better[:, None, None], candidate, gaze)
            term = term.where(better, following)
            damping = np.where(better, newton.damping, damping * 10 + 1e-3)
    return Solution(gaze, term.objective, step)


def ray_gaze(observations: PupilObservations) -> Float[ndarray, "T 2 3"]:
    """Gaze whose pupil lies on the ray through the observed pupil: the fit without regularisers and torsion.

    A ray that misses the sphere of pupil positions takes the nearest point. A hidden pupil copies the other eye, or
    looks straight ahead.
    """
    camera, turn = observations.camera, rotvec_to_matrix(observations.head)
    centres = EYE_CENTRES @ turn.swapaxes(1, 2) + observations.translation[:, None]
    offset = (observations.pupils - np.asarray(camera.centre_px)) / camera.focal_px
    ray = np.stack([offset[..., 0], -offset[..., 1], np.full(offset.shape[:-1], -1.0)], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    to_centre = centres - np.array([0.0, 0.0, camera.distance_m])
    along = np.sum(ray * to_centre, axis=-1)
    miss = np.sum(to_centre**2, axis=-1) - along**2
    reach = along - np.sqrt(np.maximum(PUPIL_OFFSET_M**2 - miss, 0.0))
    outward = ray * reach[..., None] - to_centre
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    gaze = direction_to_rotvec(outward @ turn)
    gaze = np.where(np.isfinite(gaze), gaze, gaze[:, ::-1])
    return np.where(np.isfinite(gaze), gaze, 0.0)


@dataclass(frozen=True)
class _Terms:
    """The objective at a state: value, gradient and Gauss-Newton Hessian; both derivatives halved."""

    objective: Float[ndarray, " T"]
    gradient: Float[ndarray, "T 6"]
    hessian: Float[ndarray, "T 6 6"]

    def where(self, better: Bool[ndarray, " T"], other: _Terms) -> _Terms:
        """Take `other` in the frames where `better` is true."""
        return _Terms(
            np.where(better, other.objective, self.objective),
            np.where(better[:, None], other.gradient, self.gradient),
            np.where(better[:, None, None], other.hessian, self.hessian),
        )


@dataclass(frozen=True)
class _Problem:
    """Fixed quantities of a fit."""

    turn: Float[ndarray, "T 3 3"]
    centres: Float[ndarray, "T 2 3"]
    pupils: Float[ndarray, "T 2 2"]
    seen: Float[ndarray, "T 2 1"]
    prior: Float[ndarray, "6 6"]
    camera: Camera
    unit_px: float

    @classmethod
    def of(cls, observations: PupilObservations, settings: LightGazeFitSettings) -> _Problem:
        turn = rotvec_to_matrix(observations.head)
        eye, both = np.eye(3), np.array([[1.0, -1.0], [-1.0, 1.0]])
        regularisation, symmetry = settings.weights
        return cls(
            turn=turn,
            centres=EYE_CENTRES @ turn.swapaxes(1, 2) + observations.translation[:, None],
            pupils=np.nan_to_num(observations.pupils),
            seen=observations.seen[..., None].astype(np.float64),
            prior=regularisation * np.eye(6) + symmetry * np.kron(both, eye),
            camera=observations.camera,
            unit_px=settings.unit_px,
        )

    def value(self, gaze: Float[ndarray, "T 2 3"]) -> Float[ndarray, " T"]:
        """The objective at these rotation vectors, without derivatives."""
        points = self.centres + PUPIL_OFFSET_M * (rotvec_to_direction(gaze) @ self.turn.swapaxes(1, 2))
        residual = (self.camera.project(points) - self.pupils) * (self.seen / self.unit_px)
        state = gaze.reshape(-1, 6)
        return np.asarray(np.sum(residual**2, axis=(1, 2)) + np.sum((state @ self.prior) * state, axis=1))

    def linearise(self, gaze: Float[ndarray, "T 2 3"]) -> _Terms:
        """Value and derivatives of the objective at these rotation vectors."""
        residual, jacobian = self._residual_and_jacobian(gaze)
        objective, gradient = self._value_and_gradient(gaze, residual, jacobian)
        hessian = np.tile(self.prior, (len(gaze), 1, 1))
        squares = jacobian.swapaxes(-1, -2) @ jacobian
        hessian[:, :3, :3] += squares[:, 0]
        hessian[:, 3:, 3:] += squares[:, 1]
        return _Terms(objective, gradient, hessian)

    def gradient(self, gaze: Float[ndarray, "T 2 3"]) -> tuple[Float[ndarray, " T"], Float[ndarray, "T 6"]]:
        """Value and half of the gradient of the objective at these rotation vectors."""
        return self._value_and_gradient(gaze, *self._residual_and_jacobian(gaze))

    def _residual_and_jacobian(
        self, gaze: Float[ndarray, "T 2 3"]
    ) -> tuple[Float[ndarray, "T 2 2"], Float[ndarray, "T 2 2 3"]]:
        """Pupil errors in units of y, and their derivatives by the rotation vectors."""
        looking, by_gaze = direction_and_jacobian(gaze)
        points = self.centres + PUPIL_OFFSET_M * (looking @ self.turn.swapaxes(1, 2))
        scale = self.camera.focal_px / (self.camera.distance_m - points[..., 2])
        weight = self.seen / self.unit_px
        along = points[..., :2] * (scale / self.camera.focal_px)[..., None]  # image motion per unit of depth
        by_turned = self.turn[:, None, :2] + along[..., None] * self.turn[:, None, 2:]
        factor = PUPIL_OFFSET_M * weight * scale[..., None] * np.array([1.0, -1.0])
        return (self.camera.project(points) - self.pupils) * weight, factor[..., None] * (by_turned @ by_gaze)

    def _value_and_gradient(
        self, gaze: Float[ndarray, "T 2 3"], residual: Float[ndarray, "T 2 2"], jacobian: Float[ndarray, "T 2 2 3"]
    ) -> tuple[Float[ndarray, " T"], Float[ndarray, "T 6"]]:
        state = gaze.reshape(-1, 6)
        pull = state @ self.prior
        objective = np.sum(residual**2, axis=(1, 2)) + np.sum(pull * state, axis=1)
        gradient = (jacobian.swapaxes(-1, -2) @ residual[..., None])[..., 0].reshape(-1, 6) + pull
        return objective, gradient


def direction_and_jacobian(gaze: Float[ndarray, "*N 3"]) -> tuple[Float[ndarray, "*N 3"], Float[ndarray, "*N 3 3"]]:
    """exp(p) e_z and its derivative by the rotation vector p (columns are the components of p).

    e_z cos a + (p x e_z) s + p p_z c with s = sin a / a and c = (1 - cos a) / a^2, differentiated by the product rule.
    """
    x, y, z = gaze[..., 0], gaze[..., 1], gaze[..., 2]
    squared = x * x + y * y + z * z
    angle = np.sqrt(np.maximum(squared, SMALL_RAD**2))
    cosine = np.cos(angle)
    s, c = np.sin(angle) / angle, (1.0 - cosine) / angle**2
    ds, dc = (cosine - s) / angle**2, (s - 2.0 * c) / angle**2  # derivatives of s and c by p, divided by p
    looking = np.stack([y * s + x * z * c, -x * s + y * z * c, 1.0 - (x * x + y * y) * c], axis=-1)
    by_s = np.stack([y, -x, np.zeros_like(x)], axis=-1)
    by_c = gaze * z[..., None]
    jacobian = (by_s * ds[..., None] + by_c * dc[..., None])[..., :, None] * gaze[..., None, :]
    jacobian[..., 2, :] -= s[..., None] * gaze  # d cos a = -s p
    jacobian[..., 0, 1] += s
    jacobian[..., 1, 0] -= s
    for axis in range(3):
        jacobian[..., axis, axis] += z * c
        jacobian[..., axis, 2] += gaze[..., axis] * c
    return looking, jacobian


def solve_adam(observations: PupilObservations, settings: LightGazeFitSettings) -> Solution:
    """Fit gaze as in the paper: Adam over all frames of the clip at once, from zero, with the analytic gradient."""
    import torch

    adam, problem = settings.adam, _Problem.of(observations, settings)
    state = torch.zeros(len(observations.head), 2, 3, dtype=torch.float64)
    gaze = state.numpy()  # shares memory with the state
    optimiser = torch.optim.Adam([state], lr=adam.learning_rate)
    earlier, step = float("inf"), 0
    while step < adam.steps:
        objective, gradient = problem.gradient(gaze)
        if step % adam.patience == 0:
            value = float(objective.sum())
            if earlier - value < adam.tolerance * earlier and step:
                break
            earlier = value
        state.grad = torch.from_numpy(2.0 * gradient).view_as(state)
        optimiser.step()
        step += 1
    return Solution(gaze.copy(), problem.value(gaze), step)
