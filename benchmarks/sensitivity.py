"""Sensitivity of every benchmark metric to known corruptions of true motion.

Run     python -m benchmarks.sensitivity [SPEAKERS]     (a minute and a half of CPU; 24 speakers, four sounds each)
Reads   conf/critic/default.yaml (the encoder); no corpus: true takes are sampled by synthesis/sketched_clips.py
Writes  docs/sensitivity.md, docs/sensitivity.csv
"""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.distribution.encoder import EncoderSettings
from talkingeyes.evaluation.paper_metrics.table3 import markdown_row
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
SHOWN = 3  # metrics with the largest effects
BOOTSTRAP = BootstrapSettings(n_resamples=500, confidence_level=0.95, seed=0)
PAGE = """# Which corruptions each metric detects

Written by `python -m benchmarks.sensitivity` for {speakers} synthetic speakers with {sounds} sounds each. The reference
is {minutes:.0f} minutes of true motion. As much is evaluated: other true takes of the same sounds, unchanged and with
each corruption. An effect is the difference of a metric from the reference, in half widths of its 95 % interval; from 1
on the corruption is detected. A metric that has nothing left to measure ("gone") detects it too. Without a corruption,
{false} of {all} metrics differ by chance. `tests/test_sensitivity.py` checks this on a smaller pool.

[sensitivity.csv](sensitivity.csv) has the effect of every corruption on every metric.

| corruption | what it is | metrics that detect it, of {all} | gone | largest effects |
| --- | --- | --- | --- | --- |
{faults}

## What to know before you trust a metric

- **L2 ranks a constant above the truth.** L2 (radians, eye-in-head) of other true takes: {true_l2:.3f}; of the clip's
  mean pose: {mean_l2:.3f}; of a frozen face: {frozen_l2:.3f}. It is in Table III because the paper has it.
- **Calm motion wins distances between sample and truth.** Rated better than the truth: {rated_better}.
- **Left and right** nearly cancel over a population, so distributions of mirrored and true motion hardly differ.
  Comparison for the same speaker detects it: {sides}.
- **Late by 3 s** and **another speaker's motion** do not change any distribution. Metrics that depend on speech or
  speaker detect them: {late} (late), {swapped} (swapped); and Corr. against other sounds of the speaker (Table III).
- No corruption here is detected, except as "gone", by {blind}. The field uses them, or they need more motion than this.
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
    found = sensitivity_matrix(takes, BOOTSTRAP, encoder)
    text = page(found, takes, speakers)
    (ROOT / "docs/sensitivity.md").write_text(text)
    (ROOT / "docs/sensitivity.csv").write_text(table(found, (UNCORRUPTED, *CORRUPTIONS)))
    print(text)


def page(found: SensitivityMatrix, takes: TakeSets, speakers: int) -> str:
    """The whole page."""
    by_name = {each.name: each for each in (UNCORRUPTED, *CORRUPTIONS)}
    blind = [name for name, cells in found.items() if not any(_is_detected(cell) for cell in _faults(cells))]
    return PAGE.format(
        speakers=speakers,
        sounds=SOUNDS,
        minutes=speakers * SOUNDS * SECONDS * (TAKES // 2) / 60,
        faults="\n".join(markdown_row(_fault(found, each)) for each in CORRUPTIONS),
        rated_better=_won(found),
        true_l2=mean_l2(takes, UNCORRUPTED),
        mean_l2=mean_l2(takes, by_name["mean pose"]),
        frozen_l2=mean_l2(takes, by_name["frozen"]),
        sides=_catching(found, by_name["mirrored left-right"]),
        late=_catching(found, by_name["delayed"]),
        swapped=_catching(found, by_name["swapped speaker"]),
        blind=", ".join(f"`{name}`" for name in blind) or "none",
        false=sum(cells[UNCORRUPTED.name].effect_size > 1 for cells in found.values()),
        all=len(found),
    )


def table(found: SensitivityMatrix, columns: Sequence[Corruption]) -> str:
    """CSV with a line per metric and a column per corruption."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["metric", *("true" if each is UNCORRUPTED else each.name for each in columns)])
    for metric in METRICS:
        if cells := found.get(metric.name):
            writer.writerow([metric.name, *(_written(cells[each.name]) for each in columns)])
    return text.getvalue()


def _fault(found: SensitivityMatrix, corruption: Corruption) -> list[str]:
    """Name of a corruption, how many metrics detect it, and those with the largest effects."""
    effects = {name: cells[corruption.name] for name, cells in found.items()}
    ranked = sorted(
        (name for name, each in effects.items() if _is_detected(each)), key=lambda name: -effects[name].effect_size
    )
    gone = sum(bool(np.isnan(each.effect_size)) for each in effects.values())
    detected = sum(each.detected for each in effects.values())
    largest = ", ".join(f"`{name}`" for name in ranked[:SHOWN])
    return [corruption.name, corruption.title, str(detected), str(gone), largest]


def _catching(found: SensitivityMatrix, corruption: Corruption) -> str:
    names = [
        name
        for name, cells in found.items()
        if corruption.name in detected_corruptions(cells) and _is_detected(cells[corruption.name])
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


def _is_detected(cell: CorruptionEffect) -> bool:
    """Whether a corruption is detected by a value, not by its absence."""
    return cell.detected and not np.isnan(cell.effect_size)


def _written(cell: CorruptionEffect) -> str:
    if np.isnan(cell.effect_size):
        return "gone"
    return f"{cell.effect_size:.1f}" if abs(cell.effect_size) < 99.5 else f"{min(cell.effect_size, 9999):.0f}"


if __name__ == "__main__":
    configure_environment()
    main()
