"""The tables of personal head motion as Markdown, next to the paper's numbers; cells: mean (min to max) over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from talkingeyes.evaluation.text_tables import markdown_table

TITLES = {
    "classifier": "true motion (test)",
    "head_mean": "Mean",
    "head_random": "Random",
    "head_similar": "NN (Similar)",
    "head_cnn": "CNN",
    "head_vae": "VAE",
    "head_vqvae": "VQ-VAE",
    "posegan": "PoseGAN",
    "posegan_without_motion": "PoseGAN without motion loss",
    "posegan_without_initial_pose": "PoseGAN without initial pose",
    "posegan_motion_discriminator": "PoseGAN, discriminator of motion",
    "posegan_speech_discriminator": "PoseGAN, discriminator of speaker, pose and speech",
}
# Zhang et al., Tables 1 (means over five speakers: own, and all random columns), 2 and 3.
PAPER_TABLE1 = (0.85, 0.65)
PAPER_TABLE2 = {
    "head_mean": (0.90, 0.12),
    "head_random": (1.21, 0.15),
    "head_similar": (1.18, 0.14),
    "head_cnn": (0.82, 0.11),
    "posegan": (0.89, 0.12),
}
PAPER_ACCURACY = "(accuracy: 0.92)"
PAPER_TABLE3 = {"head_mean": 0.20, "head_cnn": 0.22, "posegan": 0.72}

# Metrics of the gaze benchmark that depend on the head.
GAZE_METRICS = ("corr/head", "corr/gaze", "eye/speed", "eye/spectrum_distance", "features/frechet")

Seed = Mapping[str, Any]


def page(seeds: Sequence[Seed], benchmark: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """All tables as one Markdown text."""
    parts = [_table1(seeds), _table2(seeds), _table3(seeds), _moving(seeds), _noise(seeds), _strangers(seeds)]
    if benchmark:
        parts += [_heads(seeds, benchmark), _gaze(benchmark)]
    return "\n\n".join(parts) + "\n"


def format_seeds(values: Sequence[float], digits: int = 2) -> str:
    """Mean over seeds, with their range if there are several."""
    found = np.array(values, float)
    if not np.isfinite(found).all():
        return "–"
    mean = f"{found.mean():.{digits}f}"
    return mean if len(found) == 1 else f"{mean} <sub>{found.min():.{digits}f}–{found.max():.{digits}f}</sub>"


def _at(seeds: Sequence[Seed], *path: str | int, digits: int = 2) -> str:
    """A metric over seeds; a list (by speaker) is averaged."""
    values = []
    for seed in seeds:
        node: Any = seed
        for key in path:
            node = node[key]
        figures = np.asarray(node, float)
        values.append(float(np.nanmean(figures)) if np.isfinite(figures).any() else float("nan"))
    return format_seeds(values, digits)


def _lines(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return f"### {title}\n\n{markdown_table(head, rows)}"


def _table1(seeds: Sequence[Seed]) -> str:
    """Table 1, equal for all seeds as it involves no generator."""
    speakers, table = seeds[0]["speakers"], seeds[0]["table1"]
    rows = [
        [speaker, f"{table['own'][i]:.2f}", *(f"{value:.2f}" for value in table["random"][i])]
        for i, speaker in enumerate(speakers)
    ]
    own, other = np.nanmean(table["own"]), np.nanmean(table["random"])
    blank = [""] * (len(speakers) - 1)
    rows.append(["mean", f"{own:.2f} (paper {PAPER_TABLE1[0]})", f"{other:.2f} (paper {PAPER_TABLE1[1]})", *blank])
    title = "Table 1: fraction of windows accepted by the one-class SVM"
    return _lines(title, ["speech of", "own pose", *(f"random pose of {each}" for each in speakers)], rows)


def _table2(seeds: Sequence[Seed]) -> str:
    rows = []
    for name in seeds[0]["rows"]:
        paper = [f"{value:.2f}" for value in PAPER_TABLE2.get(name, ())] or ["", ""]
        ours = [_at(seeds, "rows", name, "l2_pose"), _at(seeds, "rows", name, "l2_motion", digits=3)]
        rows.append([TITLES[name], *ours, *paper])
    head = ["method", "pose", "motion", "paper: pose", "paper: motion"]
    return _lines("Table 2: distance of pose and of motion", head, rows)


def _table3(seeds: Sequence[Seed]) -> str:
    speakers = seeds[0]["speakers"]
    places: list[tuple[str, ...]] = [("classifier",), *(("rows", name) for name in seeds[0]["rows"])]
    rows = []
    for path in places:
        cells = [_at(seeds, *path, "confidence", index) for index in range(len(speakers))]
        cells += [_at(seeds, *path, "confidence"), _at(seeds, *path, "accuracy")]
        name = path[-1]
        paper = f"{PAPER_TABLE3[name]:.2f}" if name in PAPER_TABLE3 else ""
        rows.append([TITLES[name], *cells, PAPER_ACCURACY if name == "classifier" else paper])
    head = ["method", *speakers, "mean", "accuracy", "paper's mean"]
    return _lines("Table 3: confidence of the classifier in the intended speaker", head, rows)


def _moving(seeds: Sequence[Seed]) -> str:
    true = [_at(seeds, "truth", key, digits=3) for key in ("jitter", "seams", "variety")]
    rows = [["true motion", "1", "1", "1", *true, "", "", ""]]
    for name in seeds[0]["rows"]:
        keys = ("range", "speed", "acceleration", "jitter", "seams", "variety")
        cells = [_at(seeds, "rows", name, key, digits=3) for key in keys]
        cells += [f"{seeds[0]['rows'][name]['parameters']:,}", _at(seeds, "training_s", name, digits=0)]
        rows.append([TITLES[name], *cells, _at(seeds, "rows", name, "generation_s")])
    head = [
        "method",
        "range (relative to true)",
        "speed",
        "acceleration",
        "power above 5 Hz",
        "speed at window boundaries",
    ]
    head += ["difference of clips", "parameters", "training, CPU s", "10 min, CPU s"]
    return _lines("Head motion and ablations", head, rows)


def _noise(seeds: Sequence[Seed]) -> str:
    found: dict[str, tuple[str, ...]] = {f"{ratio} dB": ("noise", ratio) for ratio in seeds[0]["noise"]}
    found |= {f"in {each}": ("strangers", "languages", each) for each in seeds[0]["strangers"]["languages"]}
    found = {"original": ("rows", "posegan"), **found}
    rows = []
    for title, path in found.items():
        cells = [_at(seeds, *path, key, digits=3) for key in ("pace", "jitter", "seams")]
        rows.append([title, *cells, _at(seeds, *path, "confidence")])
    head = [
        "sound",
        "standard deviations per frame",
        "power above 5 Hz",
        "speed at window boundaries",
        "confidence in the intended speaker",
    ]
    return _lines("PoseGAN with noisy speech, and with other languages and voices", head, rows)


def _strangers(seeds: Sequence[Seed]) -> str:
    names = seeds[0]["strangers"]["transfer"]
    rows = [[name, _at(seeds, "strangers", "transfer", name)] for name in names]
    title = "Style transfer: distance of generated motion from the style of a new person (10 new people)"
    return _lines(title, ["style", "root mean square of log ratios"], rows)


def _heads(seeds: Sequence[Seed], benchmark: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Every head model: metrics of the head, of the gaze generated after it, and cost."""
    rows = []
    for name in seeds[0]["rows"]:
        followed = benchmark.get(f"{name}_then_gaze")
        if followed is None:
            continue
        cells = [_at(seeds, "rows", name, key) for key in ("l2_pose", "confidence", "range", "speed")]
        apart = [float(sum(bool(each["worse"]) for each in seed["metrics"].values())) for seed in followed]
        cells.append(format_seeds(apart, 0))
        cells += [format_seeds([_value(seed, measure) for seed in followed]) for measure in GAZE_METRICS]
        cost = [f"{seeds[0]['rows'][name]['parameters']:,}", _at(seeds, "training_s", name, digits=0)]
        rows.append([TITLES[name], *cells, *cost, _at(seeds, "rows", name, "generation_s")])
    head = ["head", "pose", "confidence", "range", "speed", f"worse, of {len(_measures(benchmark))}", *GAZE_METRICS]
    head += ["parameters", "training, CPU s", "10 min, CPU s"]
    title = "Every head model with one gaze decoder; `worse`: number of gaze benchmark metrics worse than the truth"
    return _lines(title, head, rows)


def _measures(benchmark: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """Names of the metrics of the gaze benchmark."""
    return list(next(iter(benchmark.values()))[0]["metrics"])


def _value(seed: Mapping[str, Any], measure: str) -> float:
    found = seed["metrics"].get(measure, {}).get("value")
    return float(found["value"]) if found else float("nan")


def _gaze(benchmark: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Every metric that all rows have, including the truth."""
    rows = list(benchmark)
    lines = []
    for measure in _measures(benchmark):
        values = [[seed["metrics"].get(measure, {}).get("value") for seed in benchmark[row]] for row in rows]
        if all(value is not None for each in values for value in each):
            lines.append([measure, *(format_seeds([value["value"] for value in each if value], 3) for each in values)])
    title = f"Gaze benchmark: every head model with the default gaze decoder (seeds: {len(benchmark[rows[0]])})"
    return _lines(title, ["metric", *rows], lines)
