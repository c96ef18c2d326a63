"""Stage `assess`: the figures on val that models and settings are chosen by (test and unseen are for `evaluate`).

Run: python -m pipelines.assess talkingeyes
Reads: the corpus index and truth, data/fit, data/embed, data/critic, data/train/<model>.
Writes: data/assess/<model>/metrics.json {figure: value}: Corr. of the samples of each part, and of the fitted motion
beside it; distances of the distributions of eye speed and saccade amplitude from the truth's (from the fitted
motion's, in a corpus without truth), and their mean, `distance`; the same of how far gaze is from straight ahead,
`place_distance`; `apart`, by how many measures of the gaze benchmark the samples are worse than the truth by more than
the interval, of `apart_of`. benchmark.json: the benchmark itself.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.sounds import Sound, sounds
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.corpus.windows import Recordings, recordings
from talkingeyes.evaluation.benchmark.paired import Counted, Paired, compared, counted, of_motions, of_samples
from talkingeyes.evaluation.benchmark.sound import CRITICS, OTHER_SOUNDS, hear
from talkingeyes.evaluation.choosing import AssessSettings, Distances, Dynamics, distances, dynamics
from talkingeyes.evaluation.judges import Judges
from talkingeyes.models.condition.conditioner import NOTHING
from talkingeyes.orchestration.run import Report, Workspace, each, main
from talkingeyes.training.telling import Beside, Teller
from talkingeyes.training.trained import Generator, load_generator, needs, speakers_of


@dataclass(frozen=True)
class Sources:
    """Where the things lie that a model is assessed with."""

    corpus: Path
    fit: Path
    embed: Path
    critic: Path
    model: Path


@dataclass(frozen=True)
class Found:
    """Of one sound: Corr. by part, drawn and fitted; how the eyes move, drawn and true; its part of the benchmark."""

    corr: dict[str, float]
    corr_fitted: dict[str, float]
    drawn: Dynamics
    truth: Dynamics
    benchmark: Counted


def run(workspace: Workspace, name: str) -> Report:
    """Clip-parallel; every clip's seeds are its own."""
    settings = workspace.settings("assess", AssessSettings)
    data = workspace.data
    sources = Sources(workspace.corpus, data("fit"), data("embed"), data("critic"), data("train", name))
    with workspace.output("assess", name) as folder:
        work, benchmark = _sounds(sources, settings), Paired()
        found = list(each(partial(assess, sources, settings), work, workspace.jobs, f"assess {name}"))
        for one in found:
            benchmark.add(one.benchmark)
        table = benchmark.table(settings.bootstrap)
        figures = {
            **{_name("corr", part): _mean([clip.corr[part] for clip in found]) for part in CRITICS},
            **{_name("corr_fitted", part): _mean([clip.corr_fitted[part] for clip in found]) for part in CRITICS},
            **_named(distances([clip.drawn for clip in found], [clip.truth for clip in found])),
            "apart": float(table.apart),
            "apart_of": float(table.apart_of),
        }
        (folder / "metrics.json").write_text(json.dumps(figures, indent=1))
        (folder / "benchmark.json").write_text(table.json())
    return Report(metrics=figures, artifacts=[data("assess", name, "metrics.json")])


def _sounds(sources: Sources, settings: AssessSettings) -> list[Sound]:
    """The sounds of val whose first take was fitted."""
    corpus = Corpus(sources.corpus)
    found = sounds(corpus, sources.fit, sources.embed, ("val",), OTHER_SOUNDS, settings.seed)
    if not found:
        raise InputError(f"{corpus.root}: no fitted clip in val; a corpus needs clips in every split")
    return found


def assess(sources: Sources, settings: AssessSettings, sound: Sound) -> Found:
    """Draw samples for one sound and measure them."""
    corpus, clip = Corpus(sources.corpus), sound.clip
    fitted, *others = Recordings([clip, *sound.others], sources.fit, sources.embed)
    speech, judges = np.array(fitted.speech), _judges(sources.critic)
    seeds = np.random.default_rng([settings.seed, *clip.id.encode()]).integers(2**31, size=settings.samples).tolist()
    teller = _teller(sources)
    given = teller.whole(clip, len(speech)) if teller else NOTHING
    drawn = _generator(sources.model).generate(speech, seeds, clip.fps, given)
    own = _one(Motion.of(clip.fps, fitted.head.astype(float), fitted.gaze.astype(float)))
    under = [np.array(other.speech) for other in others]
    heard = hear(judges.critics, speech, under, drawn.head, drawn.gaze)
    takes = _takes(corpus, sources, sound)
    annotation = corpus.annotation(clip)
    beside = compared(of_samples(drawn, annotation), of_motions(takes, annotation))
    return Found(
        {part: float(heard[critic].own.mean()) for part, critic in CRITICS.items()},
        {part: float(judges.critics[critic](speech, own.head, own.gaze).mean()) for part, critic in CRITICS.items()},
        dynamics(drawn),
        dynamics(_one(takes[0]) if corpus.has_truth else own),
        counted(beside, heard, judges.critics, judges.encoder, speech, under),
    )


def _takes(corpus: Corpus, sources: Sources, sound: Sound) -> list[Motion]:
    """True motions of all takes; in a corpus without truth the fitted ones."""
    if corpus.has_truth:
        return [corpus.truth(take) for take in sound.takes]
    return [Motion.load(sharded(sources.fit / "motion", take.id, ".npz")) for take in sound.takes]


@lru_cache(maxsize=1)
def _generator(folder: Path) -> Generator:
    """Loaded once a process."""
    return load_generator(folder)


@lru_cache(maxsize=1)
def _teller(sources: Sources) -> Teller | None:
    """What says what else the model is told, if it is told anything; references are of the train split."""
    generator, corpus = _generator(sources.model), Corpus(sources.corpus)
    wanted = needs(generator)
    known = recordings(corpus, sources.fit, sources.embed, "train") if "reference" in wanted else ()
    return Teller(wanted, speakers_of(generator), known, Beside(corpus, sources.embed)) if wanted else None


@lru_cache(maxsize=1)
def _judges(folder: Path) -> Judges:
    """Loaded once a process."""
    return Judges.load(folder)


def _one(motion: Motion) -> Samples:
    return Samples(motion.fps, motion.head[None], motion.gaze[None])


def _name(figure: str, part: str) -> str:
    """Corr. of the eyes in the head is the paper's, and has the plain name."""
    return figure if part == "gaze" else f"{figure}_{part}"


def _named(found: Distances) -> dict[str, float]:
    return {
        "distance": found.mean,
        "eye_speed_distance": found.eye_speed,
        "saccade_amplitude_distance": found.saccade_amplitude,
        "place_distance": found.place,
    }


def _mean(values: list[float]) -> float:
    return float(np.mean(values))


if __name__ == "__main__":
    main(run)
