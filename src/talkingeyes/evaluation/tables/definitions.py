"""Definitions of the reproduced tables of TalkingEyes: rows, columns, and the paper's numbers (on TKED-Test).

A row is a model of conf/experiment/table3, table5, table6 or table7. A model is the same row in every table; the
paper's own model is a row of all four. Columns of Tables III and V: section V-B; of VI and VII: section V-D.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A column: heading, metric (part/name as in `row_metrics.py`) and number of decimals."""

    heading: str
    metric: str
    digits: int = 3


@dataclass(frozen=True)
class PaperTable:
    """A table: its columns, and its rows in order with the paper's numbers (None: not in the paper)."""

    title: str
    question: str
    paper_columns: tuple[Column, ...]  # the paper's columns
    extra_columns: tuple[Column, ...]  # additional columns, not in the paper
    rows: Mapping[str, tuple[float, ...] | None]


EYE_COLUMNS = (Column("Div. eyes", "gaze/diversity"), Column("Corr. eyes", "gaze/corr"), Column("L2 eyes", "gaze/l2"))
HEAD_AND_EYE_COLUMNS = (
    Column("Div. head", "head/diversity"),
    Column("Div. eyes", "gaze/diversity"),
    Column("Corr. head", "head/corr"),
    Column("Corr. eyes", "gaze/corr"),
    Column("L2 head", "head/l2"),
    Column("L2 eyes", "gaze/l2"),
)
# Amount of motion, part of every table: the other metrics do not reveal frozen motion.
MOTION_COLUMNS = (
    Column("Div. eyes / truth", "gaze/diversity_ratio", 2),
    Column("eye speed °/s", "gaze/speed", 1),
    Column("still frames, eyes", "gaze/still_fraction", 2),
    Column("still, gaze in space", "gaze_in_space/still_fraction", 2),
)
RANGE_COLUMNS = (
    Column("range of head / truth", "head/range_ratio", 2),
    Column("range of eyes / truth", "gaze/range_ratio", 2),
)
HIGH_FREQUENCY_COLUMNS = (
    Column("head above 5 Hz °/s", "head/speed_above_5hz", 2),
    Column("fraction of its power", "head/power_fraction_above_5hz"),
    Column("eyes above 5 Hz °/s", "gaze/speed_above_5hz", 2),
    Column("fraction of their power", "gaze/power_fraction_above_5hz"),
)
PUBLISHED_TALKINGEYES = (0.05143, 0.26398, 0.51913, 0.60435, 0.22731, 0.26570)

TABLES = {
    "table3": PaperTable(
        title="Table III: methods",
        question="Is the paper's model more diverse than the baselines, with higher Corr.?",
        paper_columns=EYE_COLUMNS,
        extra_columns=(*MOTION_COLUMNS, Column("Corr. gaze in space", "gaze_in_space/corr")),
        rows={
            "mean": (0.0, 0.45685, 0.17162),
            "random": (0.23383, 0.49117, 0.23989),
            "similar": (0.06170, 0.57849, 0.23479),
            "vae": (0.06655, 0.45796, 0.17887),
            "canonical_correlation": None,
            "talkingeyes_paper": (0.26398, 0.60435, 0.26570),
            "talkingeyes_events": None,
        },
    ),
    "table5": PaperTable(
        title="Table V, with Table II as ranges: VAE or VQ-VAE",
        question="Does a VAE suit the head and a VQ-VAE the eyes?",
        paper_columns=HEAD_AND_EYE_COLUMNS,
        extra_columns=(*RANGE_COLUMNS, *MOTION_COLUMNS),
        rows={
            "vae": (0.09645, 0.06655, 0.52148, 0.45796, 0.23699, 0.17887),
            "talkingeyes_paper": PUBLISHED_TALKINGEYES,
            "vqvae_head": (0.29852, 0.25439, 0.45164, 0.59900, 0.40460, 0.26225),
            "vqvae_head_vae_gaze": None,
        },
    ),
    "table6": PaperTable(
        title="Table VI: terms of the loss",
        question="What are the effects of the velocity loss and the feature regularity?",
        paper_columns=HEAD_AND_EYE_COLUMNS,
        extra_columns=(*HIGH_FREQUENCY_COLUMNS, *MOTION_COLUMNS),
        rows={
            "without_velocity": (0.05086, 0.24881, 0.48854, 0.59182, 0.22873, 0.26941),
            "without_regularity": (0.00434, 0.0, 0.35083, 0.45581, 0.48944, 0.19682),
            "talkingeyes_paper": PUBLISHED_TALKINGEYES,
        },
    ),
    "table7": PaperTable(
        title="Table VII: number of codes",
        question="How many codes of gaze are enough?",
        paper_columns=HEAD_AND_EYE_COLUMNS,
        extra_columns=MOTION_COLUMNS,
        rows={
            "codes_2048": (0.05119, 0.26278, 0.54150, 0.60268, 0.22990, 0.27397),
            "talkingeyes_paper": PUBLISHED_TALKINGEYES,
            "codes_512": (0.04966, 0.27578, 0.53699, 0.59932, 0.22959, 0.27345),
            "codes_256": (0.05027, 0.31291, 0.52527, 0.58959, 0.22762, 0.32000),
        },
    ),
}
# Rows of real motion, in every table.
REFERENCES = ("truth", "fitted", "mismatched")
TITLES = {
    "truth": "Truth",
    "fitted": "Fitted motion",
    "mismatched": "Mismatched motion",
    "mean": "Mean",
    "random": "Random",
    "similar": "Similar Sample",
    "vae": "VAE (head: VAE, eyes: VAE)",
    "canonical_correlation": "Canonical correlation (Le et al. 2012)",
    "talkingeyes_paper": "TalkingEyes as written (head: VAE, eyes: VQ-VAE, N = 1,024)",
    "talkingeyes_events": "TalkingEyes, events (default)",
    "vqvae_head": "Head: VQ-VAE, eyes: VQ-VAE",
    "vqvae_head_vae_gaze": "Head: VQ-VAE, eyes: VAE",
    "without_velocity": "without velocity loss",
    "without_regularity": "without feature regularity",
    "codes_2048": "N = 2,048",
    "codes_512": "N = 512",
    "codes_256": "N = 256",
}
