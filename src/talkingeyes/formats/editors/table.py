"""Edits CSV tables (plain or gzipped): only the cells of eyes and head change, every other byte stays.

Live Link Face, ARKit columns of any program, Audio2Face-3D's `animation_frames.csv`, py-feat.
"""

from __future__ import annotations

import gzip
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.containers import MAX_TABLE_BYTES, read_bytes, reading
from talkingeyes.core.errors import InputError
from talkingeyes.formats import arkit
from talkingeyes.formats.editors.channels import (
    AddedEyes,
    angle_channels,
    channel_names,
    eye_channels,
    pyfeat_channels,
)
from talkingeyes.formats.readers.live_link import read_take
from talkingeyes.formats.writers.arkit import DIGITS

CELL = re.compile(rb'((?:"[^"]*"|[^,"])*),')
PYFEAT_HEAD = ("yaw", "pitch", "roll")
LIVE_LINK_HEAD = tuple(name.lower() for name in arkit.ANGLES[:3])


@dataclass(frozen=True)
class TableFile:
    """A table: its lines with their ends, the names of its columns, and the frame of each row."""

    path: Path
    lines: list[bytes]
    names: tuple[str, ...]
    frames: Int[ndarray, " R"]
    factors: Float[ndarray, " 9"] | None  # of Live Link's angles; None in a table of py-feat

    @property
    def has_head(self) -> bool:
        return set(LIVE_LINK_HEAD if self.factors is not None else PYFEAT_HEAD) <= set(self.names)

    def edited(self, added: AddedEyes) -> bytes:
        """The file with eyes and head."""
        wanted = eye_channels(added.motion)
        wanted |= pyfeat_channels(added.motion) if self.factors is None else angle_channels(added.motion, self.factors)
        kept = () if added.with_head else (*LIVE_LINK_HEAD, *PYFEAT_HEAD)
        columns = {
            place: wanted[name][self.frames]
            for place, name in enumerate(self.names)
            if name in wanted and name not in kept
        }
        lines = [line for line in self.lines[1:] if line.strip()]
        cells = [_cells(line.rstrip(b"\r\n")) for line in lines]
        for row, each in enumerate(cells):
            if len(each) != len(self.names):
                raise InputError(f"{self.path}: row {row + 1} should have {len(self.names)} cells, got {len(each)}")
        for place, values in columns.items() if added.share > 0 else ():
            texts = [each[place].strip() for each in cells]
            own = np.array([float(text or "nan") for text in texts])
            mixed = np.where(np.isnan(own), values, added.mixed(own, values))
            for each, value in zip(cells, mixed, strict=True):
                each[place] = f"{value:.{DIGITS}f}".encode()
        ends = [line[len(line.rstrip(b"\r\n")) :] for line in lines]
        content = self.lines[0] + b"".join(b",".join(each) + end for each, end in zip(cells, ends, strict=True))
        return gzip.compress(content, mtime=0) if self.path.suffix.lower() == ".gz" else content


def open_table(path: Path, format: str, frames: int, fps: float | None) -> TableFile:
    """Open a table that `read_motion` read as `format`, with this number of frames."""
    with reading(path, "CSV table"):
        content = read_bytes(path, MAX_TABLE_BYTES)
        content = _inflated(content) if path.suffix.lower() == ".gz" else content
        lines = content.splitlines(keepends=True)
        names = channel_names([cell.decode("utf-8-sig") for cell in _cells(lines[0].rstrip(b"\r\n"))])
    if format == "py-feat":
        return TableFile(path, lines, names, np.arange(frames), None)
    if format != "livelink":
        raise InputError(f"{path}: should have columns of ARKit's coefficients, got a table of {format}")
    take = read_take(path, fps)
    return TableFile(path, lines, names, take.frames, take.factors)


def _cells(text: bytes) -> list[bytes]:
    return CELL.findall(text + b",") if b'"' in text else text.split(b",")


def _inflated(content: bytes) -> bytes:
    with gzip.open(io.BytesIO(content)) as file:
        inflated = file.read(MAX_TABLE_BYTES + 1)
    if len(inflated) > MAX_TABLE_BYTES:
        raise ValueError(f"should have at most {MAX_TABLE_BYTES:,} bytes")
    return inflated
