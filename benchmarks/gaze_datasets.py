"""Detectors against experts, and benchmark metrics on real people: the last tables of docs/detectors.csv.

The experts of Andersson et al. (2017) labelled 500 Hz eye tracking sample by sample. The metrics are computed from
OpenFace tables, from that eye tracking, and from fixations in conversation, as far as each of them allows.

Run     python -m benchmarks.gaze_datasets [FOLDER]     (make bench, after make repro)
Reads   FOLDER (../shared/data/real/gaze; without it there is nothing to do), data/synthesize and params.yaml
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.detectors import RegeneratedClip, gaze_of, load
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.gaze_datasets import (
    FIXATION,
    SACCADE,
    ConversationFixations,
    GazeRecording,
    LabelledRecording,
    read_andersson,
    read_conversation,
    read_openface,
)
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.detectors.fixations import MIN_DURATION_S, detect_fixations
from talkingeyes.evaluation.detectors.saccades import detect_saccades
from talkingeyes.evaluation.detectors.scoring import (
    DetectionCounts,
    cohen_kappa,
    count_matches,
    event_mask,
    match_events,
)
from talkingeyes.evaluation.detectors.signal import runs
from talkingeyes.orchestration.run import Workspace, run_command

FOLDER = Path(__file__).resolve().parents[2] / "shared/data/real/gaze"
CLIPS = 60  # of the synthetic truth, for comparison
EXPERT_TOLERANCE_S = 0.05
STRIDES = (1, 4, 8, 20)  # of 500 Hz: 500, 125, 62.5 and 25


@dataclass(frozen=True)
class MultiExpertRecording:
    """A recording with the labels of one or two experts, cut to the same frames."""

    recording: GazeRecording
    experts: Mapping[str, np.ndarray]  # frames in saccades
    fixations: np.ndarray  # frames in fixations, by MN


def load_labelled(folder: Path) -> list[MultiExpertRecording]:
    """Load all labelled recordings; two experts labelled the films, one of them also the pictures."""
    by_name: dict[str, dict[str, LabelledRecording]] = {}
    for path in sorted(folder.glob("andersson_*.mat")):
        name, expert = path.stem.rsplit("_labelled_", 1)
        by_name.setdefault(name, {})[expert] = read_andersson(path)
    made = []
    for labelled in by_name.values():
        frames = min(len(each.labels) for each in labelled.values())
        first = next(iter(labelled.values())).recording
        arrays = (first.gaze_in_space_rad[:frames], first.head[:frames], first.valid[:frames])
        made.append(
            MultiExpertRecording(
                GazeRecording(first.fps, *arrays),
                {expert: each.labels[:frames] == SACCADE for expert, each in labelled.items()},
                labelled["MN"].labels[:frames] == FIXATION,
            )
        )
    return made


def onsets_s(frames: np.ndarray, fps: float) -> np.ndarray:
    """Start times of runs of frames."""
    return runs(frames).first / fps


def print_experts(recordings: list[MultiExpertRecording]) -> None:
    """Print the agreement of the detectors with each expert, and between the experts."""
    print("\n| saccades | recordings | found | expert | precision | recall | F1 | onset error ms | kappa |")
    print("|---|---|---|---|---|---|---|---|---|")
    both = [each for each in recordings if len(each.experts) == 2]
    pairs = [(each.experts["RA"], each.experts["MN"], each.recording.fps) for each in both]
    _print_agreement("expert RA against MN", pairs, frames=True)
    for stride in STRIDES:
        for against, judges in (("MN", both), ("RA", both), ("MN", recordings)):
            rows = []
            for each in judges:
                sampled = each.recording.subsample(stride)
                found = detect_saccades(sampled.gaze_in_space_rad, sampled.fps, sampled.valid)
                frames = event_mask(found.onset_s, found.offset_s, each.recording.fps, len(each.recording.valid))
                rows.append((frames, each.experts[against], each.recording.fps))
            kind = "films" if judges is both else "films and pictures"
            _print_agreement(f"{500 / stride:g} Hz against {against}, {kind}", rows, frames=stride == 1)


def print_fixations(recordings: list[MultiExpertRecording]) -> None:
    """Print fixations against expert MN on pictures; films have pursuit, which the detector does not model."""
    names = ["fixations on pictures", "found", "expert", "precision", "recall", "F1", "onset error ms", "kappa"]
    names += ["median s", "expert's"]
    print(f"\n| {' | '.join(names)} |\n|{'---|' * len(names)}")
    for stride in STRIDES:
        total, frames = DetectionCounts(), []
        lengths: list[float] = []
        known_lengths: list[float] = []
        for each in recordings:
            if len(each.experts) == 2:
                continue  # a film
            sampled, fps = each.recording.subsample(stride), each.recording.fps
            found = detect_fixations(sampled.gaze_in_space_rad, sampled.fps, sampled.valid)
            labelled = runs(each.fixations)
            long = (labelled.last - labelled.first) / fps >= MIN_DURATION_S
            total += count_matches(found.onset_s, labelled.first[long] / fps, EXPERT_TOLERANCE_S)
            frames.append((event_mask(found.onset_s, found.offset_s, fps, len(each.fixations)), each.fixations))
            lengths.extend(found.duration_s)
            known_lengths.extend((labelled.last - labelled.first)[long] / fps)
        one, other = (np.concatenate([each[side] for each in frames]) for side in (0, 1))
        s = total.score
        print(
            f"| {500 / stride:g} Hz | {s.found} | {s.known} | {s.precision:.2f} | {s.recall:.2f} | {s.f1:.2f}"
            f" | {1000 * s.onset_error_s:+.0f} | {cohen_kappa(one, other):.2f} | {np.median(lengths):.2f}"
            f" | {np.median(known_lengths):.2f} |"
        )


def print_ends(recordings: list[MultiExpertRecording]) -> None:
    """Print the delay of saccade ends of the detector relative to expert MN."""
    late_ms: list[float] = []
    for each in recordings:
        fps = each.recording.fps
        found = detect_saccades(each.recording.gaze_in_space_rad, fps, each.recording.valid)
        labelled = runs(each.experts["MN"])
        pairs = match_events(found.onset_s, labelled.first / fps, EXPERT_TOLERANCE_S)
        late_ms.extend(1000 * (found.offset_s[pairs.found] - labelled.last[pairs.known] / fps))
    low, middle, high = np.percentile(late_ms, [25, 50, 75])
    print(f"\nends at 500 Hz are late by {middle:.0f} ms (quartiles {low:.0f} to {high:.0f})")


def _print_agreement(name: str, pairs: list[tuple[np.ndarray, np.ndarray, float]], frames: bool) -> None:
    total = sum(
        (count_matches(onsets_s(one, fps), onsets_s(other, fps), EXPERT_TOLERANCE_S) for one, other, fps in pairs),
        DetectionCounts(),
    )
    found, known = (np.concatenate([each[side] for each in pairs]) for side in (0, 1))
    agreed = f"{cohen_kappa(found, known):.2f}" if frames else "-"
    s = total.score
    print(
        f"| {name} | {len(pairs)} | {s.found} | {s.known} | {s.precision:.2f} | {s.recall:.2f} | {s.f1:.2f}"
        f" | {1000 * s.onset_error_s:+.0f} | {agreed} |"
    )


# Metrics that a source does not allow, by prefix: one gaze direction is used for both eyes, a chin rest fixes the head,
# and pictures have no partner.
NOT_FROM_VIDEO = ("eye/vergence", "eye/torsion", "eye/conjugacy")
NOT_FROM_CHIN_REST = (*NOT_FROM_VIDEO, "head", "looking/")


def behaviour_of(recording: GazeRecording) -> Behaviour:
    """Benchmark input of a recorded person: parallel eyes, no lids, no speech."""
    eye = rotation.eye_in_head(recording.head, recording.gaze_in_space_rad[:, None])
    return Behaviour(recording.fps, recording.head, np.repeat(eye, 2, axis=1), None, recording.valid)


def figures(behaviours: Sequence[Behaviour], left_out: tuple[str, ...]) -> dict[str, str]:
    """Metrics that need only gaze and head, by name; in brackets if the sample is too small."""
    made = {}
    for metric in METRICS:
        if metric.compute is None or not set(metric.extractor.needs) <= {"gaze", "head"}:
            continue
        sums = [metric.extractor.extract(each) for each in behaviours]
        totals = {key: np.sum([np.asarray(one[key], float) for one in sums], axis=0)[None] for key in sums[0]}
        with np.errstate(invalid="ignore", divide="ignore"):
            value = float(metric.compute(totals)[0])
        enough = float(totals[metric.count_key][0]) >= metric.min_count
        shown = f"{value:.3g}" if enough else f"({value:.3g})"
        name = f"`{metric.name}` {metric.title}" + f", {metric.unit}" * bool(metric.unit)
        made[name] = "-" if metric.name.startswith(left_out) or np.isnan(value) else shown
    return made


def print_people(regenerated: list[RegeneratedClip], recordings: list[MultiExpertRecording], folder: Path) -> None:
    """Print the benchmark's metrics of real people and of synthetic speakers at similar frame rates."""
    openface = [read_openface(path) for path in sorted(folder.glob("openface_*.csv.gz"))]
    slow, fast = ([behaviour_of(x) for x in openface if (x.fps < 45) == low] for low in (True, False))
    pictures = [behaviour_of(each.recording.subsample(20)) for each in recordings]
    truth, truth_fast = ([_behaviour(each.motion(fps)) for each in regenerated] for fps in (25.0, 58.0))
    fitted = [_behaviour(each.fitted) for each in regenerated]
    columns = {
        "synthetic truth, 25 fps": figures(truth, ()),
        "fitted to it, 25 fps": figures(fitted, ()),
        "pictures and films, 25 Hz": figures(pictures, NOT_FROM_CHIN_REST),
        "OpenFace, 30 fps": figures(slow, NOT_FROM_VIDEO),
        "synthetic truth, 58 fps": figures(truth_fast, ()),
        "OpenFace, 58 fps": figures(fast, NOT_FROM_VIDEO),
    }
    print(f"\n| measure | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}")
    for name in columns["synthetic truth, 25 fps"]:
        print(f"| {name} | {' | '.join(made[name] for made in columns.values())} |")


def _behaviour(motion: Motion) -> Behaviour:
    return Behaviour(motion.fps, motion.head, motion.gaze, None, motion.valid)


def print_conversation(path: Path, regenerated: list[RegeneratedClip]) -> None:
    """Print fixations of people in conversation by state, and those of synthetic speakers."""
    print(
        "\n| fixations | people | fixations | median length s | median step deg | steps < 5 deg | < 15 deg"
        " | level / upright steps | spread of yaw deg | of pitch deg |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    conversation = read_conversation(path)
    for state in ("SPEAK", "LISTEN", "DIALOGUE"):
        people = [conversation.of(person, state) for person in sorted(set(conversation.person))]
        _print_fixations(f"{state.lower()}, 90 Hz", [each for each in people if len(each.onset_s)])
    synthetic = []
    for each in regenerated:
        motion = each.motion(90.0)
        found = detect_fixations(gaze_of(motion), motion.fps)
        count = len(found)
        synthetic.append(
            ConversationFixations(
                (each.clip.speaker,) * count, ("SPEAK",) * count, found.onset_s, found.duration_s, found.centre_rad
            )
        )
    _print_fixations("synthetic truth, 90 fps", synthetic)


def _print_fixations(name: str, people: list[ConversationFixations]) -> None:
    steps = np.concatenate([each.gaze_shifts_deg for each in people])
    size = np.hypot(*steps.T)
    level = (np.abs(steps[:, 0]) > np.abs(steps[:, 1])).mean()
    length = np.concatenate([each.duration_s for each in people])
    spread = np.median([each.spread_deg for each in people], axis=0)
    print(
        f"| {name} | {len(people)} | {len(length)} | {np.median(length):.2f} | {np.median(size):.1f}"
        f" | {(size < 5).mean():.2f} | {(size < 15).mean():.2f} | {level / (1 - level):.1f}"
        f" | {spread[0]:.1f} | {spread[1]:.1f} |"
    )


def main() -> None:
    """Print the tables."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else FOLDER
    if not folder.is_dir():
        print("gaze_datasets: no recordings of people, nothing to measure")
        return
    recordings = load_labelled(folder)
    print_experts(recordings)
    print_ends(recordings)
    print_fixations(recordings)
    regenerated = load(Workspace.open(Path()), CLIPS)
    print_people(regenerated, recordings, folder)
    print_conversation(folder / "conversation_fixations.csv.gz", regenerated)


if __name__ == "__main__":
    run_command(main)
