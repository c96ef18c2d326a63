"""Pose-dependent face shape: soft tissue sags with gravity.

    d_v = SAG_M softness_v (R^T g - g)        g = (0, -1, 0), R the head's rotation, d in head coordinates

The open head and the faces of synthetic data have the same shape in every pose, so a model of pose-dependent shape
(PGFace) would have nothing to learn. Its training shapes therefore sag by this rule: not at the brow, most at jowls and
chin. The amount is chosen, not measured: 4 mm with the head turned by 90 degrees, 1.2 mm at 18.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import shape_weights

SAG_M = 0.004
DOWN = np.array([0.0, -1.0, 0.0])
LOWER_FACE_M = 0.035  # distance below the eyes: mouth, cheeks, chin
SAG_NAMES = ("sagX", "sagY", "sagZ")
RIDGE = 1e-4  # of `weights`, relative to the mean square of the directions: some shapes are nearly sums of others


@dataclass(frozen=True)
class FaceSurface:
    """Skin and lips at the front of a head: the V vertices of a face shape."""

    model: HeadModel

    @cached_property
    def vertices(self) -> Int[ndarray, " V"]:
        """Their indices in the head."""
        found = self.model.vertices_of("skin", "lips")
        eyes = self.model.eye_centres.mean(0)
        place = self.model.template[found]
        front = place[:, 2] > eyes[2] - 0.06
        return np.asarray(found[front & (place[:, 1] > eyes[1] - 0.13) & (place[:, 1] < eyes[1] + 0.06)])

    @cached_property
    def below_eyes_m(self) -> Float[ndarray, " V"]:
        """Distance of each vertex below the eyes."""
        return np.asarray(self.model.eye_centres[:, 1].mean() - self.model.template[self.vertices, 1], np.float64)

    @property
    def lower(self) -> ndarray:
        """Whether each vertex belongs to the lower face."""
        return self.below_eyes_m > LOWER_FACE_M

    @cached_property
    def directions(self) -> Float[ndarray, "K V 3"]:
        """Displacements per factor: the head's shapes, then three directions of sagging."""
        softness = np.clip((self.below_eyes_m + 0.01) / 0.09, 0.0, 1.0)
        hanging = SAG_M * np.eye(3)[:, None] * softness[:, None]
        return np.concatenate([self.model.expression[:, self.vertices].astype(np.float64), hanging])

    @cached_property
    def sagging_model(self) -> HeadModel:
        """The head with three more shapes, so that the factors are weights of its shapes."""
        hanging = np.zeros((len(SAG_NAMES), *self.model.template.shape), self.model.expression.dtype)
        hanging[:, self.vertices] = self.directions[-len(SAG_NAMES) :]
        return replace(
            self.model,
            expression=np.concatenate([self.model.expression, hanging]),
            expression_names=(*self.model.expression_names, *SAG_NAMES),
        )

    def factors(self, motion: Motion, head: Float[ndarray, "T 3"]) -> Float[ndarray, "T K"]:
        """Factors of the face of a motion with a given head pose; gaze ahead, lids open."""
        frames = len(motion)
        ahead, open_lids = np.zeros((frames, 2, 3)), np.zeros((frames, 2))
        weights = np.zeros((frames, len(self.model.expression_names)))
        weights[:, [self.model.shape(name) for name in motion.expression_names]] = motion.expression
        for name, column in shape_weights(self.model, ahead, open_lids, motion.jaw).items():
            weights[:, self.model.shape(name)] += column
        towards = np.einsum("tij,i->tj", rotvec_to_matrix(head), DOWN) - DOWN
        return np.concatenate([weights, towards], axis=1)

    def weights(self, shapes: Float[ndarray, "T V 3"]) -> Float[ndarray, "T K"]:
        """The smallest factors of given faces, by ridge regression; they move teeth and tongue with the face."""
        flat = self.directions.reshape(len(self.directions), -1)
        gram = flat @ flat.T
        gram += RIDGE * gram.diagonal().mean() * np.eye(len(gram))
        moved = (shapes - self.model.template[self.vertices]).reshape(len(shapes), -1)
        return np.asarray(np.linalg.solve(gram, flat @ moved.T).T)

    def shapes(self, factors: Float[ndarray, "T K"]) -> Float[ndarray, "T V 3"]:
        """Faces in head coordinates."""
        return np.asarray(self.model.template[self.vertices] + np.tensordot(factors, self.directions, axes=1))
