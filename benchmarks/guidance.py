"""How gaze depends on its guidance: what speech tells about it, its amount and its spread, for trained models.

Run     python -m pipelines.experiment experiment=development target=embed    (once)
        python -m benchmarks.guidance [MODEL ...]    (folders of the train stage or packed files; by default the
        packaged models and data/train/talkingeyes_events)
Reads   build/development/data: synthesize, embed; the models
Writes  a row of the true motion, then a table for each model with a row for each of GUIDANCE: time / location

The corpus has people and sounds that no model was trained on and no report reads, so that guidance can be chosen by it.
A model that takes the speaker gets a random training speaker for each sound, as in the stage `sample`. Its settings say
which guidance it has; all others are tried by the same weights.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL, PACKAGED_MODEL, open_model
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.aversion_information import SoundAversion, aversion_information, sound_aversion
from talkingeyes.evaluation.benchmark.comparison import Accumulator, extract
from talkingeyes.evaluation.benchmark.paired import sample_behaviours
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.text_tables import markdown_row
from talkingeyes.models.gaze.point_process import PointProcessGaze
from talkingeyes.models.layers.numpy_point_process import Guidance
from talkingeyes.orchestration.run import parallel_map, run_command
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.motion_generators import NetworkGenerator, load_generator, required_inputs, training_speakers

DATA = Path("build/development/data")
MODELS = (PACKAGED_MODEL, PACKAGED_LIVE_MODEL, Path("data/train/talkingeyes_events"))
GUIDANCE = ((1.0, 1.0), (1.0, 1.5), (1.5, 1.5), (1.5, 2.0), (1.5, 2.5), (2.0, 2.0), (2.0, 2.5), (2.5, 2.5))
SAMPLES = 2
METRIC_NAMES = (
    "speech_onset/rise",
    "speech_offset/rise",
    "turn_start/rise",
    "turn_end/rise",
    "hesitation/rise",
    "partner_gaze/fraction",
    "partner_gaze/aversion_rate",
    "saccades/rate",
)
JOBS = 2
SPLITS = ("train", "val", "test", "unseen")
BOOTSTRAP = BootstrapSettings(n_resamples=1000, confidence_level=0.95, seed=0)


@dataclass(frozen=True)
class SoundGaze:
    """Aversion in the motions of one sound, and sums of the benchmark."""

    aversion: SoundAversion
    sums: Float[ndarray, " K"]


def measure(corpus: Corpus, clip: Clip, samples: Samples) -> SoundGaze:
    """Measure the motions of one sound."""
    motions = sample_behaviours(samples, corpus.annotation(clip))
    return SoundGaze(sound_aversion(clip.speaker, motions), extract(motions))


def sampled(data: Path, model: Path, factors: tuple[float, float]) -> list[SoundGaze]:
    """Measure samples of a model for every sound; the seeds are the same for all models and factors."""
    generator, corpus = load_generator(model), Corpus(data / "synthesize")
    if not isinstance(generator, NetworkGenerator) or not isinstance(generator.network.gaze, PointProcessGaze):
        raise InputError(f"{model}: should be a model of head and gaze with events of gaze, got another")
    time, location = factors
    generator.network.gaze.guidance = Guidance(time=time, location=location)
    paths = ConditioningPaths(corpus, data / "embed")
    conditions = ConditioningProvider(required_inputs(generator), training_speakers(generator), (), paths)
    found = []
    for clip in corpus.select(*SPLITS, take=0):
        embedding = np.load(shard_path(data / "embed" / "speech", clip.sound, ".npy"))
        seeds = np.random.default_rng(list(clip.id.encode())).integers(2**31, size=SAMPLES).tolist()
        inputs = conditions.clip_inputs(clip, len(embedding))
        found.append(measure(corpus, clip, generator.generate(embedding, seeds, clip.fps, inputs)))
    return found


def true(data: Path) -> list[SoundGaze]:
    """Measure the true motion of every sound."""
    corpus = Corpus(data / "synthesize")
    motions = ((clip, corpus.truth(clip)) for clip in corpus.select(*SPLITS, take=0))
    return [measure(corpus, clip, Samples(each.fps, each.head[None], each.gaze[None])) for clip, each in motions]


def print_row(name: str, sounds: Sequence[SoundGaze]) -> None:
    """Print a row of the table."""
    sums = Accumulator(25.0)
    for sound in sounds:
        sums.add(sound.sums)
    aversions = [sound.aversion for sound in sounds]
    # As much motion for each row: with less, the regression overfits more.
    first = [replace(each, averted=each.averted[:1], seconds=each.seconds / len(each.averted)) for each in aversions]
    found = aversion_information(first, BOOTSTRAP)
    chosen = {each.name: each for each in METRICS}
    values = [float(chosen[name].compute(sums.totals())[0]) for name in METRIC_NAMES]  # type: ignore[misc]
    spread = float(np.mean([each.averted.mean(axis=1).std() for each in aversions]))
    information = f"{found.value:.4f} ({found.low:.4f} to {found.high:.4f})"
    print(markdown_row([name, information, *(f"{value:.3f}" for value in (*values, spread))]), flush=True)


def main() -> None:
    """Print the tables."""
    headings = ["", "nats per second", *METRIC_NAMES, "averted, SD over samples"]
    for cells in (headings, ["---"] * len(headings)):
        print(markdown_row(cells))
    print_row("truth", true(DATA))
    with ExitStack() as stack:
        for path in [Path(each) for each in sys.argv[1:]] or MODELS:
            model = path if path.is_dir() else stack.enter_context(open_model(path))
            print(f"\n{path.name}")
            measured = parallel_map(partial(sampled, DATA, model), GUIDANCE, JOBS, path.name)
            for (time, location), sounds in zip(GUIDANCE, measured, strict=True):
                print_row(f"{time:g} / {location:g}", sounds)


if __name__ == "__main__":
    run_command(main)
