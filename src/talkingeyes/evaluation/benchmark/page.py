"""docs/benchmark.md, written from the descriptions of the measures.

Run     python -m talkingeyes.evaluation.benchmark.page > docs/benchmark.md
"""

from __future__ import annotations

from itertools import groupby

from talkingeyes.evaluation.benchmark.metric import CLOSER, Metric
from talkingeyes.evaluation.benchmark.registry import METRICS

INTRODUCTION = """# The gaze benchmark

    talkingeyes evaluate MOTION_DIR --reference CORPUS [--sound DIR] [--evaluators DATA] [-o DIR]

measures anybody's motion against the true motion of a corpus: prints a table, and writes `benchmark.json`,
`benchmark.csv` and `strip.png`. This page is written by
`python -m talkingeyes.evaluation.benchmark.page` from the description of each measure; a test keeps it fresh.

## What goes in

`MOTION_DIR` holds `.npz` files without pickles: `fps` and at least one of `head` (T, 3), `gaze` (T, 2, 3), eye-in-head,
and `lid` (T, 2), in the axes of [conventions.md](conventions.md); or S samples of them, (S, T, ...). `valid` (T) says
which frames were seen. Frames that hold NaN are not valid: they are never counted. A file is for the clip whose name it
has: `<clip>.npz`, `<clip>-s3.npz`, `<clip>_sample_03.npz`, `<clip>/sample_03.npz`. Motions for sounds that are no clips
of the corpus are compared with the truth of its test and unseen sounds; what depends on speech then needs `--sound`, a
folder of sounds of the same names, in which speech is found by its level. Corr. and the features of windows need
`--evaluators`, the data folder of a finished chain on that corpus, whose critics, encoder and embedded sounds are used.
A corpus without truth needs `--truth`, say its fitted motion. Missing fields, too few events, a broken file: the line
says so and the rest still runs. Motions of several frame rates in one folder are refused; of another rate than the
reference's, only what does not depend on the rate is compared (column "any rate").

## What comes out

Every figure has a 95 % interval from resamples of the sounds (all samples of a sound together; above 1,000 sounds of
1,000 groups of them, so memory does not grow). The reference's own figure stands beside it, and the difference over
the same resamples. `!` (bold in tables) means: worse than the reference by more than that interval. Measures that
compare with the reference have no figure of its own: beside them stands the comparison of two halves of it, the floor;
halves are smaller, so the floor lies somewhat above what the whole would have.

Nothing is ranked by one measure. The mean pose wins L2, a frozen face has all its gaze at the partner and rests in
every frame, noise wins Diversity: what each catches and what it cannot is measured in [sensitivity.md](sensitivity.md),
how good the detectors are, and what recorded people give, in [detectors.md](detectors.md).

## Words

Gaze in space is R(head) R(eye), the mean direction of both eyes. Saccades are found in it by the rule that suits the
frame rate. The partner is the densest place of gaze, a radius of 4 degrees around it. Direction of quality: `closer`
to the reference, `lower`, `higher`. Below the minimum count no value is given.
"""
FAMILIES = {
    "saccades": "Saccades",
    "main_sequence": "Main sequence",
    "fixations": "Fixations",
    "partner_gaze": "At the partner and away",
    "speech_onset": "Around speech onsets",
    "speech_offset": "Around ends of speech",
    "eye": "The eyes",
    "head_eye": "Eyes and head",
    "blinks": "Blinks",
    "gaze_in_space": "Gaze in space, frame by frame",
    "head": "The head",
    "reference_correlation": "Likeness under the same sound",
    "samples": "Several motions of a sound",
    "features": "Features of windows",
    "corr": "Sound and motion",
}
END = """## In Table III

The stage `evaluate` writes the benchmark of each row (`data/evaluate/<row>/benchmark.json`) over the test and unseen
sounds; `report` sets it beside Table III. The row `fitted` is the ceiling of what models can learn: where it is apart
from the truth, a model that is not has it from elsewhere. Samples of models have no lids, so blinks are measured of
`truth` and `fitted`, and of what `animate` writes.
"""


def page() -> str:
    """The page."""
    parts = [INTRODUCTION]
    for family, metrics in groupby(sorted(METRICS, key=_family_place), key=_family):
        lines = [f"## {FAMILIES[family]}", ""]
        lines += ["| metric | unit | formula | better | minimum count | rate-independent | source | caveat |"]
        lines += ["| --- " * 8 + "|", *(_line(metric) for metric in metrics), ""]
        parts.append("\n".join(lines))
    return "\n".join([*parts, END])


def _family(metric: Metric) -> str:
    return metric.name.split("/")[0]


def _family_place(metric: Metric) -> int:
    return list(FAMILIES).index(_family(metric))


def _line(metric: Metric) -> str:
    better = {CLOSER: "closer to truth"}.get(metric.direction, metric.direction)
    cells = [
        f"`{metric.name}` {metric.title}",
        metric.unit or "-",
        metric.formula,
        better,
        f"{metric.min_count} {metric.count_unit}; {', '.join(metric.extractor.needs)}",
        "no" if metric.rate_dependent else "yes",
        metric.source,
        metric.caveat,
    ]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


if __name__ == "__main__":
    print(page(), end="")
