"""Paths of a corpus and of its derived data, for the reference ranges."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from talkingeyes.audio.prosody import ProsodySettings
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.measures.critic import CriticSettings
from talkingeyes.synthesis import plan


@dataclass(frozen=True)
class CorpusInputs:
    """A corpus and the folders of its derived data. `settings` is None for a corpus that was not synthesised."""

    corpus: Corpus
    fit: Path
    embed: Path
    prosody: ProsodySettings
    critic: CriticSettings
    settings: plan.SynthesizeSettings | None


def reference_motion(corpus_inputs: CorpusInputs, clip: Clip) -> Motion:
    """The true motion, or the fitted motion of a corpus without truth."""
    if corpus_inputs.corpus.has_truth:
        return corpus_inputs.corpus.truth(clip)
    return Motion.load(shard_path(corpus_inputs.fit / "motion", clip.id, ".npz"))
