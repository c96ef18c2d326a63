"""Sensitivity of every benchmark metric to known corruptions of true motion, and the smallest dose that it detects.

Run     python -m pipelines.results.sensitivity [SPEAKERS]     (seven minutes of CPU; 24 speakers, four sounds each)
Reads   conf/critic/default.yaml (the encoder); no corpus: true takes are sampled by synthesis/sketched_clips.py
Writes  docs/results/sensitivity.md, docs/results/sensitivity.csv, docs/results/sensitivity_doses.csv
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from talkingeyes.evaluation.benchmark.corruptions import CORRUPTIONS, HALVINGS, UNCORRUPTED, Corruption
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.benchmark.sensitivity import (
    CorruptionEffect,
    SensitivityMatrix,
    SmallestDoses,
    TakeSets,
    mean_l2,
    sensitivity_matrix,
    smallest_doses,
    split_takes,
    train_pool_encoder,
)
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.measures.motion_encoder import EncoderSettings
from talkingeyes.evaluation.text_tables import csv_text, markdown_row
from talkingeyes.orchestration.run import run_command
from talkingeyes.synthesis.sketched_clips import SketchedClip, sketch_clips

ROOT = Path(__file__).resolve().parents[2]
SOUNDS, TAKES, SECONDS, FPS = 4, 4, 12.0, 25.0
BOOTSTRAP = BootstrapSettings(n_resamples=500, confidence_level=0.95, seed=0)
NAMED = 2  # metrics that detect the smallest dose
# People who look to places of their own; without such places, true takes of a sound do not agree in the direction of
# aversion. Corruptions that can be seen in it.
PERSONAL, PERSONAL_SPEAKERS = "remote_call", 3  # times as many speakers
PERSONAL_CORRUPTIONS = ("swapped speaker", "mirrored left-right", "mirrored up-down", "flipped eye yaw")
# What the first takes have too little of, or none: events of a conversation, and frames as short as saccades.
CONVERSATION_SPEAKERS, CONVERSATION_SECONDS = 2, 24.0  # times as many speakers
CONVERSATION_CORRUPTIONS = ("frozen", "smoothed", "reduced amplitude", "delayed", "swapped speaker", "flipped eyes")
FAST_FPS = 60.0
FAST_CORRUPTIONS = ("jittered", "smoothed", "reduced amplitude", "delayed eyes")
# Columns of the table of smallest doses, and the families of metrics in each.
GROUPS = {
    "saccades": ("saccades", "main_sequence", "fixations"),
    "partner": ("partner_gaze",),
    "speech": ("speech_onset", "speech_offset"),
    "eye": ("eye",),
    "eye-head": ("head_eye",),
    "blinks": ("blinks",),
    "gaze": ("gaze_in_space",),
    "head": ("head",),
    "correlation": ("reference_correlation",),
    "samples": ("samples",),
    "features": ("features",),
}
BY_NAME = {each.name: each for each in CORRUPTIONS}
PAGE = """# Which corruptions each metric detects

Written by `python -m pipelines.results.sensitivity` for {speakers} synthetic speakers with {sounds} sounds each. The
reference is {minutes:.0f} minutes of true motion. As much is evaluated: other true takes of the same sounds, unchanged
and with each corruption. An effect is the difference of a metric from the reference, in half widths of its 95 %
interval; above 1, and 0.5 more than without the corruption, it is detected. "Gone": nothing is left to measure.
Without a corruption, {false} of {all} metrics differ by chance.

Doses go from the corruption in the second column down to 1/{smallest} of it, each half of the one before; delays are
whole frames at {fps:.0f} fps. A metric detects its smallest dose and all larger ones; ≤: the smallest tested.

| corruption | what it is | metrics that detect it, of {all} | gone | smallest dose detected | by |
| --- | --- | --- | --- | --- | --- |
{faults}

Every effect is in [sensitivity.csv](sensitivity.csv), every smallest dose in
[sensitivity_doses.csv](sensitivity_doses.csv).

## Smallest dose by family

The smallest dose that any metric of a family detects; "-": none.

{groups}

## What to know before you trust a metric

- **L2 ranks a constant above the truth.** L2 (radians, eye-in-head) of other true takes: {true_l2:.3f}; of the clip's
  mean pose: {mean_l2:.3f}; of a frozen face: {frozen_l2:.3f}.
- **Calm motion wins distances between sample and truth.** Rated better than the truth: {rated_better}.
- **Left and right** nearly cancel over a population, so distributions of mirrored and true motion hardly differ.
  Comparison for the same speaker detects it: {sides}.
- **Late by 3 s** and **another speaker's motion** do not change any distribution. Metrics that depend on speech or
  speaker detect them: {late} (late), {swapped} (swapped); and Corr. against other sounds of the speaker (Table III).
- **Places of one's own**: {blind} detect nothing in the people of this page, who have none, so that true takes of a
  sound hardly correlate ({blind_values}); the table below has people who do.
  Metrics that detect nothing at all (marked † in [benchmark.md](../benchmark.md)): {unseen}.
- **Not tested** (‡): {untested}. For Corr. see the [log](../log/2026-11-29-corr-corruptions.md).

## Metrics that need other takes

The smallest doses that they detect in {personal_speakers} people of a recorded population
(`synthesize.population: {personal}`), in conversations of {conversation_speakers} people, and at {fast_fps:.0f} frames
a second; of {personal_corruptions}; {conversation_corruptions}; {fast_corruptions}.

| metric | takes | detects |
| --- | --- | --- |
{further}
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
    doses = smallest_doses(takes, BOOTSTRAP, encoder)
    blind = [name for name, cells in doses.items() if not any(cells.values())]
    personal = split_takes(sketch_clips(PERSONAL_SPEAKERS * speakers, SOUNDS, TAKES, SECONDS, FPS, 0, PERSONAL))
    seen = smallest_doses(personal, BOOTSTRAP, None, [BY_NAME[name] for name in PERSONAL_CORRUPTIONS])
    further = {
        PERSONAL: {name: seen[name] for name in blind},
        "conversations": _untested(found, _conversations(speakers), CONVERSATION_CORRUPTIONS),
        f"{FAST_FPS:.0f} fps": _untested(
            found, sketch_clips(speakers, 1, TAKES, SECONDS, FAST_FPS, seed=0), FAST_CORRUPTIONS
        ),
    }
    text = page(found, doses, further, takes, speakers)
    for of_pool in further.values():
        doses = {**doses, **{name: {**dict.fromkeys(BY_NAME), **cells} for name, cells in of_pool.items()}}
    (ROOT / "docs/results/sensitivity.md").write_text(text)
    (ROOT / "docs/results/sensitivity.csv").write_text(table(found, (UNCORRUPTED, *CORRUPTIONS)))
    (ROOT / "docs/results/sensitivity_doses.csv").write_text(dose_table(doses))
    print(text)


def _conversations(speakers: int) -> list[SketchedClip]:
    return sketch_clips(
        CONVERSATION_SPEAKERS * speakers, SOUNDS, TAKES, CONVERSATION_SECONDS, FPS, seed=0, conversation=True
    )


def _untested(found: SensitivityMatrix, clips: Sequence[SketchedClip], corruptions: Sequence[str]) -> SmallestDoses:
    """The smallest doses that metrics detect in these clips, of the metrics that have no value in those of the page."""
    doses = smallest_doses(split_takes(clips), BOOTSTRAP, None, [BY_NAME[name] for name in corruptions])
    return {name: cells for name, cells in doses.items() if name not in found}


def page(
    found: SensitivityMatrix, doses: SmallestDoses, further: Mapping[str, SmallestDoses], takes: TakeSets, speakers: int
) -> str:
    """The whole page. `further`: doses of metrics that need other takes, by the name of these takes."""
    blind = list(further[PERSONAL])
    same_pool = {name: cells for name, cells in doses.items() if name not in blind}
    elsewhere = {name: cells for of_takes in further.values() for name, cells in of_takes.items()}
    known = {**found, **elsewhere}
    unseen = [name for name, cells in elsewhere.items() if not any(cells.values())]
    tested = {_family(name) for name in known}
    untested = dict.fromkeys(
        name if _family(name) in tested else _family(name)
        for name in (metric.name for metric in METRICS)
        if name not in known
    )
    return PAGE.format(
        speakers=speakers,
        sounds=SOUNDS,
        minutes=speakers * SOUNDS * SECONDS * (TAKES // 2) / 60,
        smallest=2**HALVINGS,
        fps=FPS,
        faults="\n".join(markdown_row(_fault(found, same_pool, each)) for each in CORRUPTIONS),
        groups=_groups(same_pool),
        rated_better=_won(found),
        true_l2=mean_l2(takes, UNCORRUPTED),
        mean_l2=mean_l2(takes, BY_NAME["mean pose"]),
        frozen_l2=mean_l2(takes, BY_NAME["frozen"]),
        sides=_catching(found, BY_NAME["mirrored left-right"]),
        late=_catching(found, BY_NAME["delayed"]),
        swapped=_catching(found, BY_NAME["swapped speaker"]),
        blind=", ".join(f"`{name}`" for name in blind) or "none",
        blind_values=", ".join(f"{found[name][UNCORRUPTED.name].value:.2f}" for name in blind),
        personal=PERSONAL,
        personal_speakers=PERSONAL_SPEAKERS * speakers,
        personal_corruptions=_titles(PERSONAL_CORRUPTIONS),
        conversation_speakers=CONVERSATION_SPEAKERS * speakers,
        conversation_corruptions=_titles(CONVERSATION_CORRUPTIONS),
        fast_fps=FAST_FPS,
        fast_corruptions=_titles(FAST_CORRUPTIONS),
        further="\n".join(
            markdown_row([f"`{name}`", of_takes, _doses(cells)])
            for of_takes, doses_of in further.items()
            for name, cells in doses_of.items()
        ),
        unseen=", ".join(f"`{name}`" for name in unseen) or "none",
        untested=", ".join(f"`{name}`" for name in untested),
        false=sum(cells[UNCORRUPTED.name].effect_size > 1 for cells in found.values()),
        all=len(found),
    )


def table(found: SensitivityMatrix, columns: Sequence[Corruption]) -> str:
    """CSV with a line per metric and a column per corruption."""
    lines = [["metric", *("true" if each is UNCORRUPTED else each.name for each in columns)]]
    for metric in METRICS:
        if cells := found.get(metric.name):
            lines.append([metric.name, *(_written(cells[each.name]) for each in columns)])
    return csv_text(lines)


def dose_table(doses: SmallestDoses) -> str:
    """CSV with a line per metric and the smallest dose of each corruption; empty where it detects none."""
    dosed = [each for each in CORRUPTIONS if each.doses]
    lines = [["metric", *(f"{each.name} ({each.unit})" for each in dosed)]]
    for metric in METRICS:
        if cells := doses.get(metric.name):
            lines.append([metric.name, *(_dose(cells[each.name], "") for each in dosed)])
    return csv_text(lines)


def _fault(found: SensitivityMatrix, doses: SmallestDoses, corruption: Corruption) -> list[str]:
    """Name of a corruption, how many metrics detect it, the smallest dose detected, and the metrics that do."""
    effects = [cells[corruption.name] for cells in found.values()]
    gone = sum(not each.measured for each in effects)
    detected = sum(each.detected for each in effects)
    cells = [corruption.name, corruption.title, str(detected), str(gone)]
    smallest = {name: dose for name, each in doses.items() if (dose := each.get(corruption.name)) is not None}
    if not smallest:
        return [*cells, "", ""]
    least = min(smallest.values())
    first = [f"`{name}`" for name, dose in smallest.items() if dose == least]
    more = f" and {len(first) - NAMED} more" if len(first) > NAMED else ""
    return [*cells, f"{_bounded(least, corruption)} {corruption.unit}", ", ".join(first[:NAMED]) + more]


def _titles(corruptions: Sequence[str]) -> str:
    return ", ".join(f"*{name}*" for name in corruptions)


def _doses(cells: Mapping[str, float | None]) -> str:
    """The corruptions that a metric detects, with the smallest dose of each."""
    return ", ".join(
        f"{name} ({_bounded(dose, BY_NAME[name])} {BY_NAME[name].unit})"
        for name, dose in cells.items()
        if dose is not None
    )


def _groups(doses: SmallestDoses) -> str:
    """Table of the smallest dose by family, a line for each corruption."""
    lines = ["|".join(["", "corruption", *GROUPS, ""]), "|".join(["", *["---"] * (len(GROUPS) + 1), ""])]
    for corruption in CORRUPTIONS:
        if corruption.doses:
            smallest = [
                min(
                    (
                        dose
                        for name, cells in doses.items()
                        if _family(name) in families and (dose := cells[corruption.name]) is not None
                    ),
                    default=None,
                )
                for families in GROUPS.values()
            ]
            lines.append(
                "|".join(
                    [
                        "",
                        f"{corruption.name}, {corruption.unit}",
                        *(_bounded(dose, corruption) for dose in smallest),
                        "",
                    ]
                )
            )
    return "\n".join(lines)


def _family(metric: str) -> str:
    return metric.split("/", maxsplit=1)[0]


def _bounded(dose: float | None, corruption: Corruption) -> str:
    return ("≤ " if dose == corruption.doses[0] else "") + _dose(dose)


def _dose(dose: float | None, missing: str = "-") -> str:
    return missing if dose is None else f"{dose:.2g}" if dose < 99 else f"{dose:.0f}"


def _catching(found: SensitivityMatrix, corruption: Corruption) -> str:
    names = [name for name, cells in found.items() if cells[corruption.name].detected]
    return ", ".join(f"`{name}`" for name in names) or "none"


def _won(found: SensitivityMatrix) -> str:
    pairs = [
        f"*{name}* in `{metric}`"
        for metric, cells in found.items()
        for name, cell in cells.items()
        if cell.rated_better
    ]
    return ", ".join(pairs) or "none"


def _written(cell: CorruptionEffect) -> str:
    if not cell.measured:
        return "gone"
    return f"{cell.effect_size:.1f}" if abs(cell.effect_size) < 99.5 else f"{min(cell.effect_size, 9999):.0f}"


if __name__ == "__main__":
    run_command(main)
