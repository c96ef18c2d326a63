"""Observation of a face by a camera: 2D landmarks and pupil centres, from `synthesis` or `tracking`."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.containers import parse_json, read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.npz import save_npz
from talkingeyes.head.camera import Camera


@dataclass(frozen=True)
class Observation:
    """T frames at `fps`, in pixels: origin top left, y down, NaN where hidden.

    `landmarks` are in the order of LANDMARK_NAMES. `identity`: weights of the head's identity shapes if known (of a
    synthetic speaker); `fit` estimates its own.
    """

    fps: float
    landmarks: Float[ndarray, "T L 2"]
    pupils: Float[ndarray, "T 2 2"]
    confidence: Float[ndarray, " T"]
    camera: Camera
    identity: tuple[float, ...] = ()

    def save(self, path: Path) -> None:
        """Write as npz without pickles."""
        save_npz(
            path,
            fps=np.float64(self.fps),
            landmarks=self.landmarks.astype(np.float32),
            pupils=self.pupils.astype(np.float32),
            confidence=self.confidence.astype(np.float32),
            camera=np.str_(json.dumps(asdict(self.camera))),
            identity=np.array(self.identity, np.float64),
        )

    @classmethod
    def load(cls, path: Path) -> Observation:
        """Read npz written by `save`. Raises InputError if it is not an observation."""
        file = read_npz(path, {field.name for field in fields(cls)}, "observation")
        try:
            return cls(
                fps=float(file["fps"]),
                landmarks=file["landmarks"].astype(np.float64),
                pupils=file["pupils"].astype(np.float64),
                confidence=file["confidence"].astype(np.float64),
                camera=Camera(**parse_json(str(file["camera"]))),
                identity=tuple(file["identity"].tolist()) if "identity" in file else (),
            )
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not a readable observation ({error!r})") from None
