"""Pictures of a head by ray casting on the CPU: no GPU, no GL library (embree through embreex).

One ray a pixel inside the box that the head covers, and four more where the picture changes: part, depth or brightness.
Normals and colours are interpolated over each face. Eyeballs stand behind the lids, so they are seen through the
opening alone, in the shadow of the upper lid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray
from scipy.sparse import csr_array

from talkingeyes.head.drive import pose_of
from talkingeyes.head.model import HeadModel
from talkingeyes.head.normals import incidence, summed
from talkingeyes.head.shading import BACKGROUND, EYE, Surface, shade, to_pixels
from talkingeyes.head.view import View
from talkingeyes.motion import Motion

BLOCK_FRAMES = 16
DEPTH_STEP_M = 0.004  # between neighbouring pixels, from which an edge is drawn more finely ...
LIGHT_STEP = 0.06  # ... and of light
CORNERS = np.array([[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]], np.float32)  # rotated grid
SHADOW_RAYS = np.array([[-0.35, 0.75, 0.60], [0.10, 0.85, 0.52], [-0.15, 0.60, 0.78], [0.30, 0.65, 0.70]], np.float32)
SHADOW = 0.6  # of the lamps' light, where all of SHADOW_RAYS are cut off
AWAY = 1e4


@dataclass(frozen=True)
class Seen:
    """What rays met: light, part (-1 nothing) and distance."""

    light: Float[ndarray, "N 3"]
    parts: Int[ndarray, " N"]
    depth_m: Float[ndarray, " N"]


@dataclass(frozen=True)
class Painter:
    """Draws one head; what stays the same from frame to frame is kept."""

    model: HeadModel
    view: View

    @cached_property
    def _around(self) -> csr_array:
        return incidence(self.model.faces, len(self.model.template))

    @cached_property
    def _grid(self) -> Float[ndarray, "H W 2"]:
        camera = self.view.camera
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        return np.stack([columns, rows], axis=-1).astype(np.float32) + 0.5

    def draw(self, motion: Motion) -> Iterator[UInt8[ndarray, "H W 3"]]:
        """A picture a frame."""
        from talkingeyes.head.skinning import posed

        for start in range(0, len(motion), BLOCK_FRAMES):
            vertices = posed(self.model, pose_of(self.model, motion.cut(start, start + BLOCK_FRAMES)))
            normals = summed(vertices, self.model.faces, self._around)
            if len(self.model.brows.corners):  # a strip of hair shows the form of the skin under it
                normals[:, self.model.vertices_of("brow")] = self.model.brows.of(normals)
            for frame, frame_normals in zip(vertices, normals, strict=True):
                yield to_pixels(self.light(frame, frame_normals))

    def light(self, vertices: Float[ndarray, "V 3"], normals: Float[ndarray, "V 3"]) -> Float[ndarray, "H W 3"]:
        """Linear light of one frame."""
        camera = self.view.camera
        picture = np.empty((camera.height, camera.width, 3), np.float32)
        picture[:] = BACKGROUND
        box = self._box(vertices)
        pixels = self._grid[box]
        if not pixels.size:
            return picture
        caster = Caster.of(self.model, self.view, vertices, normals)
        shape = pixels.shape[:2]
        seen = caster.see(pixels.reshape(-1, 2))
        light = seen.light.reshape(*shape, 3)
        rough = changing(light, seen.parts.reshape(shape), seen.depth_m.reshape(shape))
        finer = pixels[rough][:, None] + CORNERS
        light[rough] = caster.see(finer.reshape(-1, 2)).light.reshape(-1, len(CORNERS), 3).mean(axis=1)
        picture[box] = light
        return picture

    def _box(self, vertices: Float[ndarray, "V 3"]) -> tuple[slice, slice]:
        """Rows and columns that the head may cover."""
        camera = self.view.camera
        places = self.view.project(vertices)
        low, high = np.floor(places.min(axis=0)).astype(int) - 1, np.ceil(places.max(axis=0)).astype(int) + 1
        return slice(max(low[1], 0), min(high[1], camera.height)), slice(max(low[0], 0), min(high[0], camera.width))


@dataclass(frozen=True)
class Caster:
    """One frame's geometry, ready for rays."""

    model: HeadModel
    view: View
    scene: object
    attributes: Float[ndarray, "V 7"]  # normal, colour, ambient

    @classmethod
    def of(
        cls, model: HeadModel, view: View, vertices: Float[ndarray, "V 3"], normals: Float[ndarray, "V 3"]
    ) -> Caster:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(vertices, np.float32), model.faces)
        attributes = np.concatenate([normals, model.colours, model.ambient[:, None]], axis=1, dtype=np.float32)
        return cls(model, view, scene, attributes)

    def see(self, pixels: Float[ndarray, "N 2"]) -> Seen:
        """What pixels show."""
        rays = self.view.rays(pixels).astype(np.float32)
        origin = self.view.origin.astype(np.float32)
        met = self.scene.run(np.broadcast_to(origin, rays.shape).copy(), rays, output=True)  # type: ignore[attr-defined]
        hit = np.flatnonzero(met["primID"] >= 0)
        light = np.empty((len(rays), 3), np.float32)
        light[:] = BACKGROUND
        parts = np.full(len(rays), -1)
        if len(hit):
            faces, u, v = met["primID"][hit], met["u"][hit], met["v"][hit]
            parts[hit] = self.model.parts[faces]
            weights = np.stack([1 - u - v, u, v], axis=-1)
            values = np.einsum("nkc,nk->nc", self.attributes[self.model.faces[faces]], weights)
            looking = rays[hit]
            surface = Surface(
                normals=facing(values[:, :3], looking),
                looking=looking,
                colours=values[:, 3:6],
                sky=values[:, 6],
                lit=self._lit(origin + met["tfar"][hit, None] * looking, parts[hit]),
                parts=parts[hit],
            )
            light[hit] = shade(surface)
        return Seen(light, parts, np.where(parts >= 0, met["tfar"], AWAY))

    def _lit(self, points: Float[ndarray, "N 3"], parts: Int[ndarray, " N"]) -> Float[ndarray, " N"]:
        """The share of the lamps that reaches each point: eyes lie in the shadow of lids and brows."""
        lit = np.ones(len(points), np.float32)
        eyes = np.flatnonzero(EYE[parts])
        if len(eyes):
            rays = SHADOW_RAYS / np.linalg.norm(SHADOW_RAYS, axis=1, keepdims=True)
            starts = np.repeat(points[eyes], len(rays), axis=0) + np.tile(0.0005 * rays, (len(eyes), 1))
            cut = self.scene.run(starts, np.tile(rays, (len(eyes), 1)), query="OCCLUDED")  # type: ignore[attr-defined]
            lit[eyes] = 1 - SHADOW * (cut.reshape(len(eyes), -1) >= 0).mean(axis=1)
        return lit


def facing(normals: Float[ndarray, "N 3"], looking: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    """Unit normals bent towards the viewer where interpolation turned them away; flipped, they draw black rims."""
    away = np.maximum(np.einsum("nd,nd->n", normals, looking), 0.0)
    bent = normals - away[:, None] * looking
    return np.asarray(bent / np.maximum(np.linalg.norm(bent, axis=1, keepdims=True), 1e-6))


def changing(
    light: Float[ndarray, "H W 3"], parts: Int[ndarray, "H W"], depth_m: Float[ndarray, "H W"]
) -> Bool[ndarray, "H W"]:
    """Pixels that differ from a neighbour in part, depth or brightness."""
    rough = np.zeros(parts.shape, bool)
    green = np.sqrt(np.maximum(light[..., 1], 0.0))
    for first, second in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        step = parts[first] != parts[second]
        step |= np.abs(depth_m[first] - depth_m[second]) > DEPTH_STEP_M
        step |= np.abs(green[first] - green[second]) > LIGHT_STEP
        rough[first] |= step
        rough[second] |= step
    return rough
