"""Where a corpus and what was made of it lie, for the facts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from talkingeyes.audio.prosody import ProsodySettings
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.evaluation.contrast import CriticSettings
from talkingeyes.synthesis import plan


@dataclass(frozen=True)
class Source:
    """Where a corpus and what was made of it lie. `settings` is None for a corpus that was not synthesised."""

    corpus: Corpus
    fit: Path
    embed: Path
    prosody: ProsodySettings
    critic: CriticSettings
    settings: plan.SynthesizeSettings | None


def motion_of(source: Source, clip: Clip) -> Motion:
    """The true motion, or where nobody knows it the fitted one."""
    if source.corpus.has_truth:
        return source.corpus.truth(clip)
    return Motion.load(sharded(source.fit / "motion", clip.id, ".npz"))
