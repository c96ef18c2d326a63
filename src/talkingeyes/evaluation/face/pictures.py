"""Pictures of faces on the open head: how much each vertex moves (ProbTalk3D, Fig. 6), and sheets of frames (its Fig.
5, 7 and 8).

A heat map shows for each vertex the mean or the SD over time of its displacement between consecutive frames, in
millimetres. All maps of a sheet share one scale, from 0 to the 99th percentile of the first row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.face.surface import FaceSurface, frame_blocks
from talkingeyes.head.model import HeadModel
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS

LABEL_PX = 22
# Linear albedo from cool to warm: no, little, much motion.
COOL_COLOUR, MIDDLE_COLOUR, WARM_COLOUR = (
    np.array([0.02, 0.05, 0.30]),
    np.array([0.55, 0.50, 0.30]),
    np.array([0.65, 0.02, 0.01]),
)


@dataclass(frozen=True)
class HeatMap:
    """Mean and SD over time of each vertex's displacement between frames, in millimetres, in the region `face`."""

    mean_mm: Float[ndarray, " N"]
    sd_mm: Float[ndarray, " N"]


def heat_map(surface: FaceSurface, faces: FaceSamples, sample: int = 0) -> HeatMap:
    """Heat map of one sample; zero for a single frame."""
    count, total, squares = 0, np.zeros(len(surface.regions["face"])), np.zeros(len(surface.regions["face"]))
    last: ndarray | None = None
    for frames in frame_blocks(faces.jaw.shape[1]):
        moved = surface.displacement_mm(faces, sample, frames, "face").astype(np.float64)
        joined = moved if last is None else np.concatenate([last, moved])
        way = np.linalg.norm(np.diff(joined, axis=0), axis=-1)
        count, total, squares = count + len(way), total + way.sum(axis=0), squares + np.square(way).sum(axis=0)
        last = moved[-1:]
    mean = total / max(count, 1)
    return HeatMap(mean, np.sqrt(np.maximum(squares / max(count, 1) - np.square(mean), 0.0)))


def heat_map_sheet(surface: FaceSurface, rows: Mapping[str, FaceSamples], size_px: int) -> UInt8[ndarray, "H W 3"]:
    """Sheet of heat maps: one column per row of the table, mean above SD."""
    maps = {name: heat_map(surface, faces) for name, faces in rows.items()}
    first = next(iter(maps.values()))
    lines = []
    for figure, title in (("mean_mm", "mean"), ("sd_mm", "SD")):
        most = max(float(np.quantile(getattr(first, figure), 0.99)), 1e-9)
        tiles = []
        for name, each in maps.items():
            shares = np.zeros(len(surface.model.template))
            shares[surface.regions["face"]] = getattr(each, figure) / most
            painted = replace(surface.model, colours=heat_colours(surface.model, shares))
            tiles.append(with_caption(_still_picture(painted, size_px), f"{name}: {title}, 0 to {most:.2f} mm"))
        lines.append(np.concatenate(tiles, axis=1))
    return np.concatenate(lines, axis=0)


def heat_colours(model: HeadModel, shares: Float[ndarray, " V"]) -> Float[ndarray, "V 3"]:
    """Colours of vertices: skin, lips and brows from cool to warm; eyes, teeth and tongue unchanged."""
    amount = np.clip(shares, 0.0, 1.0)[:, None]
    cool, warm = np.minimum(2 * amount, 1.0), np.maximum(2 * amount - 1, 0.0)
    heated = (1 - warm) * ((1 - cool) * COOL_COLOUR + cool * MIDDLE_COLOUR) + warm * WARM_COLOUR
    colours = model.colours.copy()
    face = model.vertices_of("skin", "lips", "brow")
    colours[face] = heated[face]
    return np.asarray(colours)


def frame_sheet(
    model: HeadModel, rows: Mapping[str, FaceSamples], times_s: Mapping[str, float], size_px: int
) -> UInt8[ndarray, "H W 3"]:
    """Sheet of faces: one line per entry of `rows`, below its name, one column per time, named at the top; the first
    sample of each."""
    lines: list[UInt8[ndarray, "K W 3"]] = []
    for name, faces in rows.items():
        at = [min(round(time_s * faces.fps), faces.jaw.shape[1] - 1) for time_s in times_s.values()]
        still = np.zeros((len(at), 3)), np.zeros((len(at), 2, 3))
        motion = Motion.of(
            faces.fps,
            *still,
            jaw=faces.jaw[0, at],
            expression=np.clip(faces.expression[0, at], 0.0, 1.0),
            expression_names=faces.expression_names,
            head_model=faces.head_model,
        )
        drawn = zip(times_s, _painter(model, size_px).draw(motion), strict=True)
        tiles = [tile if lines else with_caption(tile, column) for column, tile in drawn]
        lines.append(with_caption(np.concatenate(tiles, axis=1), name))
    return np.concatenate(lines, axis=0)


def with_caption(picture: UInt8[ndarray, "H W 3"], text: str) -> UInt8[ndarray, "K W 3"]:
    """The picture with a line of text above it."""
    from PIL import Image, ImageDraw

    height, width, _ = picture.shape
    image = Image.new("RGB", (width, height + LABEL_PX), (255, 255, 255))
    image.paste(Image.fromarray(picture), (0, LABEL_PX))
    ImageDraw.Draw(image).text((4, 4), text, fill=(20, 30, 60))
    return np.asarray(image)


def _still_picture(model: HeadModel, size_px: int) -> UInt8[ndarray, "H W 3"]:
    still = Motion.of(1.0, np.zeros((1, 3)), np.zeros((1, 2, 3)), head_model=model.name)
    return next(_painter(model, size_px).draw(still))


def _painter(model: HeadModel, size_px: int) -> HeadRenderer:
    return HeadRenderer(model, FRAMINGS["face"].centred_on(model.eye_centres).view(size_px, size_px))
