"""Measures of the S samples of a sound together, and of all windows of a set of motions against the truth's.

What sums over clips cannot hold: distances between samples, nearest neighbours, kernels, networks. Of each sound a
small record stays (numbers, moments of features, a few windows), so memory hardly grows. The sources of the formulas
are the files of metrics/distribution/, metrics/discrepancy.py and metrics/correlation.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.corpus.samples import Samples
from talkingeyes.metrics.benchmark.measure import LESS, MORE, TRUTH, Direction
from talkingeyes.metrics.benchmark.tally import Row
from talkingeyes.metrics.bootstrap import BootstrapSettings, Estimate, bootstrap, interval, resamples
from talkingeyes.metrics.discrepancy import diversity
from talkingeyes.metrics.distribution.coverage import manifold, own_reach, reach
from talkingeyes.metrics.distribution.energy import windowed_energy_score
from talkingeyes.metrics.distribution.frechet import LEAST_WINDOWS_A_FEATURE, Moments, frechet_of, split_half
from talkingeyes.metrics.distribution.mmd import Drawn, mmd_of, permutation_p

PARTS = {"eye": "eye-in-head", "head": "head"}
CRITICS = {"eyes": "eye-in-head", "space": "gaze in space", "head": "head"}
ENERGY_WINDOW_S = 2.0
# Quadratic measures look at so many windows, the same number of each sound; seeds are those of the bootstrap.
WINDOWS, WINDOWS_A_SOUND = 240, 4
NEIGHBOURS = 5
HALVINGS, PERMUTATIONS = 20, 200
LEAST_SOUNDS = 10

# Features of windows of samples: head, gaze, frames a second.
Encoder = Callable[[ndarray, ndarray, float], ndarray]
# Corr. of samples under each of several sounds: embeddings, head, gaze to (sounds, samples).
Corr = Callable[[Sequence[ndarray], ndarray, ndarray], ndarray]


@dataclass(frozen=True)
class Sound:
    """What is known of one sound: samples, true takes, its embedding and those of other sounds of the speaker.

    `own`: the samples are true takes, the first of them the reference, so the others are judged.
    """

    samples: Samples
    takes: Samples
    own: bool
    speech: Float[ndarray, "T C"] | None = None
    others: Sequence[Float[ndarray, "T C"]] = ()


@dataclass(frozen=True)
class Instruments:
    """The fixed networks, where there are any."""

    encoder: Encoder | None = None
    critics: Mapping[str, Corr] | None = None


@dataclass(frozen=True)
class Seen:
    """What stays of a sound: figures of the samples and of the truth by name, and the features of windows."""

    figures: Mapping[str, float]
    true_figures: Mapping[str, float]
    features: Float[ndarray, "W D"] | None
    true_features: Float[ndarray, "V D"] | None


@dataclass(frozen=True)
class EnsembleMeasure:
    """One figure of sets of samples, with all that its page says of it; the fields are those of Measure."""

    name: str
    title: str
    unit: str
    formula: str
    source: str
    trap: str
    counted: str
    least: int
    direction: Direction
    needs: str
    rate_bound: bool = True


def look(sound: Sound, instruments: Instruments, seed: int) -> Seen:
    """Everything that is kept of one sound."""
    judged = _dropped_first(sound.samples) if sound.own else sound.samples
    figures, true_figures = _distances(sound, judged)
    if instruments.critics and sound.speech is not None:
        for part, critic in instruments.critics.items():
            figures |= _correlations(part, critic, sound, sound.samples)
            true_figures |= _correlations(part, critic, sound, sound.takes)
    features, true_features = None, None
    if instruments.encoder:
        random = np.random.default_rng(seed)
        first = Samples(sound.takes.fps, sound.takes.head[:1], sound.takes.gaze[:1])
        features, true_features = (_features(instruments.encoder, each, random) for each in (judged, first))
    return Seen(figures, true_figures, features, true_features)


def _dropped_first(samples: Samples) -> Samples:
    return Samples(samples.fps, samples.head[1:], samples.gaze[1:])


def _distances(sound: Sound, judged: Samples) -> tuple[dict[str, float], dict[str, float]]:
    found: dict[str, float] = {}
    true: dict[str, float] = {}
    frames = round(ENERGY_WINDOW_S * judged.fps)
    for part in PARTS:
        ours, takes = _radians(part, judged), _radians(part, sound.takes)
        found[f"diversity/{part}"] = diversity(_radians(part, sound.samples))
        true[f"diversity/{part}"] = diversity(takes)
        for name, samples, into in (("energy", ours, found), ("energy", takes[1:], true)):
            scores = windowed_energy_score(samples, takes[0], frames) if len(samples) > 1 else np.zeros(0)
            into[f"{name}/{part}"] = float(scores.mean()) if len(scores) else float("nan")
        if len(takes) > 2:
            near, own = own_reach(takes) if sound.own else reach(ours[: len(takes) - 1], takes), own_reach(takes)
            found |= {f"coverage_error/{part}": near.coverage_error, f"precision_error/{part}": near.precision_error}
            true |= {f"coverage_error/{part}": own.coverage_error, f"precision_error/{part}": own.precision_error}
    return found, true


def _radians(part: str, samples: Samples) -> Float[ndarray, "S T C"]:
    return samples.head if part == "head" else samples.gaze.reshape(*samples.gaze.shape[:2], 6)


def _correlations(part: str, critic: Corr, sound: Sound, samples: Samples) -> dict[str, float]:
    assert sound.speech is not None
    values = critic([sound.speech, *sound.others], samples.head, samples.gaze).mean(axis=1)
    found = {f"corr/{part}": float(values[0])}
    if len(values) > 1:
        found |= {
            f"corr_shuffled/{part}": float(values[1:].mean()),
            f"corr_advantage/{part}": float(values[0] - values[1:].mean()),
        }
    return found


def _features(encoder: Encoder, samples: Samples, random: np.random.Generator) -> Float[ndarray, "W D"]:
    """Features of all windows of all samples, in random order, so that the first few are any few."""
    found = encoder(samples.head, samples.gaze, samples.fps)
    return np.asarray(found[random.permutation(len(found))])


def rows(seen: Sequence[Seen], own: bool, settings: BootstrapSettings) -> list[Row]:
    """All measures over the sounds. `own`: of the truth itself, whose distance from itself is that of its halves."""
    found = [_row_of_figures(measure, seen, settings) for measure in FIGURES]
    ours = [(each.features, each.true_features) for each in seen if each.features is not None]
    windows = [
        (features, true)
        for features, true in ours
        if true is not None and len(true) and (own or (features is not None and len(features)))
    ]
    if not windows:
        return found + [Row(measure, 0, None, None, None, "needs the encoder and windows") for measure in SETS]
    true = [true for _, true in windows]
    judged = true if own else [features for features, _ in windows if features is not None]
    return [*found, *_row_of_sets(judged, true, own, settings)]


def _row_of_figures(measure: EnsembleMeasure, seen: Sequence[Seen], settings: BootstrapSettings) -> Row:
    """Means over the sounds that have the figure; the difference over those that have the truth's too."""
    ours, theirs = (
        np.array([figures.get(measure.name, np.nan) for figures in column])
        for column in ([each.figures for each in seen], [each.true_figures for each in seen])
    )
    both = ~np.isnan(ours + theirs)
    known = both if measure.needs == "takes" else ~np.isnan(ours)
    count = int(known.sum())
    if count < measure.least:
        reason = f"needs {measure.least} {measure.counted}, the motions have {count}"
        return Row(measure, count, None, None, None, reason)
    value = _mean(ours[known], settings)
    if both.sum() < measure.least:
        return Row(measure, count, value, None, None, "the truth has too few takes")
    return Row(measure, count, value, _mean(theirs[both], settings), _mean((ours - theirs)[both], settings))


def _mean(values: Float[ndarray, " N"], settings: BootstrapSettings) -> Estimate:
    return bootstrap(lambda clips: float(values[clips].mean()), len(values), settings)


def _row_of_sets(
    judged: Sequence[Float[ndarray, "_ D"]],
    true: Sequence[Float[ndarray, "_ D"]],
    own: bool,
    settings: BootstrapSettings,
) -> list[Row]:
    """Frechet distance, MMD, precision and coverage; the reference is one half of the truth against the other."""
    ours, theirs = Moments.of(judged), Moments.of(true)
    count = int(min(ours.count.sum(), theirs.count.sum()))
    if count < SETS[0].least or len(true) < LEAST_SOUNDS:
        reason = f"needs {SETS[0].least} windows of {LEAST_SOUNDS} sounds, there are {count} of {len(true)}"
        return [Row(measure, count, None, None, None, reason) for measure in SETS]
    drawn, reference = _even(judged), _even(true)
    floors = _floors(theirs, true, settings)
    if own:
        return [Row(measure, count, floors.get(measure.name), floors.get(measure.name), None) for measure in SETS]
    values = {
        "frechet": _centred(ours, theirs, settings),
        "mmd": bootstrap(mmd_of(drawn, reference, paired=True), len(true), settings),
        "mmd_p": _share(permutation_p(drawn, reference, PERMUTATIONS, settings.seed)),
        **_manifold(drawn, reference, settings),
    }
    return [Row(measure, count, values[measure.name], floors.get(measure.name), None) for measure in SETS]


def _even(groups: Sequence[Float[ndarray, "_ D"]]) -> Drawn:
    """The first windows of each sound, the same number of each, WINDOWS in all at most."""
    each = max(1, min(WINDOWS_A_SOUND, WINDOWS // len(groups)))
    spread = np.unique(np.linspace(0, len(groups) - 1, min(len(groups), WINDOWS)).astype(int))
    clip = np.repeat(spread, [min(each, len(groups[index])) for index in spread])
    return Drawn(np.concatenate([groups[index][:each] for index in spread]), clip)


def _centred(ours: Moments, theirs: Moments, settings: BootstrapSettings) -> Estimate:
    """The Frechet distance; draws hold fewer different windows and come out higher, so they are moved to the value."""
    statistic = frechet_of(ours, theirs.gaussian())
    value = statistic(np.arange(len(ours.count)))
    values = np.array([statistic(clips) for clips in resamples(len(ours.count), settings)])
    low, high = interval(values - values.mean() + value, settings)
    return Estimate(value, max(0.0, low), high)


def _manifold(drawn: Drawn, reference: Drawn, settings: BootstrapSettings) -> dict[str, Estimate]:
    found = manifold(drawn, reference, NEIGHBOURS)
    return {
        name: _mean(np.array([inside[clip == each].mean() for each in np.unique(clip)]), settings)
        for name, inside, clip in (
            ("precision", found.precise, drawn.clip),
            ("coverage", found.covered, reference.clip),
        )
    }


def _floors(
    moments: Moments, true: Sequence[Float[ndarray, "_ D"]], settings: BootstrapSettings
) -> dict[str, Estimate]:
    """What halves of the truth come to, over random halvings of the sounds."""
    random = np.random.default_rng(settings.seed)
    halves: dict[str, list[float]] = {"mmd": [], "precision": [], "coverage": []}
    for _ in range(HALVINGS):
        order = random.permutation(len(true))
        one, other = (_even([true[index] for index in half]) for half in np.array_split(order, 2))
        halves["mmd"].append(mmd_of(one, other)(np.arange(len(order))))
        inside = manifold(one, other, NEIGHBOURS)
        halves["precision"].append(float(inside.precise.mean()))
        halves["coverage"].append(float(inside.covered.mean()))
    between = {"frechet": split_half(moments, HALVINGS, settings.seed), **{k: np.array(v) for k, v in halves.items()}}
    return {name: Estimate(float(values.mean()), *interval(values, settings)) for name, values in between.items()}


def _share(share: float) -> Estimate:
    """A share of permutations, give or take what that many of them leave open."""
    half = 1.96 * np.sqrt(share * (1 - share) / PERMUTATIONS)
    return Estimate(share, max(0.0, share - half), min(1.0, share + half))


_figure = partial(EnsembleMeasure, counted="sounds", least=LEAST_SOUNDS)
_set = partial(EnsembleMeasure, counted="windows", least=LEAST_WINDOWS_A_FEATURE * 10, needs="encoder")

FIGURES = (
    *(
        _figure(
            f"diversity/{part}", f"Diversity, {title}", "rad", "mean over pairs of samples and frames of the norm of their difference",
            source="TalkingEyes, section V-B.3", trap="noise raises it: read it beside the truth's own and precision", direction=TRUTH, needs="takes",
        )
        for part, title in PARTS.items()
    ),
    *(
        _figure(
            f"energy/{part}", f"energy score, {title}", "rad",
            f"E |X - y| - 1/2 E |X - X'| of windows of {ENERGY_WINDOW_S:g} s (root mean square over frames), y the true take",
            source="Gneiting & Raftery 2007, eq. 21", trap="sees the spread of poses more than their order in time", direction=LESS, needs="samples",
        )
        for part, title in PARTS.items()
    ),
    *(
        _figure(
            f"coverage_error/{part}", f"coverage error, {title}", "rad", "mean over true takes of the distance to the nearest sample (minADE)",
            source="FACTS 9", trap="falls with S; a pose near the mean does well where takes hardly agree", direction=LESS, needs="takes",
        )
        for part, title in PARTS.items()
    ),
    *(
        _figure(
            f"precision_error/{part}", f"precision error, {title}", "rad", "mean over samples of the distance to the nearest true take",
            source="FACTS 9", trap="the mean pose wins it: nearer to the truth's own is better, not lower", direction=TRUTH, needs="takes",
        )
        for part, title in PARTS.items()
    ),
    *(
        _figure(
            f"corr/{part}", f"Corr., {title}", "cosine", "cosine between the critic's features of sound and motion over 8 s",
            source="TalkingEyes, section V-B.3; metrics/correlation.py",
            trap="a conditional mean has more than the truth, a constant can beat a random draw" + ("; follows the head through counter-rotation" if part == "eyes" else ""),
            direction=TRUTH, needs="critics",
        )
        for part, title in CRITICS.items()
    ),
    *(
        _figure(
            f"corr_shuffled/{part}", f"Corr. with other sounds, {title}", "cosine", "the same with other sounds of the same speaker",
            source="Nagy et al. 2025 (mismatched speech)", trap="no quality of its own: the zero of Corr.", direction=TRUTH, needs="critics",
        )
        for part, title in CRITICS.items()
    ),
    *(
        _figure(
            f"corr_advantage/{part}", f"Corr., own less other sounds, {title}", "cosine", "Corr. with the own sound less Corr. with other sounds of the speaker",
            source="Nagy et al. 2025 (mismatched speech)", trap="its noise is about .02 over 26 sounds; exaggeration raises it", direction=MORE, needs="critics",
        )
        for part, title in CRITICS.items()
    ),
)  # fmt: skip
SETS = (
    _set(
        "frechet", "Frechet distance", "squared SD", "|m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)) over the encoder's features of windows of 2.56 s",
        source="Dowson & Landau 1982; Heusel et al. 2017", trap="biased upwards by few windows: only beside its floor and at equal numbers; blind to what the encoder left out", direction=LESS,
    ),
    _set(
        "mmd", "MMD", "", "E k(x, x') + E k(y, y') - 2 E k(x, y), Gaussian kernel, width the median distance, pairs within a sound left out",
        source="Gretton et al. 2012", trap="below 0 as often as above for the same distribution", direction=LESS,
    ),
    _set(
        "mmd_p", "MMD, p", "", f"share of {PERMUTATIONS} deals of whole sounds to two sets that are as far apart", source="Gretton et al. 2012",
        trap="falls with the number of sounds whatever the distance", direction=MORE,
    ),
    _set(
        "precision", "precision", "share", f"share of samples within the {NEIGHBOURS}th-neighbour ball of any true window",
        source="Kynkaanniemi et al. 2019", trap="the mean pose has it", direction=MORE,
    ),
    _set(
        "coverage", "coverage", "share", f"share of true windows with a sample within their {NEIGHBOURS}th-neighbour ball",
        source="Naeem et al. 2020", trap="rises with the number of samples: S is part of it", direction=MORE,
    ),
)  # fmt: skip
ENSEMBLE_MEASURES: tuple[EnsembleMeasure, ...] = (*FIGURES, *SETS)
