"""Writes docs/benchmark.md and docs/benchmark_metrics.csv from the descriptions of the metrics.

Run     python -m pipelines.results.benchmark_page docs
Reads   docs/results/sensitivity_doses.csv (pipelines/results/sensitivity.py): which metrics detect a corruption of
        true motion
"""

from __future__ import annotations

import csv
import sys
from itertools import groupby
from pathlib import Path

from talkingeyes.evaluation.benchmark.metric_class import class_of, code_of
from talkingeyes.evaluation.benchmark.registry import METRICS, VERSION
from talkingeyes.evaluation.measures.metric import CLOSER, Metric
from talkingeyes.evaluation.text_tables import csv_text

INTRODUCTION = """# The gaze benchmark

    talkingeyes evaluate MOTION_DIR --reference CORPUS [--sound DIR] [--evaluators DATA] [-o DIR]

compares any motion with the true motion of a corpus ([evaluate.md](evaluate.md)). It prints a table and writes
`benchmark.json`, `benchmark.csv` and `strip.png`. This page is of benchmark version {version}, written by
`python -m pipelines.results.benchmark_page docs`; a test checks that it is up to date.

## Input

`MOTION_DIR` contains `.npz` files without pickles: `fps` and at least one of `head` (T, 3), `gaze` (T, 2, 3)
(eye-in-head) and `lid` (T, 2), in the axes of [conventions.md](conventions.md); or S samples of them, (S, T, ...).
`valid` (T) marks the valid frames. Frames that contain NaN are invalid and never counted. The file name gives the clip:
`<clip>.npz`, `<clip>-s3.npz`, `<clip>_sample_03.npz` or `<clip>/sample_03.npz`.

| case | behaviour |
| --- | --- |
| sounds that are not clips of the corpus | compared with the truth of its test and unseen sounds |
| speech metrics for such sounds | need `--sound`, a folder with these sounds; speech is detected by level |
| Corr. and features of windows | need `--evaluators`, the data folder of a finished chain on that corpus |
| corpus without truth | needs `--truth`, for example its fitted motion |
| missing field, too few events, broken file | reported in the row; the rest still runs |
| several frame rates in one folder | an error |
| frame rate differs from the reference | only rate-independent metrics are compared (column "rate-independent") |

## Output

Each value has a 95 % bootstrap interval over sounds, with all samples of a sound together. The table shows the value of
the reference and the difference, over the same resamples. `!` (bold in Markdown tables) means worse than the reference
by more than that interval. For metrics that compare with the reference, such as distances, it shows two halves of the
reference instead: the split-half floor, somewhat higher than for the whole.

No single metric gives a ranking: the mean pose has the lowest L2, a frozen face always looks at the partner, and noise
has the highest Diversity. [sensitivity.md](results/sensitivity.md) shows what each metric detects,
[detectors.md](detectors.md) how accurate the detectors are.

## Metrics

Gaze in space is R(head) R(eye), the mean direction of both eyes. Saccades are detected in it, by a method that depends
on the frame rate. The partner is the densest location of gaze, with a radius of 4 degrees. "Better" is `closer` to the
truth, `lower` or `higher`. SD is the standard deviation. † detects no corruption of true motion, ‡ was not tested on
any ([sensitivity.md](results/sensitivity.md)).

"Made" is what makes the value in samples of the default model: `learnt`; `corrected`: learnt, then changed by a factor,
filter or guidance; `rule`: a rule with published rates; `construction`: any weights give it. Counts in reports are of
`learnt` metrics.

[benchmark_metrics.csv](benchmark_metrics.csv) has the formula of each metric, the minimum count below which there is no
value, the data it needs, whether it depends on the frame rate, its source, a caveat to read before you use it, and the
code that makes what is not learnt.

|metric|unit|better|made|
|---|---|---|---|
"""
FAMILIES = {
    "saccades": "Saccades",
    "main_sequence": "Main sequence",
    "fixations": "Fixations",
    "partner_gaze": "Gaze at the partner and aversion",
    "speech_onset": "Around speech onsets",
    "speech_offset": "Around speech offsets",
    "turn_start": "Around starts of turns",
    "turn_end": "Around ends of turns",
    "hesitation": "Around silent hesitations",
    "filler": "Around fillers",
    "eye": "The eyes",
    "head_eye": "Eye-head coordination",
    "blinks": "Blinks",
    "gaze_in_space": "Gaze in space",
    "head": "The head",
    "reference_correlation": "Correlation with the reference under the same sound",
    "samples": "Several samples of a sound",
    "features": "Features of windows",
    "corr": "Audio-motion similarity",
}
END = """
## In Table III

The stage `evaluate` writes the benchmark of each row (`data/evaluate/<row>/benchmark.json`) over the test and unseen
sounds; `report` shows it next to Table III. Models are trained on the motion of row `fitted`, so it is their upper
bound: where `fitted` differs from the truth and a model does not, the model has not learned that from the data. Samples
of models have no lids, so blinks are only measured for `truth`, `fitted` and the output of `animate`.
"""


BETTER = {CLOSER: "closer to truth"}
BLIND, UNTESTED = "†", "‡"
CSV_COLUMNS = (
    "metric",
    "title",
    "unit",
    "formula",
    "better",
    "minimum count",
    "needs",
    "rate-independent",
    "source",
    "caveat",
    "made",
    "made by",
)


def page(docs: Path) -> str:
    """The Markdown page; `docs` has the smallest doses that the metrics detect."""
    doses = _smallest_doses(docs / "results/sensitivity_doses.csv")
    lines = []
    for family, metrics in groupby(_sorted(), key=_family):
        lines.append(f"|**{FAMILIES[family]}**||||")
        for each in metrics:
            mark = UNTESTED if each.name not in doses else "" if any(doses[each.name]) else BLIND
            cells = (f"`{each.name}` {each.title}{mark}", each.unit or "-", each.direction, class_of(each.name))
            lines.append(f"|{'|'.join(cells)}|")
    return INTRODUCTION.format(version=VERSION) + "\n".join([*lines, END])


def _smallest_doses(path: Path) -> dict[str, list[str]]:
    """The line of each metric; all empty where it detects nothing."""
    with path.open(newline="") as file:
        return {name: doses for name, *doses in csv.reader(file)}


def metrics_csv() -> str:
    """The description of every metric as CSV."""
    return csv_text([CSV_COLUMNS, *map(_cells, _sorted())])


def _sorted() -> list[Metric]:
    return sorted(METRICS, key=lambda metric: list(FAMILIES).index(_family(metric)))


def _family(metric: Metric) -> str:
    return metric.name.split("/")[0]


def _cells(metric: Metric) -> list[str]:
    return [
        metric.name,
        metric.title,
        metric.unit,
        metric.formula,
        BETTER.get(metric.direction, metric.direction),
        f"{metric.min_count} {metric.count_unit}",
        ", ".join(metric.extractor.needs),
        "no" if metric.rate_dependent else "yes",
        metric.source,
        metric.caveat,
        class_of(metric.name),
        code_of(metric.name),
    ]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for name, text in (("benchmark.md", page(folder)), ("benchmark_metrics.csv", metrics_csv())):
        (folder / name).write_text(text)
