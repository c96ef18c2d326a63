"""Renders a head by ray casting on the CPU, without GPU or GL library (embree through embreex).

One ray per pixel of the tiles that the head covers, and four more where part, depth or brightness change. Normals and
colours are interpolated over each face. Eyeballs lie behind the lids, so they are visible only through the opening, in
the shadow of the upper lid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Num, UInt8
from numpy import ndarray
from scipy.sparse import csr_array

from talkingeyes.core.motion import Motion
from talkingeyes.head.model import PARTS, HeadModel
from talkingeyes.head.normals import incidence_matrix, normals_from_incidence
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.rendering.shading import BACKGROUND, EYE, GLOSSY, MATT, specular_highlights, to_pixels, vertex_light
from talkingeyes.rendering.view import OrbitCamera

BLOCK_FRAMES = 16
DEPTH_STEP_M = 0.004  # depth difference of adjacent pixels that is supersampled
LIGHT_STEP = 0.06  # brightness difference that is supersampled
TILE_PX = 16
MARGIN = 0.25  # of the picture's size, beyond its edges: faces outside may still cast a shadow on an eye
SUBPIXEL_OFFSETS = np.array(
    [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]], np.float32
)  # rotated grid
SHADOW_RAYS = np.array([[-0.35, 0.75, 0.60], [0.10, 0.85, 0.52], [-0.15, 0.60, 0.78], [0.30, 0.65, 0.70]], np.float32)
SHADOW_RAYS /= np.linalg.norm(SHADOW_RAYS, axis=1, keepdims=True)
SHADOW_STRENGTH = 0.45  # fraction of the lamps' light lost if all of SHADOW_RAYS are blocked
BACKGROUND_DEPTH_M = 1e4


@dataclass(frozen=True)
class RayHits:
    """Results of rays: light, part (-1: none) and distance."""

    light: Float[ndarray, "N 3"]
    parts: Int[ndarray, " N"]
    depth_m: Float[ndarray, " N"]


@dataclass(frozen=True)
class HeadRenderer:
    """Renders one head from one view; caches data that is constant over frames."""

    model: HeadModel
    view: OrbitCamera

    @cached_property
    def _around(self) -> csr_array:
        return incidence_matrix(self.model.faces, len(self.model.template))

    @cached_property
    def _brows(self) -> Int[ndarray, " N"]:
        return self.model.vertices_of("brow")

    @cached_property
    def matt(self) -> Bool[ndarray, " V"]:
        """Vertices of parts without subsurface scattering."""
        matt = np.zeros(len(self.model.template), bool)
        matt[self.model.vertices_of(*(part for part, is_matt in zip(PARTS, MATT, strict=True) if is_matt))] = True
        return matt

    @cached_property
    def _pixels(self) -> Float[ndarray, "H W 2"]:
        camera = self.view.camera
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        return np.stack([columns, rows], axis=-1).astype(np.float32) + np.float32(0.5)

    @cached_property
    def _rays(self) -> Float[ndarray, "H W 3"]:
        height, width = self._pixels.shape[:2]
        return self.view.rays(self._pixels.reshape(-1, 2)).astype(np.float32).reshape(height, width, 3)

    def draw(self, motion: Motion) -> Iterator[UInt8[ndarray, "H W 3"]]:
        """Yield one image per frame."""
        from talkingeyes.head.skinning import posed_vertices

        for start in range(0, len(motion), BLOCK_FRAMES):
            vertices = posed_vertices(self.model, motion_to_pose(self.model, motion.cut(start, start + BLOCK_FRAMES)))
            normals = normals_from_incidence(vertices, self.model.faces, self._around)
            if len(self._brows):  # a strip of hair is shaded like the skin under it
                normals[:, self._brows] = self.model.brows.of(normals)
            for frame, frame_normals in zip(vertices, normals, strict=True):
                yield self.render_frame(frame, frame_normals.astype(np.float32))

    def render_frame(self, vertices: Float[ndarray, "V 3"], normals: Float[ndarray, "V 3"]) -> UInt8[ndarray, "H W 3"]:
        """Render one frame."""
        camera = self.view.camera
        picture = np.empty((camera.height, camera.width, 3), np.uint8)
        picture[:] = to_pixels(BACKGROUND)
        places = self.view.project(vertices)
        caster = RayCaster.of(self, vertices, normals, places)
        covered = covered_tiles(caster.places, caster.faces, camera.height, camera.width)
        if not covered.any():
            return picture
        rows, columns = (np.flatnonzero(covered.any(axis=axis)) for axis in (1, 0))
        box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        inside = covered[box]
        light = np.empty((*inside.shape, 3), np.float32)
        parts, depth_m = np.full(inside.shape, -1), np.full(inside.shape, BACKGROUND_DEPTH_M)
        light[:] = BACKGROUND
        seen = caster.trace(self._rays[box][inside])
        light[inside], parts[inside], depth_m[inside] = seen.light, seen.parts, seen.depth_m
        edges = edge_mask(light, parts, depth_m)
        finer = (self._pixels[box][edges][:, None] + SUBPIXEL_OFFSETS).reshape(-1, 2)
        light[edges] = (
            caster.trace(self.view.rays(finer).astype(np.float32))
            .light.reshape(-1, len(SUBPIXEL_OFFSETS), 3)
            .mean(axis=1)
        )
        picture[box] = to_pixels(light)
        return picture


@dataclass(frozen=True)
class RayCaster:
    """Geometry and light of one frame, ready for ray casting. `faces` are those towards the camera, in its picture."""

    scene: Any
    origin: Float[ndarray, " 3"]
    faces: Int[ndarray, "F 3"]
    parts: Int[ndarray, " F"]
    light: Float[ndarray, "V 3"]  # from sky and lamps
    lamps: Float[ndarray, "V 3"]  # the part of it that shadows take
    normals: Float[ndarray, "V 3"]
    places: Float[ndarray, "V 2"]  # in the picture

    @classmethod
    def of(
        cls,
        renderer: HeadRenderer,
        vertices: Float[ndarray, "V 3"],
        normals: Float[ndarray, "V 3"],
        places: Float[ndarray, "V 2"],
    ) -> RayCaster:
        """`places`: the vertices in the picture."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        model, origin = renderer.model, renderer.view.origin.astype(np.float32)
        x, y = places[:, 0][model.faces], places[:, 1][model.faces]
        (x0, x1, x2), (y0, y1, y2) = x.T, y.T
        camera = renderer.view.camera
        shown = (x1 - x0) * (y2 - y0) < (x2 - x0) * (y1 - y0)  # y points down in the picture
        for low, high, size in ((*_range(x0, x1, x2), camera.width), (*_range(y0, y1, y2), camera.height)):
            shown &= (high > -MARGIN * size) & (low < (1 + MARGIN) * size)
        seen = model.faces[shown]
        used = np.zeros(len(vertices), bool)
        used[seen] = True
        faces = (np.cumsum(used, dtype=np.int32) - 1)[seen]
        vertices, normals = np.ascontiguousarray(vertices[used]), normals[used]
        scene = EmbreeScene(robust=False)
        TriangleMesh(scene, vertices, faces)
        away = vertices - origin
        view_directions = away / np.sqrt(np.einsum("vd,vd->v", away, away))[:, None]
        light = vertex_light(
            face_viewer(normals, view_directions),
            view_directions,
            model.colours[used],
            model.ambient[used],
            renderer.matt[used],
        )
        whole = light.sky + light.lamps
        return cls(scene, origin, faces, model.parts[shown], whole, light.lamps, normals, places[used])

    def trace(self, rays: Float[ndarray, "N 3"]) -> RayHits:
        """Trace rays from the camera."""
        met = self.scene.run(np.tile(self.origin, (len(rays), 1)), rays, output=True)
        hit = np.flatnonzero(met["primID"] >= 0)
        light = np.empty((len(rays), 3), np.float32)
        light[:] = BACKGROUND
        parts = np.full(len(rays), -1)
        if len(hit):
            prim, u, v = met["primID"][hit], met["u"][hit], met["v"][hit]
            corners, weights = self.faces[prim], (1 - u - v, u, v)
            parts[hit] = part = self.parts[prim]
            shown = interpolate_vertices(self.light, corners, weights)
            glossy = np.flatnonzero(GLOSSY[part])
            if len(glossy):
                view_directions = rays[hit[glossy]]
                corners, weights = corners[glossy], tuple(weight[glossy] for weight in weights)
                normals = interpolate_vertices(self.normals, corners, weights)
                lit = self._lit(self.origin + met["tfar"][hit[glossy], None] * view_directions, part[glossy])
                shine = specular_highlights(face_viewer(normals, view_directions), view_directions, part[glossy])
                shadow = (1 - lit)[:, None] * interpolate_vertices(self.lamps, corners, weights)
                shown[glossy] += (lit * shine)[:, None] - shadow
            light[hit] = shown
        return RayHits(light, parts, np.where(parts >= 0, met["tfar"], np.float32(BACKGROUND_DEPTH_M)))

    def _lit(self, points: Float[ndarray, "N 3"], parts: Int[ndarray, " N"]) -> Float[ndarray, " N"]:
        """Fraction of the lamps' light at each point: lids and brows cast shadows on the eyes."""
        lit = np.ones(len(points), np.float32)
        eyes = np.flatnonzero(EYE[parts])
        if len(eyes):
            starts = np.repeat(points[eyes], len(SHADOW_RAYS), axis=0) + np.tile(0.0005 * SHADOW_RAYS, (len(eyes), 1))
            cut = self.scene.run(starts, np.tile(SHADOW_RAYS, (len(eyes), 1)), query="OCCLUDED")
            lit[eyes] = 1 - SHADOW_STRENGTH * (cut.reshape(len(eyes), -1) >= 0).mean(axis=1)
        return lit


def _range(
    first: Num[ndarray, " N"], second: Num[ndarray, " N"], third: Num[ndarray, " N"]
) -> tuple[Num[ndarray, " N"], Num[ndarray, " N"]]:
    """The least and the greatest of three; faster than a reduction over so short an axis."""
    return np.minimum(np.minimum(first, second), third), np.maximum(np.maximum(first, second), third)


def covered_tiles(
    places: Float[ndarray, "V 2"], faces: Int[ndarray, "F 3"], height: int, width: int
) -> Bool[ndarray, "H W"]:
    """Pixels of the tiles that the boxes around the faces meet."""
    columns, rows = -(-width // TILE_PX) + 1, -(-height // TILE_PX) + 1
    tiles = np.floor(places / TILE_PX).astype(np.int32)
    (left, right), (top, bottom) = (_range(*tiles[:, axis][faces].T) for axis in range(2))
    left, right = np.clip(left, 0, columns - 1), np.clip(right + 1, 0, columns - 1)
    top, bottom = np.clip(top, 0, rows - 1) * columns, np.clip(bottom + 1, 0, rows - 1) * columns
    count = np.zeros(rows * columns, int)  # its sums over rows and columns are the number of boxes over each tile
    for corner, sign in ((top + left, 1), (top + right, -1), (bottom + left, -1), (bottom + right, 1)):
        count += sign * np.bincount(corner, minlength=rows * columns)
    met = count.reshape(rows, columns).cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
    return np.repeat(np.repeat(met, TILE_PX, axis=0), TILE_PX, axis=1)[:height, :width]


def interpolate_vertices(
    values: Float[ndarray, "V C"], corners: Int[ndarray, "N 3"], weights: tuple[Float[ndarray, " N"], ...]
) -> Float[ndarray, "N C"]:
    """Interpolate vertex values at points of faces."""
    total: ndarray = np.take(values, corners[:, 0], axis=0) * weights[0][:, None]
    for corner in (1, 2):
        total += np.take(values, corners[:, corner], axis=0) * weights[corner][:, None]
    return total


def face_viewer(normals: Float[ndarray, "N 3"], view_directions: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    """Unit normals bent towards the viewer where interpolation turned them away; flipping would draw black rims."""
    away = np.maximum(np.einsum("nd,nd->n", normals, view_directions), 0.0)
    bent = normals - away[:, None] * view_directions
    return np.asarray(bent / np.sqrt(np.maximum(np.einsum("nd,nd->n", bent, bent), 1e-12))[:, None])


def edge_mask(
    light: Float[ndarray, "H W 3"], parts: Int[ndarray, "H W"], depth_m: Float[ndarray, "H W"]
) -> Bool[ndarray, "H W"]:
    """Pixels that differ from a neighbour in part, depth or brightness; not within hair."""
    edges = np.zeros(parts.shape, bool)
    hair = parts == PARTS.index("hair")
    kinds = np.where(parts == PARTS.index("brow"), PARTS.index("skin"), parts)  # brows fade into skin
    green = np.sqrt(np.maximum(light[..., 1], 0.0))
    for first, second in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        step = kinds[first] != kinds[second]
        step |= np.abs(depth_m[first] - depth_m[second]) > DEPTH_STEP_M
        step |= np.abs(green[first] - green[second]) > LIGHT_STEP
        step &= ~(hair[first] & hair[second])  # as fine as the pixels: more rays would not smooth it
        edges[first] |= step
        edges[second] |= step
    return edges
