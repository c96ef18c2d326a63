"""Sensitivity of Corr.: the critics of a finished chain on corrupted true motion.

Run     python -m benchmarks.corr [DATA]     (the data folder of a finished chain: `data` by default; half a minute)
Writes  docs/corr.md
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.behaviour import FIELDS, Behaviour, behaviour
from talkingeyes.evaluation.benchmark.comparison import Accumulator, Comparison, MetricResult, extract
from talkingeyes.evaluation.benchmark.corr import METRICS, with_corr
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.critic.evaluators import Evaluators
from talkingeyes.evaluation.sensitivity.corruptions import CORRUPTIONS, apply_corruption
from talkingeyes.evaluation.sensitivity.matrix import effect_size
from talkingeyes.orchestration.run import run_command

ROOT = Path(__file__).resolve().parents[1]
BOOTSTRAP = BootstrapSettings(n_resamples=1000, confidence_level=0.95, seed=0)
PAGE = """# Which corruptions Corr. detects

Written by `python -m benchmarks.corr` for the {sounds} test and unseen sounds of the default corpus. One true take of
each is evaluated by the critics of the chain, unchanged (column *true*, the cosine itself) and with the corruptions of
[sensitivity.md](sensitivity.md). A cell is the change of Corr. relative to the truth, in half widths of the 95 %
interval of that difference over sounds, negative if Corr. falls. **Bold** cells are detected corruptions. Corr. is read
as a distance to the truth's, so an increase is an error too.

{table}

- A frozen face also has a Corr.: the value of a cosine alone means nothing. Corr. minus Corr. under other sounds of the
  speaker (`_minus_shuffled`) is 0 if motion does not depend on the sound.
- Corr. measures timing (*delayed*) and the match of motion and speaker (*swapped speaker*). It does not have to detect
  corruptions that keep the timing, such as a wrong amplitude or a mirrored motion; the metrics of
  [sensitivity.md](sensitivity.md) do.
"""


def main(data: Path) -> None:
    """Write the page and print it."""
    corpus = Corpus(data / "synthesize")
    clips = [clip for clip in corpus.select("test", "unseen") if clip.take == 0]
    true = [_true(corpus, clip) for clip in clips]
    evaluators = Evaluators.load(data / "critic")
    heard = [_speech(data, corpus, clip) for clip in clips]
    speakers = [clip.speaker for clip in clips]

    def rows(motions: Sequence[Behaviour], reference: Accumulator | None) -> tuple[Accumulator, list[MetricResult]]:
        tally = Accumulator(true[0].fps)
        for motion, (own, others) in zip(motions, heard, strict=True):
            tally.add(extract(with_corr([motion], evaluators.critics, own, others)))
        return tally, list(Comparison(tally, reference or tally, BOOTSTRAP, paired=True).rows(METRICS))

    reference, as_it_is = rows(true, None)
    found = {each.name: rows(apply_corruption(true, speakers, each, 1.0, seed=0), reference)[1] for each in CORRUPTIONS}
    text = PAGE.format(sounds=len(clips), table=_table(as_it_is, found))
    (ROOT / "docs/corr.md").write_text(text)
    print(text)


def _true(corpus: Corpus, clip: Clip) -> Behaviour:
    motion = corpus.truth(clip)
    return behaviour(motion.fps, {name: getattr(motion, name) for name in FIELDS}, motion.valid)


def _speech(data: Path, corpus: Corpus, clip: Clip) -> tuple[np.ndarray, list[np.ndarray]]:
    """Speech features of the sound, and of two other sounds of the speaker."""
    others = sorted({each.sound for each in corpus.clips if each.speaker == clip.speaker} - {clip.sound})
    chosen = np.random.default_rng([*clip.id.encode()]).permutation(len(others))[:2]
    names = [clip.sound, *(others[index] for index in chosen)]
    own, *wrong = (np.load(shard_path(data / "embed" / "speech", name, ".npy")) for name in names)
    return own, wrong


def _table(true: Sequence[MetricResult], found: dict[str, list[MetricResult]]) -> str:
    lines = ["| metric | true | " + " | ".join(found) + " |", "| --- " * (len(found) + 2) + "|"]
    for index, row in enumerate(true):
        assert row.value is not None
        cells = [_cell(rows[index]) for rows in found.values()]
        lines.append(f"| `{row.metric.name}` | {row.value.value:.3f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(row: MetricResult) -> str:
    if row.value is None or row.difference is None:
        return "gone"
    moved = effect_size(row) * (-1 if row.difference.value < 0 else 1)
    return f"**{moved:.1f}**" if abs(moved) > 1 else f"{moved:.1f}"


if __name__ == "__main__":
    run_command(lambda: main(Path(sys.argv[1] if sys.argv[1:] else "data")))
