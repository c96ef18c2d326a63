"""Definitions of the reproduced tables of TalkingEyes: rows, columns, and the paper's numbers (on TKED-Test).

A row is a model of conf/experiment/paper_tables.yaml. A model is the same row in every table. Each row whose features
are regressed, as in the paper, has a partner whose codes of gaze are sampled in sequence. Columns of Tables III and V:
section V-B; of VI and VII: section V-D.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from talkingeyes.evaluation.text_tables import Column

# The two families of rows.
REGRESSED, SEQUENCE = "regressed", "sequence"
FAMILIES = {REGRESSED: "features regressed", SEQUENCE: "codes in sequence"}


@dataclass(frozen=True)
class PaperTable:
    """A table: its columns, and its rows in order with the paper's numbers (None: not in the paper).

    `partners`: from a row with regressed features to its row with codes in sequence (None: the term or part does not
    exist there). A row of the paper without an entry is a baseline, which both families share.
    """

    title: str
    question: str
    paper_columns: tuple[Column, ...]  # the paper's columns
    extra_columns: tuple[Column, ...]  # additional columns, not in the paper
    rows: Mapping[str, tuple[float, ...] | None]
    partners: Mapping[str, str | None]

    @property
    def columns(self) -> tuple[Column, ...]:
        """All columns, the paper's first."""
        return (*self.paper_columns, *self.extra_columns)

    def row_of(self, family: str, row: str) -> str | None:
        """The row of a family that stands for a row of the paper; None if it has none."""
        return row if family == REGRESSED else self.partners.get(row, row)


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
            "talkingeyes_paper": (0.26398, 0.60435, 0.26570),
            "sequence": None,
            "talkingeyes": None,
            "talkingeyes_events": None,
        },
        partners={"talkingeyes_paper": "sequence"},
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
            "sequence_vae_gaze": None,
            "sequence": None,
            "sequence_vqvae_head": None,
        },
        partners={
            "vae": "sequence_vae_gaze",
            "talkingeyes_paper": "sequence",
            "vqvae_head": "sequence_vqvae_head",
        },
    ),
    "table6": PaperTable(
        title="Table VI: terms of the loss",
        question="What are the effects of the velocity loss and the feature regularity? Codes in sequence have a "
        "velocity loss of the head only, and no feature regularity.",
        paper_columns=HEAD_AND_EYE_COLUMNS,
        extra_columns=(*HIGH_FREQUENCY_COLUMNS, *MOTION_COLUMNS),
        rows={
            "without_velocity": (0.05086, 0.24881, 0.48854, 0.59182, 0.22873, 0.26941),
            "without_regularity": (0.00434, 0.0, 0.35083, 0.45581, 0.48944, 0.19682),
            "talkingeyes_paper": PUBLISHED_TALKINGEYES,
            "sequence_without_velocity": None,
            "sequence": None,
        },
        partners={
            "without_velocity": "sequence_without_velocity",
            "without_regularity": None,
            "talkingeyes_paper": "sequence",
        },
    ),
    "table7": PaperTable(
        title="Table VII: number of codes",
        question="How many codes of gaze are enough? Each training seed has codebooks of its own seed.",
        paper_columns=HEAD_AND_EYE_COLUMNS,
        extra_columns=MOTION_COLUMNS,
        rows={
            "regressed_2048": (0.05119, 0.26278, 0.54150, 0.60268, 0.22990, 0.27397),
            "regressed_1024": PUBLISHED_TALKINGEYES,
            "regressed_512": (0.04966, 0.27578, 0.53699, 0.59932, 0.22959, 0.27345),
            "regressed_256": (0.05027, 0.31291, 0.52527, 0.58959, 0.22762, 0.32000),
            "sequence_2048": None,
            "sequence_1024": None,
            "sequence_512": None,
            "sequence_256": None,
        },
        partners={f"regressed_{codes}": f"sequence_{codes}" for codes in (2048, 1024, 512, 256)},
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
    "similar": "Similar Sample (the most similar, as in the paper)",
    "vae": "VAE (head: VAE, eyes: VAE)",
    "talkingeyes_paper": "TalkingEyes, features regressed (head: VAE, eyes: VQ-VAE, N = 1,024)",
    "talkingeyes": "TalkingEyes (codes in sequence)",
    "talkingeyes_events": "TalkingEyes, events (default of animate)",
    "vqvae_head": "Head: VQ-VAE, eyes: VQ-VAE",
    "without_velocity": "Without velocity loss",
    "without_regularity": "Without feature regularity",
    "regressed_2048": "N = 2,048",
    "regressed_1024": "N = 1,024",
    "regressed_512": "N = 512",
    "regressed_256": "N = 256",
    "sequence": "Codes in sequence (head: VAE, N = 256)",
    "sequence_vae_gaze": "Head of codes in sequence, eyes: VAE",
    "sequence_vqvae_head": "Codes in sequence, head: VQ-VAE",
    "sequence_without_velocity": "Codes in sequence, without velocity loss",
    "sequence_2048": "Codes in sequence, N = 2,048",
    "sequence_1024": "Codes in sequence, N = 1,024",
    "sequence_512": "Codes in sequence, N = 512",
    "sequence_256": "Codes in sequence, N = 256",
}
