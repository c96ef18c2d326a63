"""Edits CSV tables in any form (csv_text.py): only the numbers of eyes and head change, every other byte stays.

Live Link Face, ARKit columns of any program, Audio2Face-3D's `animation_frames.csv`, py-feat.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.formats import arkit
from talkingeyes.formats.csv_text import CsvText, open_csv
from talkingeyes.formats.editors.channels import (
    EYE_NAMES,
    AddedEyes,
    angle_channels,
    channel_names,
    eye_channels,
    pyfeat_channels,
)
from talkingeyes.formats.readers.live_link import read_take
from talkingeyes.formats.readers.trackers import pyfeat_rows
from talkingeyes.formats.writers.arkit import DIGITS

PYFEAT_HEAD = ("yaw", "pitch", "roll")
LIVE_LINK_HEAD = tuple(name.lower() for name in arkit.ANGLES[:3])


@dataclass(frozen=True)
class TableFile:
    """A table, the names of its columns, the frame of each row, and which rows have values."""

    table: CsvText
    names: tuple[str, ...]
    frames: Int[ndarray, " R"]
    seen: Bool[ndarray, " R"]
    factors: Float[ndarray, " 9"] | None  # of Live Link's angles; None in a table of py-feat

    @property
    def has_head(self) -> bool:
        return set(LIVE_LINK_HEAD if self.factors is not None else PYFEAT_HEAD) <= set(self.names)

    def edited(self, added: AddedEyes) -> bytes:
        """The file with eyes and head in the rows that have values."""
        wanted = eye_channels(added.motion, self.names)
        wanted |= pyfeat_channels(added.motion) if self.factors is None else angle_channels(added.motion, self.factors)
        kept = () if added.with_head else (*LIVE_LINK_HEAD, *PYFEAT_HEAD)
        lines, table = list(self.table.lines), self.table
        rows = np.array(table.row_lines)[self.seen]
        cells = [table.raw_cells(lines[row]) for row in rows]
        for row, each in zip(rows, cells, strict=True):
            if len(each) < len(self.names):
                raise InputError(f"{table.path}: line {row + 1} should have {len(self.names)} cells, got {len(each)}")
        for place, name in enumerate(self.names) if added.share > 0 else ():
            if name in wanted and name not in kept:
                own, new = np.array([table.number(each[place]) for each in cells]), wanted[name][self.frames[self.seen]]
                mixed = np.where(np.isnan(own), new, added.mixed(own, new))
                for each, value in zip(cells, mixed.tolist(), strict=True):
                    each[place] = table.with_number(each[place], f"{value:.{DIGITS}f}")
        for row, each in zip(rows, cells, strict=True):
            lines[row] = table.delimiter.join(each)
        return self.table.encoded(lines)


def open_table(path: Path, format: str, fps: float | None) -> TableFile:
    """Open a table that `read_motion` read as `format`. Raises InputError (one line) if it has no eyes."""
    table = open_csv(path)
    names = channel_names(table.names)
    if format == "py-feat":
        rows = pyfeat_rows(path, fps)
        return TableFile(table, names, rows.timing.frames, rows.seen, None)
    if format != "livelink":
        raise InputError(f"{path}: should have columns of ARKit's coefficients, got a table of {format}")
    if EYE_NAMES.isdisjoint(names):
        raise InputError(f"{path}: should have columns of eyes (EyeBlinkLeft, ...), got {', '.join(table.names[:5])}")
    take = read_take(path, fps)
    return TableFile(table, names, take.timing.frames, take.seen, take.factors)
