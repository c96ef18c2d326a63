"""The code of the registered model: speech to motion as an MLflow pyfunc. MLflow copies and executes this file.

Input: a table with the column `speech`, paths of sound files. Parameters: `seed`, `samples` (per sound).

Output: a row for each frame. `speech`, `sample`, `frame` and `time_s` say which; `valid`; then the fields of a Motion
(docs/conventions.md): rotation vectors in radians (`head_x` to `head_z`, `gaze_left_x` to `gaze_right_z` relative to
the head, `jaw_x` to `jaw_z`), metres (`translation_x` to `translation_z`), `lid_left` and `lid_right` (1: shut), and
`expression_NAME`, the weights of the face's shapes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd

from talkingeyes.core.motion import Motion
from talkingeyes.workflows.animate import AnimationOptions, load_performer, load_speech, sample_animations

DEFAULTS = {"seed": 0, "samples": 1}


class SpeechToMotion(mlflow.pyfunc.PythonModel):  # type: ignore[misc]  # MLflow has no types
    """A packed model, loaded once."""

    def load_context(self, context: Any) -> None:
        """Load the file of `talkingeyes pack` among the artifacts."""
        self.performer = load_performer(Path(context.artifacts["model"]))

    def predict(self, context: Any, model_input: pd.DataFrame, params: dict[str, Any] | None = None) -> pd.DataFrame:
        """Animate every sound of the column `speech`. Raises InputError (one line) for one that cannot be read."""
        given = {**DEFAULTS, **(params or {})}
        options = AnimationOptions(samples=int(given["samples"]), seed=int(given["seed"]))
        tables = []
        for path in model_input["speech"]:
            animations = sample_animations(self.performer, load_speech(str(path)), options)
            for sample, animation in enumerate(animations):
                which = {"speech": str(path), "sample": sample, "frame": np.arange(len(animation.motion))}
                tables.append(pd.DataFrame({**which, **motion_columns(animation.motion)}))
        return pd.concat(tables, ignore_index=True)


def motion_columns(motion: Motion) -> dict[str, np.ndarray]:
    """A motion as named columns."""
    columns = {"time_s": np.arange(len(motion)) / motion.fps, "valid": motion.valid}
    for name in ("head", "translation", "jaw"):
        columns |= _axes(name, getattr(motion, name))
    for eye, side in enumerate(("left", "right")):
        columns |= _axes(f"gaze_{side}", motion.gaze[:, eye]) | {f"lid_{side}": motion.lid[:, eye]}
    weights = zip(motion.expression_names, motion.expression.T, strict=True)
    return columns | {f"expression_{name}": values for name, values in weights}


def _axes(name: str, vectors: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}_{axis}": values for axis, values in zip("xyz", vectors.T, strict=True)}


mlflow.models.set_model(SpeechToMotion())
