"""Table 1 of ProbTalk3D as Markdown, next to the paper's numbers, and its Figs. 5 to 8.

The paper labels its columns "x10^-3 mm" and similar; its code computes metres of FLAME and their squares. Read that
way, which gives an LVE of 5 to 18 mm, its numbers appear here in mm and mm2. They come from another corpus (3DMEAD),
head and split: compare the order of rows, not the values.

Figs. 5, 7 and 8 are sheets of frames, Fig. 6 how much each vertex moves, on the open head. A heat map shows for each
vertex the mean or the SD over time of its displacement between consecutive frames, in millimetres. All maps of a sheet
share one scale, from 0 to the 99th percentile of the first row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface, frame_blocks
from talkingeyes.evaluation.papers.table3 import SPLIT_TITLES
from talkingeyes.evaluation.text_tables import Column, markdown_table
from talkingeyes.head.model import HeadModel
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS

# {metric: {value, low, high}} of one row and split; over seeds also {seed_min, seed_max}.
MetricEstimates = Mapping[str, Mapping[str, float]]

TITLES = {
    "truth": "Truth (other takes)",
    "fitted": "Fitted motion (training target)",
    "face_mean": "Mean face",
    "face_emotion_mean": "Mean face of each emotion",
    "face_random": "Random",
    "face_similar": "Similar Sample",
    "face_faceformer": "Regression (FaceFormer)",
    "face_codetalker": "Codes (CodeTalker)",
    "face_codetalker_sampled": "Codes, sampled (CodeTalker-ND)",
    "face_ddpm": "Diffusion, DDPM (FaceDiffuser)",
    "face_ddim": "Diffusion, DDIM",
    "face_vae": "VAE",
    "probtalk3d": "ProbTalk3D",
    "probtalk3d_untied": "ProbTalk3D, a draw for every frame",
    "probtalk3d_channels": "ProbTalk3D, codes over time as released",
    "face_vae_no_emotion": "VAE without emotion control",
    "probtalk3d_no_emotion": "ProbTalk3D without emotion control",
}
# MVE and Diversity in mm; LVE, FDD, MEE and CE in mm2 (metres and square metres in its code). CE, whose column prints
# 1e-5, is read with the 1e-4 of MEE: the two agree for DDIM, whose samples hardly differ (Diversity 0.0009).
PUBLISHED = {
    "face_faceformer": (2.8548, 202.66, 6.59, None, None, None),
    "face_codetalker": (1.7121, 159.78, 20.36, None, None, None),
    "face_codetalker_sampled": (3.4783, 313.25, 30.89, 315.93, 302.05, 0.1696),
    "face_ddpm": (1.3242, 89.38, 9.06, 88.48, 87.84, 0.0449),
    "face_ddim": (0.9334, 44.40, 6.25, 44.40, 44.38, 0.0009),
    "face_vae": (0.6959, 56.73, 0.10, 56.57, 55.50, 0.0722),
    "probtalk3d": (0.7243, 60.40, 4.15, 55.49, 52.27, 0.3274),
    "face_vae_no_emotion": (1.3357, 145.76, 10.22, 145.29, 141.10, 0.1158),
    "probtalk3d_no_emotion": (0.7799, 57.94, 5.79, 53.23, 49.89, 0.3136),
}
PAPER_COLUMNS = ("MVE", "LVE²", "FDD", "MEE²", "CE²", "Div.")


ERROR_COLUMNS = (
    Column("MVE mm", "mve", 3),
    Column("LVE mm", "lve", 2),
    Column("LVE² mm²", "lve_squared", 1),
    Column("FDD mm²", "fdd_signed", 2),
    Column("abs. FDD", "fdd_absolute", 2),
    Column("MEE mm", "mee", 2),
    Column("MEE² mm²", "mee_squared", 1),
    Column("CE mm", "ce", 2),
    Column("CE² mm²", "ce_squared", 1),
    Column("Div. mm", "diversity", 3),
    Column("Div. ratio to truth", "diversity_ratio", 2),
)
ARTICULATION_COLUMNS = (
    Column("bilabials closed", "bilabials_closed", 3),
    Column("bilabial lip gap mm", "bilabial_gap", 2),
    Column("open-vowel lip gap mm", "vowel_gap", 2),
    Column("jaw-envelope correlation", "jaw_envelope", 3),
    Column("emotion accuracy", "emotion_accuracy", 3),
)


def face_markdown(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Both tables of each split; `rows` {row: {split: {"face": metrics}}}. Rows without a face are left out."""
    lines: list[str] = []
    for split, title in SPLIT_TITLES.items():
        here = {name: row[split]["face"] for name, row in rows.items() if "face" in row.get(split, {})}
        if not here:
            continue
        lines += [f"### {title}", ""]
        lines += [_table(here, ERROR_COLUMNS, with_paper=True), ""]
        lines += [_table(here, ARTICULATION_COLUMNS, with_paper=False), ""]
    return "\n".join(lines)


def _table(rows: Mapping[str, MetricEstimates], columns: Sequence[Column], with_paper: bool) -> str:
    headings = ["", *(column.heading for column in columns)]
    headings += [f"paper: {', '.join(PAPER_COLUMNS)}"] * with_paper
    lines = []
    for name in [*(known for known in TITLES if known in rows), *sorted(set(rows) - set(TITLES))]:
        cells = [_written(rows[name].get(column.metric), column.digits) for column in columns]
        lines.append([TITLES.get(name, name), *cells, *[_of_paper(name)] * with_paper])
    return markdown_table(headings, lines)


def _written(found: Mapping[str, float] | None, digits: int) -> str:
    """Value with its interval over sounds and, with several seeds, their range."""
    if not found:
        return ""
    text = f"{found['value']:.{digits}f} <sub>{found['low']:.{digits}f}–{found['high']:.{digits}f}"
    if found.get("seed_min", 0.0) < found.get("seed_max", 0.0):
        text += f"; seeds {found['seed_min']:.{digits}f}–{found['seed_max']:.{digits}f}"
    return f"{text}</sub>"


def _of_paper(name: str) -> str:
    return ", ".join("–" if value is None else f"{value:.4g}" for value in PUBLISHED[name]) if name in PUBLISHED else ""


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
