"""Accuracy and speed of the event detectors: docs/results/detectors.csv (a few rows: docs/detectors.md).

The events are those of the synthetic corpus. Its takes are sampled again, which gives the same events and allows
rendering at any frame rate. Fitted motion is used as it is in the corpus.

Run     python -m pipelines.results.detectors [CLIPS]     (after make repro)
Reads   data/synthesize, data/fit, params.yaml
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipelines.results.regenerated_takes import reproduce_take
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion, Saccade
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.detectors.blinks import detect_blinks
from talkingeyes.evaluation.detectors.fixations import MIN_DURATION_S, detect_fixations, detect_fixations_idt
from talkingeyes.evaluation.detectors.gaze_states import detect_gaze_states
from talkingeyes.evaluation.detectors.head_movements import detect_head_movements
from talkingeyes.evaluation.detectors.saccades import detect_saccades
from talkingeyes.evaluation.detectors.scoring import (
    DetectionCounts,
    cohen_kappa,
    count_matches,
    event_mask,
    match_events,
)
from talkingeyes.orchestration.run import Workspace, run_command
from talkingeyes.physiology.blinks import end_s
from talkingeyes.physiology.render import Sinusoids
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.take import Take

RATES = (25.0, 30.0, 60.0, 120.0, 250.0, 500.0)
NOISE_DEG = 0.2  # of the noisy rows: white, per axis and frame
SACCADE_CLASSES_DEG = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 40.0)
AVERSION_TOLERANCE_S = 0.3
BLINK_CLASSES = (0.4, 0.6, 0.9, 1.01)
HEAD_CLASSES_DEG = (1.0, 2.0, 4.0, 30.0)
SACCADE_TOLERANCE_S, FIXATION_TOLERANCE_S, BLINK_TOLERANCE_S, HEAD_TOLERANCE_S = 0.06, 0.06, 0.1, 0.12


@dataclass(frozen=True)
class RegeneratedClip:
    """A clip of the corpus, its take sampled again, and its fitted motion."""

    clip: Clip
    take: Take
    fitted: Motion

    def motion(self, fps: float) -> Motion:
        """The true motion at any frame rate."""
        return self.take.motion(fps, int(self.clip.seconds * fps))

    def without_head_sway(self, fps: float) -> Motion:
        """The same with no head motion except the listed movements."""
        still = Sinusoids(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
        continuous_motion = replace(self.take.continuous_motion, head_drift=still, head_speech_motion=still)
        return replace(self.take, continuous_motion=continuous_motion).motion(fps, int(self.clip.seconds * fps))


def load(workspace: Workspace, count: int) -> list[RegeneratedClip]:
    """The first clips of the corpus; a take sampled again has the same events as in the corpus."""
    corpus = Corpus(workspace.corpus)
    if not corpus.has_truth:
        raise InputError(f"{workspace.corpus}: should be a synthetic corpus, whose events are known, got a tracked one")
    settings = workspace.settings("synthesize", plan.SynthesizeSettings)
    made = []
    for clip in corpus.clips[:count]:
        path = shard_path(workspace.data("fit", "motion"), clip.id, ".npz")
        if path.exists():  # else rejected by fit
            made.append(RegeneratedClip(clip, reproduce_take(corpus, settings, clip), Motion.load(path)))
    return made


def gaze_of(motion: Motion) -> np.ndarray:
    """Cyclopean gaze in space."""
    return rotation.cyclopean_gaze(rotation.gaze_in_space(motion.head, motion.gaze))


def by_class(
    found_s: np.ndarray, known_s: np.ndarray, size: np.ndarray, edges: Sequence[float], tolerance_s: float
) -> np.ndarray:
    """Detected and total known events per size class: an array (2, classes)."""
    hit = np.zeros(len(known_s), bool)
    hit[match_events(found_s, known_s, tolerance_s).known] = True
    return np.stack([np.histogram(size[hit], edges)[0], np.histogram(size, edges)[0]])


def row(name: str, total: DetectionCounts, classes: np.ndarray | None = None) -> str:
    """A row of markdown: precision, recall, F1, onset error, and recall by class."""
    s = total.score
    shares = [] if classes is None else [f"{hit / n:.2f} ({n})" if n else "-" for hit, n in classes.T]
    figures = [f"{s.precision:.3f}", f"{s.recall:.3f}", f"{s.f1:.3f}"]
    figures += [f"{1000 * s.onset_error_s:+.0f}", f"{1000 * s.onset_iqr_s:.0f}", *shares]
    return f"| {name} | {' | '.join(figures)} |"


def print_header(kind: str, edges: Sequence[float] = (), unit: str = " deg") -> None:
    """Print the header of a table of rows."""
    classes = [f"recall {low:g}-{high:g}{unit}" for low, high in pairwise(edges)]
    names = [kind, "precision", "recall", "F1", "onset error ms", "its IQR", *classes]
    print(f"\n| {' | '.join(names)} |\n|{'---|' * len(names)}")


def saccade_row(
    name: str, regenerated: Iterable[RegeneratedClip], motion_of: Callable[[RegeneratedClip], Motion], noise: bool
) -> str:
    """Score detected saccades; undetected true saccades below a degree are ignored.

    Saccades that start in an invalid frame, or at the ends of a clip, are excluded on both sides.
    """
    total, classes = DetectionCounts(), np.zeros((2, len(SACCADE_CLASSES_DEG) - 1), int)
    rng = np.random.default_rng(0)
    for each in regenerated:
        motion = motion_of(each)
        gaze = gaze_of(motion) + noise * np.radians(NOISE_DEG) * rng.standard_normal((len(motion), 2))
        found = detect_saccades(gaze, motion.fps, motion.valid)
        events = each.take.events.saccades
        onset = np.array([event.onset_s for event in events])
        size = np.array([_amplitude_deg(event) for event in events])
        known = _counts(onset, motion)
        pairs = match_events(found.onset_s, onset, SACCADE_TOLERANCE_S)
        hit = np.isin(np.arange(len(onset)), pairs.known)
        alone = ~np.isin(np.arange(len(found)), pairs.found) & _counts(found.onset_s, motion)
        matched = pairs.known[known[pairs.known]]
        errors = (found.onset_s[pairs.found] - onset[pairs.known])[known[pairs.known]]
        total += DetectionCounts(
            found=len(matched) + int(alone.sum()),
            known=int((known & (hit | (size >= 1.0))).sum()),
            matched=len(matched),
            errors_s=tuple(errors.tolist()),
        )
        counted = [np.histogram(size[known & which], SACCADE_CLASSES_DEG)[0] for which in (hit, np.ones_like(hit))]
        classes += np.stack(counted)
    return row(name, total, classes)


def _amplitude_deg(event: Saccade) -> float:
    return float(np.degrees(np.hypot(*np.subtract(event.end_rad, event.start_rad))))


def _counts(times_s: np.ndarray, motion: Motion) -> np.ndarray:
    frame = np.clip(np.round(times_s * motion.fps).astype(int), 0, len(motion) - 1)
    return np.asarray(motion.valid[frame] & (times_s >= 0.05) & (times_s < motion.seconds - 0.15))


def print_saccades(regenerated: list[RegeneratedClip]) -> None:
    """Print saccade scores by frame rate, with noise, and in fitted motion."""
    print_header("saccades", SACCADE_CLASSES_DEG)
    for name, motion_of in _truths(RATES):
        print(saccade_row(name, regenerated, motion_of, noise=False))
    for name, motion_of in _truths((25.0, 120.0)):
        print(
            saccade_row(
                name.replace("truth", f"truth with {NOISE_DEG} deg of noise"), regenerated, motion_of, noise=True
            )
        )
    print(saccade_row("fitted, 25 fps", regenerated, lambda each: each.fitted, noise=False))
    print(saccade_row("fitted, 25 fps, away from blinks", regenerated, _fitted_between_blinks, noise=False))
    print_false_positives(regenerated)


def print_false_positives(regenerated: list[RegeneratedClip]) -> None:
    """Print where the false positives in fitted motion are."""
    at_blinks = near = elsewhere = 0
    for each in regenerated:
        found = detect_saccades(gaze_of(each.fitted), each.fitted.fps, each.fitted.valid)
        onset = np.array([event.onset_s for event in each.take.events.saccades])
        matched = match_events(found.onset_s, onset, SACCADE_TOLERANCE_S).found
        for time_s in np.delete(found.onset_s, matched):
            blink = any(b.onset_s - 0.1 < time_s < end_s(b) + 0.1 for b in each.take.events.blinks)
            at_blinks += blink
            near += not blink and np.abs(onset - time_s).min() < 0.2
            elsewhere += not blink and np.abs(onset - time_s).min() >= 0.2
    print(
        f"\nfalse positives in fitted motion: {at_blinks} within 0.1 s of a blink, {near} of the others within 0.2 s of"
        f" a true saccade, {elsewhere} elsewhere"
    )


def _fitted_between_blinks(each: RegeneratedClip) -> Motion:
    """Fitted motion with frames within 0.1 s of a detected blink marked invalid."""
    found = detect_blinks(each.fitted.lid, each.fitted.fps, each.fitted.valid)
    hidden = event_mask(found.onset_s - 0.1, found.offset_s + 0.1, each.fitted.fps, len(each.fitted))
    return replace(each.fitted, valid=each.fitted.valid & ~hidden)


def print_blinks(regenerated: list[RegeneratedClip]) -> None:
    """Print blink scores by frame rate and in fitted motion, by depth."""
    print_header("blinks", BLINK_CLASSES, unit=" closed")
    ends = []
    for name, motion_of in [*_truths((25.0, 60.0, 120.0, 500.0)), ("fitted, 25 fps", lambda each: each.fitted)]:
        total, classes = DetectionCounts(), np.zeros((2, len(BLINK_CLASSES) - 1), int)
        for each in regenerated:
            motion = motion_of(each)
            found = detect_blinks(motion.lid, motion.fps, motion.valid)
            # blinks cut by an end of the clip are excluded on both sides
            latest_s = motion.seconds - 0.4
            events = [event for event in each.take.events.blinks if 0.1 <= event.onset_s < latest_s]
            onset, depth = np.array([(event.onset_s, event.depth) for event in events]).reshape(-1, 2).T
            inside = (found.onset_s >= 0.1) & (found.onset_s < latest_s)
            pairs = match_events(found.onset_s, onset, BLINK_TOLERANCE_S)
            ends.extend(found.offset_s[pairs.found] - np.array([end_s(event) for event in events])[pairs.known])
            total += count_matches(found.onset_s[inside], onset, BLINK_TOLERANCE_S)
            classes += by_class(found.onset_s, onset, depth, BLINK_CLASSES, BLINK_TOLERANCE_S)
        print(row(name, total, classes))
    early_s = -1000 * np.percentile(ends, [75, 50, 25])
    print(f"\nends are early by {early_s[1]:.0f} ms (quartiles {early_s[0]:.0f} to {early_s[2]:.0f})")


def _truths(rates: Sequence[float]) -> Iterator[tuple[str, Callable[[RegeneratedClip], Motion]]]:
    for fps in rates:
        yield f"truth, {fps:g} fps", partial(RegeneratedClip.motion, fps=fps)


def print_head_moves(regenerated: list[RegeneratedClip]) -> None:
    """Print head movement scores by midpoint: listed movements alone, with speech motion, and by chance."""
    print_header("head movements (time: their middle)", HEAD_CLASSES_DEG)
    for fps in (25.0, 120.0):
        print(
            head_row(
                f"listed movements alone, {fps:g} fps", regenerated, partial(RegeneratedClip.without_head_sway, fps=fps)
            )
        )
    for name, motion_of in [*_truths((25.0, 120.0)), ("fitted, 25 fps", lambda each: each.fitted)]:
        print(head_row(name, regenerated, motion_of))
    by_chance = partial(head_row, shift_s=3.0)
    print(by_chance("chance: truth, 25 fps, found 3 s later", regenerated, partial(RegeneratedClip.motion, fps=25.0)))


def head_row(
    name: str,
    regenerated: Iterable[RegeneratedClip],
    motion_of: Callable[[RegeneratedClip], Motion],
    shift_s: float = 0.0,
) -> str:
    """Score detected movements, shifted cyclically by `shift_s`, against the listed ones of at least a degree."""
    total, classes = DetectionCounts(), np.zeros((2, len(HEAD_CLASSES_DEG) - 1), int)
    for each in regenerated:
        motion = motion_of(each)
        found = detect_head_movements(motion.head, motion.fps, motion.valid)
        events = [
            (event.onset_s + event.duration_s / 2, np.degrees(np.linalg.norm(event.delta_rad)))
            for event in each.take.events.head_movements
            if event.onset_s > 0 and event.onset_s + event.duration_s < motion.seconds
        ]
        middle_s, size = np.array(sorted(events)).reshape(-1, 2).T
        at_s = np.sort(((found.onset_s + found.offset_s) / 2 + shift_s) % motion.seconds)
        total += count_matches(at_s, middle_s[size >= HEAD_CLASSES_DEG[0]], HEAD_TOLERANCE_S)
        classes += by_class(at_s, middle_s, size, HEAD_CLASSES_DEG, HEAD_TOLERANCE_S)
    return row(name, total, classes)


def print_states(regenerated: list[RegeneratedClip]) -> None:
    """Print gaze state scores: frames and starts of aversions against the states of the take."""
    names = [
        "gaze states",
        "frames agree",
        "kappa",
        "averted, found",
        "averted, true",
        "partner off by deg (median, 90 %)",
    ]
    names += ["starts: precision", "recall", "error ms", "its IQR"]
    print(f"\n| {' | '.join(names)} |\n|{'---|' * len(names)}")
    for name, motion_of in [*_truths((25.0, 120.0)), ("fitted, 25 fps", lambda each: each.fitted)]:
        print(states_row(f"{name}, partner given", regenerated, motion_of, told=True))
        print(states_row(f"{name}, partner estimated", regenerated, motion_of, told=False))


def states_row(
    name: str, regenerated: Iterable[RegeneratedClip], motion_of: Callable[[RegeneratedClip], Motion], told: bool
) -> str:
    """A row of the table of gaze states; clips without gaze at the partner are excluded."""
    found, known, off_deg, starts = [], [], [], DetectionCounts()
    for each in regenerated:
        motion = motion_of(each)
        gaze, time_s = gaze_of(motion), np.arange(len(motion)) / motion.fps
        averted = np.zeros(len(motion), bool)
        for interval in each.take.gaze_intervals:
            averted[(time_s >= interval.start_s) & (time_s < interval.end_s)] = interval.averted
        if averted.all():
            continue
        partner = np.median(gaze[~averted], axis=0)
        states = detect_gaze_states(gaze, motion.fps, partner if told else None)
        found.append(states.averted)
        known.append(averted)
        off_deg.append(np.degrees(np.hypot(*(states.partner_rad - partner))))
        start_s = [(np.flatnonzero(np.diff(flags.astype(int)) == 1) + 1) / motion.fps for flags in (found[-1], averted)]
        starts += count_matches(start_s[0], start_s[1], AVERSION_TOLERANCE_S)
    one, other, s = np.concatenate(found), np.concatenate(known), starts.score
    figures = [
        f"{(one == other).mean():.3f}",
        f"{cohen_kappa(one, other):.2f}",
        f"{one.mean():.3f}",
        f"{other.mean():.3f}",
    ]
    figures += ["-" if told else f"{np.median(off_deg):.1f}, {np.percentile(off_deg, 90):.1f}"]
    figures += [
        f"{s.precision:.3f}",
        f"{s.recall:.3f}",
        f"{1000 * s.onset_error_s:+.0f}",
        f"{1000 * s.onset_iqr_s:.0f}",
    ]
    return f"| {name} | {' | '.join(figures)} |"


def print_fixations(regenerated: list[RegeneratedClip]) -> None:
    """Print fixation scores of both detectors against intervals between true saccades of at least a degree."""
    print_header("fixations")
    lengths = []
    for name, motion_of in [*_truths((25.0, 120.0)), ("fitted, 25 fps", lambda each: each.fitted)]:
        for way, detect in (("between saccades", detect_fixations), ("I-DT", detect_fixations_idt)):
            total = DetectionCounts()
            found_s: list[float] = []
            known_s: list[float] = []
            for each in regenerated:
                motion = motion_of(each)
                found = detect(gaze_of(motion), motion.fps, motion.valid)
                events = [event for event in each.take.events.saccades if _amplitude_deg(event) >= 1.0]
                start = np.array([0.0, *(event.onset_s + event.duration_s for event in events)])
                stop = np.array([*(event.onset_s for event in events), motion.seconds])
                long = np.minimum(stop, motion.seconds) - start >= MIN_DURATION_S
                total += count_matches(found.onset_s, start[long], FIXATION_TOLERANCE_S)
                found_s.extend(found.duration_s)
                known_s.extend((stop - start)[long])
            print(row(f"{name}, {way}", total))
            lengths.append(f"{name}, {way}: {np.median(found_s):.2f} s, true {np.median(known_s):.2f} s")
    print("\nmedian lengths\n\n- " + "\n- ".join(lengths))


def print_speed(regenerated: list[RegeneratedClip]) -> None:
    """Print the CPU time of all detectors together, including gaze in space, on one core."""
    print("\n| fps | ms for 10 s | times real time |\n|---|---|---|")
    for fps in (25.0, 120.0, 500.0):
        motions = [each.motion(fps) for each in regenerated[:20]]
        seconds = sum(motion.seconds for motion in motions)
        start = time.process_time()
        for motion in motions:
            gaze = gaze_of(motion)
            found = detect_saccades(gaze, fps, motion.valid)
            detect_fixations(gaze, fps, motion.valid, found)
            detect_gaze_states(gaze, fps, valid=motion.valid)
            detect_blinks(motion.lid, fps, motion.valid)
            detect_head_movements(motion.head, fps, motion.valid)
        spent_s = time.process_time() - start
        print(f"| {fps:g} | {1e4 * spent_s / seconds:.1f} | {seconds / spent_s:.0f} |")


def main() -> None:
    """Print the tables."""
    workspace = Workspace.open(Path())
    regenerated = load(workspace, int(sys.argv[1]) if sys.argv[1:] else 100)
    seconds = sum(each.clip.seconds for each in regenerated)
    print(f"{len(regenerated)} clips, {seconds:.0f} s")
    print_saccades(regenerated)
    print_fixations(regenerated)
    print_blinks(regenerated)
    print_head_moves(regenerated)
    print_states(regenerated)
    print_speed(regenerated)


if __name__ == "__main__":
    run_command(main)
