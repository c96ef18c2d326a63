"""Does training with recorded fixations help? The point process of gaze on synthetic gaze, on recorded people, on both.

Run     python -m benchmarks.recorded_fixations [PEOPLE]    (after make repro; twenty minutes)
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
from talkingeyes.corpus.recordings import Normaliser, Recording, recordings
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.comparison import Accumulator, extract
from talkingeyes.evaluation.benchmark.paired import sample_behaviours
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import BootstrapSettings, bootstrap, mean_statistic
from talkingeyes.evaluation.paper_metrics.table3 import markdown_row
from talkingeyes.evaluation.people.comparison import compare_with_people
from talkingeyes.evaluation.people.fixations import Person, read_people, split_people
from talkingeyes.evaluation.people.likelihood import EmpiricalHistogram, PoissonGaussian, Shifts, score
from talkingeyes.evaluation.people.tracker import TRACKER, GazeClip, record_person
from talkingeyes.models.gaze.gaze_signal import mirror_motion, to_signal_tensor
from talkingeyes.models.gaze.point_process import PointProcessGazeSettings, cyclopean_and_vergence, saccade_landings
from talkingeyes.models.gaze.saccade_rendering import eyes_towards, render_saccades
from talkingeyes.models.layers.point_process import EventSequence, PointProcess, bin_means
from talkingeyes.models.layers.point_process_sampler import sample_events
from talkingeyes.orchestration.run import Workspace, parallel_map, run_command
from talkingeyes.physiology.gaze_population import STATES
from talkingeyes.training.loop import train as train_network
from talkingeyes.training.motion_task import MotionTaskSettings
from talkingeyes.workflows.evaluate_people import conversational_state

MODEL = "talkingeyes_events"
CORPUS, PEOPLE = "corpus", "people"
DOMAINS = {CORPUS: 0.0, PEOPLE: 1.0}
TRAININGS = ((CORPUS,), (PEOPLE,), (CORPUS, PEOPLE))
SEEDS = (0, 1, 2, 3)
WINDOW_FRAMES = 200
MASKED = 0.2  # of the synthetic windows
INPUTS = 5  # besides speech: head, state and domain
SCALE_DEG = 10.0
SPREAD = (1.0, 0.7)  # of yaw and pitch
PEOPLE_STEPS = 600  # on people alone; with more steps they overfit
JOBS = 2
SAMPLES = 6
AROUND_SPEECH = ("speech_onset/rise", "speech_onset/drop", "speech_offset/rise", "partner_gaze/fraction")
BOOTSTRAP = BootstrapSettings(n_resamples=1000, confidence_level=0.95, seed=0)
BESIDE_PEOPLE = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)


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

    def __init__(self, people: Sequence[Person], bin_s: float, channels: int) -> None:
        self.channels = channels
        self.people = [segments(each, bin_s) for each in people]
        self.by_count: dict[int, list[Fixations]] = defaultdict(list)
        for each in self.people:
            for segment in each:
                self.by_count[segment.count].append(segment)

    def sample(self, batch: int, rng: np.random.Generator) -> tuple[EventSequence, Tensor]:
        """A segment of a random person, each bin as likely as any other, and more segments as long as it."""
        own = self.people[rng.integers(len(self.people))]
        bins = np.array([each.count for each in own])
        count = int(rng.choice(bins, p=bins / bins.sum()))
        chosen = rng.choice(len(self.by_count[count]), batch)
        return self.collate([self.by_count[count][index] for index in chosen], rng.random(batch) < 0.5)

    def collate(self, found: Sequence[Fixations], mirrored: Iterable[bool]) -> tuple[EventSequence, Tensor]:
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

    def __init__(self, workspace: Workspace, split: str, channels: Sequence[str], bin_frames: int) -> None:
        self.corpus, self.bin_frames = Corpus(workspace.corpus), bin_frames
        normaliser = Normaliser.of(workspace.data("embed"))
        self.index = [normaliser.channels.index(name) for name in channels]
        self.mean, self.std = normaliser.mean[self.index], normaliser.std[self.index]
        self.recordings = recordings(self.corpus, workspace.data("fit"), workspace.data("embed"), split, take=0)
        self.lengths = np.array([len(each) for each in self.recordings])
        self.states = cache(self._states)

    def _states(self, index: int) -> Float[ndarray, " T"]:
        clip = self.recordings[index].clip
        names = conversational_state(self.corpus.annotation(clip), int(self.lengths[index]), clip.fps)
        return np.asarray(np.array([_state_value(each) for each in STATES], np.float32)[names])

    def sample(self, batch: int, rng: np.random.Generator) -> tuple[EventSequence, Tensor]:
        """Random windows, half of them mirrored; in some of them speech and head are masked."""
        long_enough = np.flatnonzero(self.lengths >= WINDOW_FRAMES)
        weight = self.lengths[long_enough] / self.lengths[long_enough].sum()
        rows = []
        for index in rng.choice(long_enough, batch, p=weight):
            start = int(rng.integers(self.lengths[index] - WINDOW_FRAMES + 1))
            rows.append(self._row(int(index), slice(start, start + WINDOW_FRAMES), rng.random() < 0.5))
        condition, head, gaze = (torch.from_numpy(np.stack(part)) for part in zip(*rows, strict=True))
        condition[torch.from_numpy(rng.random(batch) < MASKED), :, :-2] = 0.0
        return self._events(head, gaze), bin_means(condition, self.bin_frames)

    def whole(self, index: int) -> tuple[EventSequence, Tensor]:
        """A whole clip."""
        condition, head, gaze = (torch.from_numpy(each)[None] for each in self._row(index, slice(None), False))
        return self._events(head, gaze), bin_means(condition, self.bin_frames)

    def _row(self, index: int, frames: slice, mirror: bool) -> tuple[ndarray, ndarray, ndarray]:
        recording: Recording = self.recordings[index]
        speech = (recording.speech[frames, self.index] - self.mean) / self.std
        head, gaze = recording.head[frames], recording.gaze[frames]
        if mirror:
            head, gaze = mirror_motion(head, gaze)
        state = self.states(index)[frames, None]
        condition = np.concatenate([speech, np.degrees(head) / SCALE_DEG, state, np.zeros_like(state)], axis=1)
        return condition.astype(np.float32), np.ascontiguousarray(head), np.ascontiguousarray(gaze)

    def _events(self, head: Float[Tensor, "B T 3"], gaze: Float[Tensor, "B T 2 3"]) -> EventSequence:
        found = saccade_landings(cyclopean_and_vergence(to_signal_tensor("gaze_in_space", head, gaze)))
        locations = torch.rad2deg(found.landing[..., :2]) / SCALE_DEG
        return EventSequence.from_frames(found.onset, locations, self.bin_frames)


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


def run(people: Path, training: tuple[str, ...], seed: int) -> Result:
    """Train a process and score it."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    workspace = Workspace.open(Path())
    settings = workspace.settings(f"model.{MODEL}", MotionTaskSettings)
    gaze, loop, weights = settings.gaze, settings.loop, settings.weights
    assert isinstance(gaze, PointProcessGazeSettings)
    names = settings.speech.channels
    assert names is not None
    bin_s, channels = gaze.process.bin_frames / gaze.fps, len(names) + INPUTS
    process = PointProcess(gaze.process, channels, SPREAD)
    train, validation = split_people(read_people(people))
    sources: list[SyntheticBatches | RecordedBatches] = []
    if CORPUS in training:
        sources.append(SyntheticBatches(workspace, "train", names, gaze.process.bin_frames))
    if PEOPLE in training:
        sources.append(RecordedBatches(train, bin_s, channels))
    steps = loop.steps if CORPUS in training else PEOPLE_STEPS
    task = ProcessTask(process, sources, loop.batch, weights, rng)
    train_network(
        task,
        loop.model_copy(update={"steps": steps, "validate_every": steps}),
        f"{' and '.join(training)}, seed {seed}",
    )
    domain = DOMAINS[PEOPLE] if PEOPLE in training else DOMAINS[CORPUS]
    found: dict[str, ndarray] = {
        state: score_people(process, validation, state, domain, bin_s, channels) for state in STATES
    }
    clips = SyntheticBatches(workspace, "val", names, gaze.process.bin_frames)
    rng = np.random.default_rng(seed)
    sampled = {name: sample_clips(process, clips, DOMAINS[name], rng) for name in training}
    return Result(found, *score_clips(process, clips), sampled)


@dataclass
class ProcessTask:
    """Trains a process with a batch of each source in each step (training/loop.py)."""

    module: PointProcess
    sources: Sequence[SyntheticBatches | RecordedBatches]
    batch: int
    weights: Mapping[str, float]
    rng: np.random.Generator

    def losses(self, step: int) -> dict[str, Tensor]:
        """Sum of the losses of all sources."""
        total = torch.zeros(())
        for source in self.sources:
            terms = self.module.loss_terms(*source.sample(self.batch, self.rng))
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
    for index in range(len(clips.lengths)):
        events, condition = clips.whole(index)
        masked = condition.clone()
        masked[..., :-INPUTS] = 0.0
        rows.append([float(sum(process.log_likelihood(events, each).values())) for each in (condition, masked)])
    own, masked_speech = np.array(rows).T
    speakers = [each.clip.speaker for each in clips.recordings]
    return speakers, clips.lengths / clips.recordings[0].clip.fps, own, masked_speech


@torch.no_grad()
def sample_clips(process: PointProcess, clips: SyntheticBatches, domain: float, rng: np.random.Generator) -> Sampled:
    """Samples for the val sounds, as if recorded in a domain."""
    motions = {}
    for index, recording in enumerate(clips.recordings):
        condition = clips.whole(index)[1]
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
    work = parallel_map(partial(_run, path), variants, JOBS, "recorded fixations")
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
    clips = SyntheticBatches(workspace, "val", settings.speech.channels or (), settings.gaze.process.bin_frames)
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


def _run(path: Path, variant: tuple[tuple[str, ...], int]) -> Result:
    return run(path, *variant)


if __name__ == "__main__":
    run_command(main)
