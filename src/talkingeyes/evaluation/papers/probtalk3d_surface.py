"""The face as a surface: vertex displacements of a head in millimetres, from jaw and expression only.

Head, eyes and lids stay at rest and the identity is the mean, so that only the face is compared. On the open head, jaw
and expression are blend shapes, and a displacement is a product of weights and shapes; on a head with a jaw joint
(FLAME) the vertices are posed. Regions replace the FLAME masks of the published metrics:
    face   skin, lips and brows; no eyeballs, no inside of the mouth
    lips   the lips; on a head without such a part, the skin around the mouth
    upper  part of `face` in front of the temples and above the middle of the nose
    points the triangle corners of the landmarks
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import jaw_weights, motion_to_pose

MILLIMETRES = 1000.0
BLOCK_FRAMES = 128  # frames in memory at a time
INNER_LIPS = ("upper_lip_inner", "lower_lip_inner")
LIP_POINTS = ("left_mouth_corner", "right_mouth_corner", "upper_lip", "lower_lip")
AROUND_LIPS_M = 0.004


@dataclass(frozen=True)
class FaceSurface:
    """A head as a face surface. The head needs landmarks (`regions` raises InputError without them)."""

    model: HeadModel

    @cached_property
    def linear(self) -> bool:
        """Whether vertices are linear in the weights of jaw and expression."""
        return bool(self.model.jaw_open_rad) and not len(self.model.correctives)

    @cached_property
    def regions(self) -> dict[str, Int[ndarray, " N"]]:
        """Vertex indices by region. Raises InputError for a head without landmarks."""
        face = self.model.vertices_of("skin", "lips", "brow")
        place = self.model.template[face]
        nose, eye = self._rest(("nose_middle", "left_eye_outer"))
        lips = self.model.vertices_of("lips")
        return {
            "face": face,
            "lips": lips if len(lips) else face[self._around_lips(place)],
            "points": self.model.landmarks.corners.ravel(),
            "upper": face[(place[:, 1] > nose[1]) & (place[:, 2] > eye[2] / 2)],
        }

    @cached_property
    def upper_face_index(self) -> Int[ndarray, " N"]:
        """Positions of the vertices of region `upper` within region `face`."""
        return np.searchsorted(self.regions["face"], self.regions["upper"])

    def displacement_mm(self, faces: FaceSamples, sample: int, frames: slice, region: str) -> Float[ndarray, "T N 3"]:
        """Displacements from rest of the vertices of a region in some frames of one sample (single precision).

        Raises InputError if the expression belongs to another head.
        """
        if self.linear:
            weights = self._weights(faces, sample, frames)
            return np.asarray((weights @ self._shapes_mm[region]).reshape(len(weights), -1, 3))
        moved = self._posed(faces, sample, frames) - self._neutral
        return np.asarray(MILLIMETRES * moved[:, self.regions[region]], np.float32)

    def landmarks_mm(self, faces: FaceSamples, sample: int) -> Float[ndarray, "T L 3"]:
        """Displacements of the landmarks from rest, in all frames of one sample."""
        points = self.model.landmarks
        found = [np.zeros((0, len(points.names), 3))]
        for frames in frame_blocks(faces.jaw.shape[1]):
            moved = self.displacement_mm(faces, sample, frames, "points")
            corners = moved.reshape(len(moved), *points.corners.shape, 3)
            found.append(np.einsum("tlcd,lc->tld", corners, points.barycentric))
        return np.concatenate(found)

    def lip_gap_mm(self, faces: FaceSamples, sample: int) -> Float[ndarray, " T"]:
        """Vertical gap between the inner rims of the lips in the middle, relative to rest."""
        upper, lower = self._indices(INNER_LIPS)
        heights = self.landmarks_mm(faces, sample)[..., 1]
        return np.asarray(heights[:, upper] - heights[:, lower])

    @cached_property
    def _shapes_mm(self) -> dict[str, Float[ndarray, "E N3"]]:
        """Displacements of each region by each expression shape."""
        shapes, count = MILLIMETRES * self.model.expression, len(self.model.expression)
        return {
            name: shapes[:, chosen].reshape(count, 3 * len(chosen)).astype(np.float32)
            for name, chosen in self.regions.items()
        }

    def _weights(self, faces: FaceSamples, sample: int, frames: slice) -> Float[ndarray, "T E"]:
        """Weights of all shapes, including those that open the jaw."""
        if faces.head_model != self.model.name:
            raise InputError(f"face: should be of the head {self.model.name}, got {faces.head_model}")
        expression, jaw = faces.expression[sample, frames], faces.jaw[sample, frames]
        weights = np.zeros((len(jaw), len(self.model.expression_names)), np.float32)
        weights[:, [self.model.shape(name) for name in faces.expression_names]] = expression
        for name, column in jaw_weights(jaw, self.model.jaw_open_rad).items():
            weights[:, self.model.shape(name)] = column
        return weights

    def _posed(self, faces: FaceSamples, sample: int, frames: slice) -> Float[ndarray, "T V 3"]:
        from talkingeyes.head.skinning import posed_vertices

        jaw = faces.jaw[sample, frames]
        motion = Motion.of(
            faces.fps,
            np.zeros((len(jaw), 3)),
            np.zeros((len(jaw), 2, 3)),
            jaw=jaw,
            expression=faces.expression[sample, frames],
            expression_names=faces.expression_names,
            head_model=faces.head_model,
        )
        return posed_vertices(self.model, motion_to_pose(self.model, motion))

    @cached_property
    def _neutral(self) -> Float[ndarray, "V 3"]:
        still = FaceSamples(1.0, np.zeros((1, 1, 3)), np.zeros((1, 1, 0)), (), self.model.name)
        return np.asarray(self._posed(still, 0, slice(None))[0])

    def _around_lips(self, place: Float[ndarray, "N 3"]) -> ndarray:
        points = self._rest(LIP_POINTS)
        low, high = points.min(axis=0) - AROUND_LIPS_M, points.max(axis=0) + AROUND_LIPS_M
        return np.asarray(((place > low) & (place < high)).all(axis=1))

    def _rest(self, names: tuple[str, ...]) -> Float[ndarray, "L 3"]:
        return self.model.landmarks.of(self.model.template)[self._indices(names)]

    def _indices(self, names: tuple[str, ...]) -> list[int]:
        known = self.model.landmarks.names
        missing = [name for name in names if name not in known]
        if missing:
            raise InputError(f"head {self.model.name}: should have the landmark {missing[0]}, got none")
        return [known.index(name) for name in names]


def frame_blocks(frames: int) -> Iterator[slice]:
    """Slices that cover all frames in blocks, so that memory does not grow with the clip."""
    for start in range(0, frames, BLOCK_FRAMES):
        yield slice(start, min(start + BLOCK_FRAMES, frames))
