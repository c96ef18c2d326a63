"""Counterbalancing: the pairs of each participant, their order, and which film is on the left.

Everything is a function of the study's seed and the participant's number, so a study can be stopped, copied and
resumed. The pairs of a comparison rotate through the pool, so that all films are shown equally often. In each
comparison, A is on the left in half of the pairs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from talkingeyes.apps.study.design import Design

ATTENTION_CHECK = "attention"


@dataclass(frozen=True)
class Pair:
    """Two films of one clip, of the conditions `a` and `b`. In the attention check, `b` is the fault."""

    a: str
    b: str
    stratum: str
    clip: str
    a_left: bool

    @property
    def attention(self) -> bool:
        return self.stratum == ATTENTION_CHECK


def assign_pairs(design: Design, clips: Mapping[str, Sequence[str]], seed: int, number: int) -> tuple[Pair, ...]:
    """The pairs of participant `number` (from 0). `clips`: the pool of each stratum, and the clip of the attention
    check."""
    rng = np.random.default_rng([seed, number])
    pairs = []
    for index, (a, b) in enumerate(design.comparisons):
        seen = [
            (s.name, clip)
            for s in design.strata
            if s.name in clips
            for clip in _rotated(s.pairs, clips[s.name], number, index)
        ]
        # With an odd number of pairs, the extra one alternates between participants.
        left = np.arange(len(seen)) % 2 == (number + index) % 2
        rng.shuffle(left)
        pairs += [Pair(a, b, stratum, clip, bool(side)) for (stratum, clip), side in zip(seen, left, strict=True)]
    order = rng.permutation(len(pairs))
    shown = [pairs[place] for place in order]
    check = Pair(
        design.attention.condition,
        design.attention.fault,
        ATTENTION_CHECK,
        clips[ATTENTION_CHECK][0],
        bool(rng.integers(2)),
    )
    shown.insert(int(rng.integers(len(shown) // 2 + 1)), check)  # in the first half: it may end the study
    return tuple(shown)


def _rotated(pairs: int, pool: Sequence[str], number: int, comparison: int) -> list[str]:
    """Clips of one participant and comparison: the next ones of the pool, with an offset per comparison."""
    taken = min(pairs, len(pool))
    first = number * taken + comparison * max(len(pool) // 4, 1)
    return [pool[(first + place) % len(pool)] for place in range(taken)]
