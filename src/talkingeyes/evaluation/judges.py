"""The frozen networks that judge motion: the critics behind Corr. and the encoder of windows, by the stage `critic`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from talkingeyes.evaluation.benchmark.sound import CRITICS
from talkingeyes.evaluation.correlation import Correlation
from talkingeyes.evaluation.distribution.encoder import MotionEncoder


@dataclass(frozen=True)
class Judges:
    """Critics by part, and the encoder."""

    critics: dict[str, Correlation]
    encoder: MotionEncoder

    @classmethod
    def load(cls, folder: Path) -> Judges:
        """From what the stage `critic` wrote."""
        return cls({part: Correlation.load(folder, part) for part in CRITICS.values()}, MotionEncoder.load(folder))
