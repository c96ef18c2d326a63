"""Does training with recorded fixations help? The point process of gaze on synthetic gaze, on recorded people, on both.

Run     python -m benchmarks.recorded_fixations [PEOPLE]    (after make repro; a quarter of an hour)
Reads   PEOPLE (../shared/data/real/gaze/conversation_fixations.csv.gz); data/synthesize, data/fit, data/embed
Writes  a table: nats per fixation of the people kept for validation, by state, and likelihood and information of the
        fitted gaze of val speakers in nats per second; a row for each training and seed. A second one: samples for
        the val sounds on fitted heads, by the domain given, beside the same people (docs/people.md), and how averted
        gaze changes around onsets and offsets of speech

Recordings hold no sound and no head, so that speech and head are masked there, and sometimes in the synthetic windows.
The process has the state, speaking or listening, and the domain, synthetic or recorded, as further inputs. Likelihoods
of fixations compare with those of docs/people.md (evaluation/people/likelihood.py).
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from pipelines.people import RECORDED
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Normaliser, Recording, recordings
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.comparison import Accumulator, extract
from talkingeyes.evaluation.benchmark.paired import sample_behaviours
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import BootstrapSettings, bootstrap, mean_statistic
from talkingeyes.evaluation.people.comparison import compare_with_people
from talkingeyes.evaluation.people.fixations import Person, read_people, split_people
from talkingeyes.evaluation.people.likelihood import EmpiricalHistogram, PoissonGaussian, Shifts, score
from talkingeyes.evaluation.people.tracker import TRACKER, GazeClip, record_person
from talkingeyes.evaluation.text_tables import markdown_row
from talkingeyes.models.gaze.gaze_signal import to_signal_tensor
from talkingeyes.models.gaze.point_process import PointProcessGazeSettings, cyclopean_and_vergence, saccade_landings
from talkingeyes.models.gaze.saccade_rendering import eyes_towards, render_saccades
from talkingeyes.models.layers.point_process import EventSequence, PointProcess, bin_means
from talkingeyes.models.layers.point_process_sampler import sample_events
from talkingeyes.orchestration.run import Workspace, parallel_map, run_command
from talkingeyes.physiology.gaze_population import STATES
from talkingeyes.training.conditioning import WITHOUT_CONDITIONING
from talkingeyes.training.loop import train as train_network
from talkingeyes.training.motion_task import MotionTaskSettings
from talkingeyes.training.windows import Window, WindowDataset, motion_batch
from talkingeyes.workflows.evaluate_people import conversational_state

MODEL = "talkingeyes_events"
CORPUS, PEOPLE = "corpus", "people"
DOMAINS = {CORPUS: 0.0, PEOPLE: 1.0}
TRAININGS = ((CORPUS,), (PEOPLE,), (CORPUS, PEOPLE))
SEEDS = (0, 1, 2, 3)
MASKED = 0.2  # of the synthetic windows
INPUTS = 5  # besides speech: head, state and domain
SCALE_DEG = 10.0
SPREAD = (1.0, 0.7)  # of yaw and pitch
JOBS = 2
SAMPLES = 6
AROUND_SPEECH = ("speech_onset/rise", "speech_onset/drop", "speech_offset/rise", "partner_gaze/fraction")
BOOTSTRAP = BootstrapSettings(n_resamples=1000, confidence_level=0.95, seed=0)
BESIDE_PEOPLE = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)


Batch = tuple[EventSequence, Tensor]  # events, and the condition in each bin


@dataclass(frozen=True)
class Fixations:
    """Fixations of a segment without a gap: bins, locations relative to the partner, number of bins, and the state."""

    bins: tuple[int, ...]
    locations: Float[ndarray, "K 2"]
    count: int
    state: str


def segments(person: Person, bin_s: float) -> list[Fixations]:
    """All segments of a person that last two bins or more."""
    found = []
    for state, record in person.records.items():
        for name in np.unique(record.segment):
            rows = np.flatnonzero(record.segment == name)
            start, end = record.onset_s[rows[0]], record.onset_s[rows[-1]] + record.duration_s[rows[-1]]
            bins = np.floor((record.onset_s[rows] - start) / bin_s).astype(int)
            count = max(round((end - start) / bin_s), bins[-1] + 1)
            if count > 1:
                locations = (record.centre_deg[rows] - person.home_deg) / SCALE_DEG
                found.append(Fixations(tuple(bins), locations, count, state))
    return found


class RecordedBatches:
    """Batches of segments with equally many bins."""

    def __init__(self, people: Sequence[Person], bin_s: float, channels: int, seed: int = 0) -> None:
        self.channels, self.rng = channels, np.random.default_rng(seed)
        self.people = [segments(each, bin_s) for each in people]
        self.by_count: dict[int, list[Fixations]] = defaultdict(list)
        for each in self.people:
            for segment in each:
                self.by_count[segment.count].append(segment)

    def sample_batch(self, batch: int, step: int) -> Batch:
        """A segment of a random person, each bin as likely as any other, and more segments as long as it."""
        own = self.people[self.rng.integers(len(self.people))]
        bins = np.array([each.count for each in own])
        count = int(self.rng.choice(bins, p=bins / bins.sum()))
        chosen = self.rng.choice(len(self.by_count[count]), batch)
        return self.collate([self.by_count[count][index] for index in chosen], self.rng.random(batch) < 0.5)

    def collate(self, found: Sequence[Fixations], mirrored: Iterable[bool]) -> Batch:
        """Events and masked condition of segments with equally many bins."""
        most = max(len(each.bins) for each in found)
        bins, mask = torch.zeros(len(found), most, dtype=torch.long), torch.zeros(len(found), most, dtype=torch.bool)
        locations = torch.zeros(len(found), most, 2)
        condition = torch.zeros(len(found), found[0].count, self.channels)
        for row, (each, mirror) in enumerate(zip(found, mirrored, strict=True)):
            known = len(each.bins)
            bins[row, :known], mask[row, :known] = torch.tensor(each.bins), True
            locations[row, :known] = torch.from_numpy(each.locations * (-1 if mirror else 1, 1)).float()
            condition[row, :, -2], condition[row, :, -1] = _state_value(each.state), DOMAINS[PEOPLE]
        return EventSequence(bins, locations, mask), condition


class SyntheticBatches:
    """Windows of the fitted clips of a split."""

    def __init__(self, workspace: Workspace, split: str, settings: MotionTaskSettings, bin_frames: int) -> None:
        self.corpus, self.bin_frames = Corpus(workspace.corpus), bin_frames
        normaliser = Normaliser.of(workspace.data("embed"))
        self.index = [normaliser.channels.index(name) for name in settings.speech.channels or ()]
        self.mean, self.std = (torch.from_numpy(each[self.index]) for each in (normaliser.mean, normaliser.std))
        self.recordings = recordings(self.corpus, workspace.data("fit"), workspace.data("embed"), split, take=0)
        self.windows, self.state = settings.windows, cache(self._state)

    def dataset(self, seed: int) -> WindowDataset[Recording, Batch]:
        """Random windows, half of them mirrored; in some of them speech and head are masked."""
        rng = np.random.default_rng(seed)

        def collate(windows: Sequence[Window[Recording]]) -> Batch:
            events, condition = self.collate(windows)
            condition[torch.from_numpy(rng.random(len(windows)) < MASKED), :, :-2] = 0.0
            return events, condition

        return WindowDataset(self.recordings, self.windows, seed, collate)

    def whole(self, recording: Recording) -> Batch:
        """A whole clip."""
        return self.collate([Window(recording, slice(None), False)])

    def collate(self, windows: Sequence[Window[Recording]]) -> Batch:
        """Events and condition of windows of the same length."""
        motion = motion_batch(WITHOUT_CONDITIONING, windows)
        states = [self.state(each.recording.clip, len(each.recording))[each.frames] for each in windows]
        state = torch.from_numpy(np.stack(states))[..., None]
        speech = (motion.speech[..., self.index] - self.mean) / self.std
        head = torch.rad2deg(motion.head) / SCALE_DEG
        condition = torch.cat([speech, head, state, torch.full_like(state, DOMAINS[CORPUS])], dim=-1)
        found = saccade_landings(cyclopean_and_vergence(to_signal_tensor("gaze_in_space", motion.head, motion.gaze)))
        locations = torch.rad2deg(found.landing[..., :2]) / SCALE_DEG
        events = EventSequence.from_frames(found.onset, locations, self.bin_frames)
        return events, bin_means(condition, self.bin_frames)

    def _state(self, clip: Clip, frames: int) -> Float[ndarray, " T"]:
        """The input of the state in each frame."""
        names = conversational_state(self.corpus.annotation(clip), frames, clip.fps)
        return np.asarray(np.array([_state_value(each) for each in STATES], np.float32)[names])


def _state_value(state: str) -> float:
    return 1.0 if state == "speaking" else -1.0


@dataclass(frozen=True)
class Sampled:
    """Motions of the val sounds: speakers as recorded by the simulated tracker, and metrics of the benchmark."""

    speakers: list[Person]
    metrics: dict[str, float]


@dataclass(frozen=True)
class Result:
    """Nats per fixation of each person by state; of each val clip its speaker, seconds, and log-likelihoods; samples by
    domain."""

    people: Mapping[str, Float[ndarray, " P"]]
    speakers: list[str]
    seconds: Float[ndarray, " N"]
    with_speech: Float[ndarray, " N"]
    without_speech: Float[ndarray, " N"]
    sampled: Mapping[str, Sampled]


def run(people: Path, variant: tuple[tuple[str, ...], int]) -> Result:
    """Train a process on the sources of a variant with its seed, and score it."""
    training, seed = variant
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    workspace = Workspace.open(Path())
    settings = workspace.settings(f"model.{MODEL}", MotionTaskSettings)
    gaze, loop = settings.gaze, settings.loop
    assert isinstance(gaze, PointProcessGazeSettings)
    bin_s, channels = gaze.process.bin_frames / gaze.fps, len(settings.speech.channels or ()) + INPUTS
    process = PointProcess(gaze.process, channels, SPREAD)
    train, validation = split_people(read_people(people))
    sources: list[WindowDataset[Recording, Batch] | RecordedBatches] = []
    if CORPUS in training:
        sources.append(SyntheticBatches(workspace, "train", settings, gaze.process.bin_frames).dataset(seed))
    if PEOPLE in training:
        sources.append(RecordedBatches(train, bin_s, channels, seed))
    task = ProcessTask(process, sources, loop.batch, settings.weights, np.random.default_rng(seed))
    train_network(task, loop, f"{' and '.join(training)}, seed {seed}")
    domain = DOMAINS[PEOPLE] if PEOPLE in training else DOMAINS[CORPUS]
    found: dict[str, ndarray] = {
        state: score_people(process, validation, state, domain, bin_s, channels) for state in STATES
    }
    clips = SyntheticBatches(workspace, "val", settings, gaze.process.bin_frames)
    rng = np.random.default_rng(seed)
    sampled = {name: sample_clips(process, clips, DOMAINS[name], rng) for name in training}
    return Result(found, *score_clips(process, clips), sampled)


@dataclass
class ProcessTask:
    """Trains a process with a batch of each source in each step (training/loop.py)."""

    module: PointProcess
    sources: Sequence[WindowDataset[Recording, Batch] | RecordedBatches]
    batch: int
    weights: Mapping[str, float]
    rng: np.random.Generator

    def losses(self, step: int) -> dict[str, Tensor]:
        """Sum of the losses of all sources."""
        total = torch.zeros(())
        for source in self.sources:
            terms = self.module.loss_terms(*source.sample_batch(self.batch, step))
            total = (
                total + self.weights["gaze_time"] * terms["time"] + self.weights["gaze_location"] * terms["location"]
            )
        return {"total": total}

    def validate(self) -> dict[str, float]:
        """No choice among steps: the last weights are kept."""
        return {"validation_score": float("nan")}


@torch.no_grad()
def score_people(
    process: PointProcess, people: Sequence[Person], state: str, domain: float, bin_s: float, channels: int
) -> Float[ndarray, " P"]:
    """Nats per fixation of each person: densities per second and per square degree, as in docs/people.md."""
    unit = np.log(bin_s) + 2 * np.log(SCALE_DEG)
    found = []
    for person in people:
        batches = RecordedBatches([person], bin_s, channels)
        total = shifts = 0.0
        for same in batches.by_count.values():
            chosen = [each for each in same if each.state == state]
            if not chosen:
                continue
            events, condition = batches.collate(chosen, [False] * len(chosen))
            condition[..., -1] = domain
            total += sum(float(term.sum()) for term in process.log_likelihood(events, condition).values())
            shifts += sum(len(each.bins) - 1 for each in chosen)
        found.append(total / shifts - unit)
    return np.array(found)


@torch.no_grad()
def score_clips(process: PointProcess, clips: SyntheticBatches) -> tuple[list[str], ndarray, ndarray, ndarray]:
    """Log-likelihoods of fitted gaze with speech and with masked speech, in nats per clip."""
    rows = []
    for recording in clips.recordings:
        events, condition = clips.whole(recording)
        masked = condition.clone()
        masked[..., :-INPUTS] = 0.0
        rows.append([float(sum(process.log_likelihood(events, each).values())) for each in (condition, masked)])
    own, masked_speech = np.array(rows).T
    speakers = [each.clip.speaker for each in clips.recordings]
    seconds = np.array([len(each) / each.clip.fps for each in clips.recordings])
    return speakers, seconds, own, masked_speech


@torch.no_grad()
def sample_clips(process: PointProcess, clips: SyntheticBatches, domain: float, rng: np.random.Generator) -> Sampled:
    """Samples for the val sounds, as if recorded in a domain."""
    motions = {}
    for index, recording in enumerate(clips.recordings):
        condition = clips.whole(recording)[1]
        condition[..., -1] = domain
        uniform = torch.from_numpy(rng.random((SAMPLES, condition.shape[1], 5)))
        found = sample_events(process, condition, uniform.float(), 1.0)
        bins_s = clips.bin_frames / recording.clip.fps * (np.arange(condition.shape[1]) + found.phase)
        parallel = np.concatenate([np.radians(SCALE_DEG * found.location), np.zeros((*found.event.shape, 1))], axis=-1)
        times_s = np.arange(len(recording)) / recording.clip.fps
        head = np.repeat(recording.head[None], SAMPLES, axis=0)
        motions[index] = head, eyes_towards(head, render_saccades(found.event, bins_s, parallel, times_s))
    return measure(clips, motions, rng)


def measure(
    clips: SyntheticBatches, motions: Mapping[int, tuple[ndarray, ndarray]], rng: np.random.Generator
) -> Sampled:
    """Record and measure heads and gazes by clip."""
    sums, recorded = Accumulator(clips.recordings[0].clip.fps), defaultdict(list)
    for index, (head, gaze) in motions.items():
        clip = clips.recordings[index].clip
        annotation = clips.corpus.annotation(clip)
        behaviours = sample_behaviours(Samples(clip.fps, head, gaze), annotation)
        sums.add(extract(behaviours))
        state = conversational_state(annotation, head.shape[1], clip.fps)
        for each in behaviours:
            gaze_deg = np.degrees(each.gaze_in_space_rad)
            recorded[clip.speaker].append(GazeClip(clip.fps, gaze_deg, state, np.zeros(len(state), bool)))
    chosen = {each.name: each for each in METRICS}
    values = {name: float(chosen[name].compute(sums.totals())[0]) for name in AROUND_SPEECH}  # type: ignore[misc]
    speakers = [record_person(name, each, TRACKER, rng) for name, each in sorted(recorded.items())]
    return Sampled(speakers, values)


def per_second(result: Result, values: Float[ndarray, " N"]) -> str:
    """Mean over speakers of nats per second, with its interval over speakers."""
    owners = np.array(result.speakers)
    each = [values[owners == name].sum() / result.seconds[owners == name].sum() for name in sorted(set(owners))]
    found = bootstrap(mean_statistic(np.array(each)), len(each), BOOTSTRAP)
    return f"{found.value:.3f} ({found.low:.3f} to {found.high:.3f})"


def cells(values: Float[ndarray, " P"]) -> str:
    """Mean over people, and each of them."""
    return f"{values.mean():.2f} ({', '.join(f'{each:.2f}' for each in values)})"


def main() -> None:
    """Print the table."""
    path = Path(sys.argv[1]) if sys.argv[1:] else RECORDED
    train, validation = split_people(read_people(path))
    print(markdown_row(["trained on", "seed", *STATES, "val gaze, nats/s", "information from speech, nats/s"]))
    print(markdown_row(["---"] * 6))
    for name, kind in (("Poisson, people", PoissonGaussian), ("histogram, people", EmpiricalHistogram)):
        scores = [score(kind.fit(Shifts.of(train, state)), validation, state) for state in STATES]
        print(markdown_row([name, "", *map(cells, scores), "", ""]))
    variants = list(product(TRAININGS, SEEDS))
    sampled = {"fitted gaze": fitted(Workspace.open(Path()))}
    work = parallel_map(partial(run, path), variants, JOBS, "recorded fixations")
    for (training, seed), found in zip(variants, work, strict=True):
        information = found.with_speech - found.without_speech
        figures = [per_second(found, found.with_speech), per_second(found, information)]
        people = [cells(found.people[state]) for state in STATES]
        name = " and ".join(training)
        print(markdown_row([name, str(seed), *people, *figures]), flush=True)
        sampled |= {f"{name}, seed {seed}, as {domain}": each for domain, each in found.sampled.items()}
    print()
    print_samples(validation, sampled)


def fitted(workspace: Workspace) -> Sampled:
    """The fitted motion of the val sounds."""
    settings = workspace.settings(f"model.{MODEL}", MotionTaskSettings)
    assert isinstance(settings.gaze, PointProcessGazeSettings)
    clips = SyntheticBatches(workspace, "val", settings, settings.gaze.process.bin_frames)
    motions = {index: (each.head[None], each.gaze[None]) for index, each in enumerate(clips.recordings)}
    return measure(clips, motions, np.random.default_rng(0))


def print_samples(people: Sequence[Person], sampled: Mapping[str, Sampled]) -> None:
    """Print how far samples are from people, and what they do around speech."""
    rows = {name: each.speakers for name, each in sampled.items()}
    states = compare_with_people(people, rows, BESIDE_PEOPLE)["states"]
    titles = [f"{state}: {name}" for state in STATES for name in ("mean ratio", "largest", "AUC")]
    print(markdown_row(["samples", *titles, *AROUND_SPEECH]))
    print(markdown_row(["---"] * (1 + len(titles) + len(AROUND_SPEECH))))
    for name, each in sampled.items():
        cells = []
        for state in STATES:
            row = states[state]["rows"][name]
            found = (row["mean_ratio"], "value"), (row["largest"], "ratio"), (row["auc"], "value")
            cells += ["-" if value is None else f"{value[key]:.2f}" for value, key in found]
        print(markdown_row([name, *cells, *(f"{value:.3f}" for value in each.metrics.values())]))


if __name__ == "__main__":
    run_command(main)
