"""The frozen networks behind learned metrics: the critics of Corr. and the motion encoder, from the stage `critic`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from talkingeyes.evaluation.measures.corr import CRITICS
from talkingeyes.evaluation.measures.critic import CriticCorrelation
from talkingeyes.evaluation.measures.motion_encoder import MotionEncoder


@dataclass(frozen=True)
class Evaluators:
    """Critics by part, and the motion encoder."""

    critics: dict[str, CriticCorrelation]
    encoder: MotionEncoder

    @classmethod
    def load(cls, folder: Path) -> Evaluators:
        """Load critics and encoder from the output folder of the stage `critic`."""
        return cls(
            {part: CriticCorrelation.load(folder, part) for part in CRITICS.values()}, MotionEncoder.load(folder)
        )
