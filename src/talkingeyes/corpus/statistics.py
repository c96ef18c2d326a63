"""A corpus as a row of the paper's Table I: motion types, sequences, subjects, hours, and sources.

Written to table1.md beside the index, and printed, by every stage that creates a corpus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from talkingeyes.corpus.index import Clip

HEADER = "| corpus | face | head | eyes | sequences | subjects | hours | acquisition | sources |"
PAPER_ROW = "| TKED (the paper's) | ✓ | ✓ | ✓ | 5982 | 669 | 14.0 | generated from video | VoxCeleb2, HDTF |"


@dataclass(frozen=True)
class CorpusStatistics:
    """The entries of Table I for a corpus."""

    sequences: int
    subjects: int
    hours: float
    sources: tuple[str, ...]


def corpus_statistics(clips: Sequence[Clip]) -> CorpusStatistics:
    """Count clips (including all takes), speakers and hours, and list the sources."""
    return CorpusStatistics(
        len(clips),
        len({clip.speaker for clip in clips}),
        sum((clip.seconds for clip in clips), 0.0) / 3600.0,
        tuple(sorted({clip.source for clip in clips})),
    )


def statistics_table(name: str, row: CorpusStatistics, acquisition: str) -> str:
    """The row in Markdown, below that of the paper's corpus. All corpora here contain face, head and eyes."""
    own = f"| {name} | ✓ | ✓ | ✓ | {row.sequences} | {row.subjects} | {row.hours:.3g} | {acquisition} |"
    return "\n".join([HEADER, "|" + "---|" * 9, PAPER_ROW, f"{own} {', '.join(row.sources)} |", ""])
