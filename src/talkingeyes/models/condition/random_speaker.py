"""The training speaker who stands for an unknown one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def random_speaker(speakers: Sequence[str], seeds: Sequence[int]) -> int:
    """Index of a random training speaker."""
    return int(np.random.default_rng(seeds).integers(len(speakers)))
