"""Sensitivity of every benchmark metric to known corruptions of true motion.

Run     python -m benchmarks.sensitivity [SPEAKERS]     (a minute and a half of CPU; 24 speakers, four sounds each)
Reads   conf/critic/default.yaml (the encoder); no corpus: true takes are sampled by synthesis/sketched_clips.py
Writes  docs/sensitivity.md
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.distribution.encoder import EncoderSettings
from talkingeyes.evaluation.sensitivity.corruptions import CORRUPTIONS, UNCORRUPTED, Corruption
from talkingeyes.evaluation.sensitivity.matrix import (
    CorruptionEffect,
    SensitivityMatrix,
    TakeSets,
    detected_corruptions,
    mean_l2,
    sensitivity_matrix,
    split_takes,
    train_pool_encoder,
)
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.synthesis.sketched_clips import sketch_clips

ROOT = Path(__file__).resolve().parents[1]
SOUNDS, TAKES, SECONDS, FPS = 4, 4, 12.0, 25.0
BOOTSTRAP = BootstrapSettings(n_resamples=500, confidence_level=0.95, seed=0)
PAGE = """# Which corruptions each metric detects

Written by `python -m benchmarks.sensitivity` for {speakers} synthetic speakers with {sounds} sounds each.
{minutes:.0f} minutes of true motion are the reference. As much is evaluated: other true takes of the same sounds,
unchanged (column *true*) and with each corruption. A cell is the difference of a metric from the reference, in half
widths of its 95 % interval: **bold** from 1 on, where the corruption is detected; "gone" where nothing is left to
measure, which also reveals it.
`tests/test_sensitivity.py` checks this on a smaller pool.

{faults}

## What no single metric detects

- **L2 and the mean pose.** L2 (radians, eye-in-head) of other true takes: {true_l2:.3f}; of the clip's mean pose:
  {mean_l2:.3f}; of a frozen face: {frozen_l2:.3f}. L2 ranks a constant above the truth; so does the nearest sample.
  It is in Table III because the paper has it.
- **Left and right.** The left-right preferences of people nearly cancel over a population, so distributions of mirrored
  and true motion hardly differ. Comparison for the same speaker detects it: {sides}.
- **Up and down** of head and eyes together: {heights}.
- **The sign of the eyes relative to the head**: {signs}.
- **Late by 3 s** and **another speaker's motion** do not change any distribution. Metrics that depend on speech or
  speaker detect them: {late} (late), {swapped} (swapped); and Corr. against other sounds of the speaker (Table III).
- **Rated better than the truth**: {rated_better}. Calm motion wins metrics of the distance between sample and truth,
  such as L2.
- Metrics that detect no corruption here, except by having nothing left to measure: {blind}. They are included because
  the field uses them, or need more motion than this.
- True takes that differ from the reference by chance: {false} of {all} metrics.

## Metrics and corruptions

{table}
"""


def main() -> None:
    """Write the page and print it."""
    import torch

    torch.set_num_threads(1)
    speakers = int(sys.argv[1]) if sys.argv[1:] else 24
    conf = yaml.safe_load((ROOT / "conf/critic/default.yaml").read_text())
    encoder = train_pool_encoder(
        sketch_clips(speakers, SOUNDS, 1, SECONDS, FPS, seed=1), EncoderSettings.model_validate(conf["encoder"]), seed=0
    )
    takes = split_takes(sketch_clips(speakers, SOUNDS, TAKES, SECONDS, FPS, seed=0))
    text = page(sensitivity_matrix(takes, BOOTSTRAP, encoder), takes, speakers)
    (ROOT / "docs/sensitivity.md").write_text(text)
    print(text)


def page(found: SensitivityMatrix, takes: TakeSets, speakers: int) -> str:
    """The whole page."""
    by_name = {each.name: each for each in (UNCORRUPTED, *CORRUPTIONS)}
    blind = [name for name, cells in found.items() if not any(_told(cell) for cell in _faults(cells))]
    return PAGE.format(
        speakers=speakers,
        sounds=SOUNDS,
        minutes=speakers * SOUNDS * SECONDS * (TAKES // 2) / 60,
        faults="\n".join(f"- *{each.name}*: {each.title}" for each in CORRUPTIONS),
        rated_better=_won(found),
        true_l2=mean_l2(takes, UNCORRUPTED),
        mean_l2=mean_l2(takes, by_name["mean pose"]),
        frozen_l2=mean_l2(takes, by_name["frozen"]),
        sides=_catching(found, by_name["mirrored left-right"]),
        heights=_catching(found, by_name["mirrored up-down"]),
        signs=_catching(found, by_name["flipped eye yaw"]),
        late=_catching(found, by_name["delayed"]),
        swapped=_catching(found, by_name["swapped speaker"]),
        blind=", ".join(f"`{name}`" for name in blind) or "none",
        false=sum(cells[UNCORRUPTED.name].effect_size > 1 for cells in found.values()),
        all=len(found),
        table=table(found, (UNCORRUPTED, *CORRUPTIONS)),
    )


def table(found: SensitivityMatrix, columns: Sequence[Corruption]) -> str:
    """Markdown table with a line per metric and a column per corruption."""
    titles = ["true" if each is UNCORRUPTED else each.name for each in columns]
    lines = ["| metric | " + " | ".join(titles) + " |", "| --- " * (len(columns) + 1) + "|"]
    for metric in METRICS:
        if cells := found.get(metric.name):
            lines.append(f"| `{metric.name}` | " + " | ".join(_written(cells[each.name]) for each in columns) + " |")
    return "\n".join(lines)


def _catching(found: SensitivityMatrix, corruption: Corruption) -> str:
    names = [
        name
        for name, cells in found.items()
        if corruption.name in detected_corruptions(cells) and _told(cells[corruption.name])
    ]
    return ", ".join(f"`{name}`" for name in names) or "none"


def _won(found: SensitivityMatrix) -> str:
    pairs = [
        f"*{name}* in `{metric}`"
        for metric, cells in found.items()
        for name, cell in cells.items()
        if cell.rated_better
    ]
    return ", ".join(pairs) or "none"


def _faults(cells: Mapping[str, CorruptionEffect]) -> list[CorruptionEffect]:
    return [cell for name, cell in cells.items() if name != UNCORRUPTED.name]


def _told(cell: CorruptionEffect) -> bool:
    """Whether a corruption is detected by a value, not by its absence."""
    return cell.detected and not np.isnan(cell.effect_size)


def _written(cell: CorruptionEffect) -> str:
    if np.isnan(cell.effect_size):
        return "gone"
    effect_size = f"{cell.effect_size:.1f}" if abs(cell.effect_size) < 99.5 else f"{min(cell.effect_size, 9999):.0f}"
    return f"**{effect_size}**" if cell.detected else effect_size


if __name__ == "__main__":
    configure_environment()
    main()
