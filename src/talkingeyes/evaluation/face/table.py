"""Table 1 of ProbTalk3D as Markdown: face metrics of each row with intervals over sounds, next to the paper's numbers.

The paper labels its columns "x10^-3 mm" and similar; its code computes metres of FLAME and their squares. Read that
way, which gives an LVE of 5 to 18 mm, its numbers appear here in mm and mm2. They come from another corpus (3DMEAD),
head and split: compare the order of rows, not the values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from talkingeyes.evaluation.paper_metrics.table3 import SPLIT_TITLES
from talkingeyes.evaluation.text_tables import Column, markdown_table

# {metric: {value, low, high}} of one row and split; over seeds also {seed_min, seed_max}.
MetricEstimates = Mapping[str, Mapping[str, float]]

TITLES = {
    "truth": "Truth (other takes)",
    "fitted": "Fitted motion (training target)",
    "face_mean": "Mean face",
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
