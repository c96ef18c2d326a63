"""ARKit coefficients as JSON, read by name (shape_names.py), in any order. Three layouts, distinguished by their keys:

names, coefficients, fps                ours (`export -f arkit`), with head, eyes and translation
facsNames, weightMat, exportFps         Audio2Face; with its own names of shapes, only its eyes are known here
names, frames[].weights, metadata.fps   LAM Audio2Expression
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.shape_names import shape_names


@dataclass(frozen=True)
class CoefficientRows:
    """Coefficients in a JSON: their names as written, a row of numbers a frame, the frame rate if it is stated."""

    names: tuple[str, ...]
    rows: Sequence[Sequence[Any]]
    fps: float | None

    @property
    def shapes(self) -> tuple[str, ...]:
        """The names as ARKit spells them."""
        return shape_names(self.names)


def read_arkit_json(path: Path, fps: float | None = None) -> Motion:
    """Read a motion; without rotations, gaze follows from the look coefficients."""
    return motion_from_json(path, read_json(path, "JSON with fps, names and coefficients"), fps)


def motion_from_json(path: Path, content: Any, fps: float | None) -> Motion:
    """The motion in a parsed JSON. Raises InputError (one line) if it has none."""
    found = coefficient_rows(path, content)
    rate = fps if fps is not None else found.fps
    if rate is None:
        raise InputError(f"{path}: should contain its frame rate, got none; set --fps")
    try:
        rows = np.asarray(found.rows, np.float64)
        columns = dict(zip(found.shapes, rows.T, strict=True))
        turned = {
            name: np.asarray(content[name], np.float64) for name in ("head", "eyes", "translation") if name in content
        }
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: rows should be numbers, one for each name ({error})") from None
    decoded = arkit.decoded(np.stack([columns.get(name, np.zeros(len(rows))) for name in arkit.NAMES], axis=1))
    return Motion.of(
        rate,
        turned.get("head", np.zeros((len(rows), 3))),
        turned.get("eyes", decoded.gaze),
        translation=turned.get("translation", np.zeros((len(rows), 3))),
        lid=decoded.lid,
        jaw=decoded.jaw,
        expression=decoded.expression,
        expression_names=arkit.EXPRESSION,
    )


def coefficient_rows(path: Path, content: Any) -> CoefficientRows:
    """Find the coefficients in a parsed JSON. Raises InputError (one line) for another layout."""
    try:
        if "weightMat" in content:
            names, rows, rate = content["facsNames"], content["weightMat"], content.get("exportFps")
        elif "frames" in content:
            names, rows = content["names"], [frame["weights"] for frame in content["frames"]]
            rate = content.get("metadata", {}).get("fps")
        else:
            names, rows, rate = content["names"], content["coefficients"], content.get("fps")
        return CoefficientRows(tuple(map(str, names)), rows, None if rate is None else float(rate))
    except (AttributeError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"{path}: should be JSON with fps, names and coefficients ({error!r})") from None
