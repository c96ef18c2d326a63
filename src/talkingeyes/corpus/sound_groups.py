"""The sounds of some splits: fitted takes of each, and other sounds of the same speaker for comparison.

A sound represents all clips that share it (takes). Metrics are averaged over sounds, so that takes have no extra
weight.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.corpus.store import Corpus


@dataclass(frozen=True)
class SoundGroup:
    """A sound to evaluate: its fitted takes, starting with take 0, and clips of other sounds of the speaker."""

    takes: list[Clip]
    others: list[Clip]

    @property
    def clip(self) -> Clip:
        """Take 0, the reference for models."""
        return self.takes[0]


def group_sounds(
    corpus: Corpus, fit: Path, embed: Path, splits: Collection[str], others: int, seed: int
) -> list[SoundGroup]:
    """The sounds whose take 0 was fitted, in corpus order; `others` are sampled by seed and clip."""
    takes, of_speaker = defaultdict(list), defaultdict(list)
    for clip in Recordings(corpus.clips, fit, embed).clips:
        takes[clip.sound].append(clip)
        if clip.take == 0:
            of_speaker[clip.speaker].append(clip)
    found = []
    for same in takes.values():
        clip = min(same, key=lambda each: each.take)
        if clip.split not in splits or clip.take != 0:
            continue
        rivals = [other for other in of_speaker[clip.speaker] if other.sound != clip.sound]
        rng = np.random.default_rng([seed, *clip.id.encode()])
        chosen = rng.choice(len(rivals), size=min(others, len(rivals)), replace=False)
        found.append(SoundGroup(sorted(same, key=lambda each: each.take), [rivals[index] for index in chosen]))
    return found
