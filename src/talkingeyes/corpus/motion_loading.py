"""Loads the motions in a file of this project: a Motion, or samples of head and gaze or of the face."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.core.containers import npz_names
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples, Samples


def load_motions(path: Path) -> list[Motion]:
    """Load one motion or S samples; missing fields are neutral. Raises InputError for other files."""
    keys = set(npz_names(path, "motion npz"))
    if "schema" in keys or not {"head", "jaw"} & keys:
        return [Motion.load(path)]
    if "head" in keys:
        samples = Samples.load(path)
        return [Motion.of(samples.fps, head, gaze) for head, gaze in zip(samples.head, samples.gaze, strict=True)]
    faces = FaceSamples.load(path)
    frames = faces.jaw.shape[1]
    still = Motion.of(faces.fps, np.zeros((frames, 3)), np.zeros((frames, 2, 3)))
    names: dict[str, Any] = {"expression_names": faces.expression_names, "head_model": faces.head_model}
    return [
        replace(still, jaw=jaw, expression=expression, **names)
        for jaw, expression in zip(faces.jaw, faces.expression, strict=True)
    ]
