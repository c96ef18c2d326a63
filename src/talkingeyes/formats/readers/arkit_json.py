"""ARKit coefficients as JSON, as written by `export -f arkit`. Coefficients are read by name, in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit


def read_arkit_json(path: Path, fps: float | None = None) -> Motion:
    """Read a motion; without rotations, gaze follows from the look coefficients."""
    content = read_json(path, "JSON with fps, names and coefficients")
    try:
        names = [str(name)[0].lower() + str(name)[1:] for name in content["names"]]
        rows = np.asarray(content["coefficients"], np.float64)
        columns = dict(zip(names, rows.T, strict=True))
        rate = float(content["fps"]) if fps is None else fps
        turned = {
            name: np.asarray(content[name], np.float64) for name in ("head", "eyes", "translation") if name in content
        }
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"{path}: should be JSON with fps, names and coefficients ({error!r})") from None
    table = np.stack([columns.get(name, np.zeros(len(rows))) for name in arkit.NAMES], axis=1)
    decoded = arkit.decoded(table)
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
