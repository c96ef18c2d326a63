"""The acceptance table: what a corpus has of how people's eyes, head, lids and jaw move, and what recorded people have.

Run     python -m pipelines.facts [CORPUS]        (make facts; make facts corpus=DIR)
Reads   the corpus of the workspace, or CORPUS; data/fit and data/embed beside it, where they are there; recordings of
        people in ../shared/data/real/gaze, where they are there
Writes  docs/facts.md and docs/pictures/facts-*.png; of another CORPUS build/facts/

No stage: nothing reads it, and it reads what several stages have made. Takes of a synthetic corpus are drawn again from
their seeds, which gives the same events, and rendered at 500, 120, 60 and 25 frames a second.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipelines.facts_link import MOST_CLIPS, of_probes, of_towers
from talkingeyes.audio.prosody import ProsodySettings, prosody
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings_of_people import read_andersson, read_conversation, read_openface
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.contrast import CriticSettings
from talkingeyes.evaluation.facts import blinks, figures, page, people, plots, probes, pupils, saccades
from talkingeyes.evaluation.facts.clip import Pool, Seen, Sounding, joined, missing
from talkingeyes.evaluation.facts.figures import RATES_FPS, Figures
from talkingeyes.evaluation.facts.source import Source, motion_of
from talkingeyes.orchestration.run import Workspace, clip_parallel, each, shell
from talkingeyes.physiology.blinks import PAPER, PHYSIO, draw_rate_per_min
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.speakers import draw_style
from talkingeyes.synthesis.take import Take, perform

RECORDED = Path(__file__).resolve().parents[2] / "shared/data/real/gaze"
MOST_NATIVE, MOST_RAW = 300, 100
FURTHER_TAKES = range(1000, 1004)
CANDIDATES = 40  # for the timeline
CONVERSATION = "conversation_fixations.csv.gz"
SOUND_AND_MOTION = ("eye_r2", "averted_auc", "head_r2", "match_space", "match_gaze", "match_gaze_p", "match_jaw")
DRAWN_SPEAKERS, DRAWN_RATES = 500, 1000


@dataclass(frozen=True)
class Found:
    """Figures of a corpus by fact, and what plots are drawn from."""

    pool: Pool
    figures: Figures


def source_of(workspace: Workspace, corpus: Path) -> Source:
    """The corpus with what stands beside it. Raises InputError if there is none."""
    found = Corpus(corpus)
    if not found.clips:
        raise InputError(f"{corpus}: should hold clips, got none; `make repro` makes a corpus")
    settings = workspace.settings("synthesize", plan.SynthesizeSettings) if found.has_truth else None
    data = corpus.parent
    return Source(
        found,
        data / "fit",
        data / "embed",
        workspace.settings("embed.prosody", ProsodySettings),
        workspace.settings("critic", CriticSettings),
        settings,
    )


def see(source: Source, clip: Clip) -> Seen:
    """One clip with what is known of it."""
    motion, annotation = motion_of(source, clip), source.corpus.annotation(clip)
    speech = source.corpus.speech(clip)
    heard = prosody(speech, motion.fps, source.prosody)
    fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
    return Seen(
        speaker=clip.speaker,
        sound=clip.sound,
        behaviour=behaviour(motion.fps, fields, motion.valid, annotation),
        motion=motion,
        annotation=annotation,
        sounding=Sounding(heard.energy_dbfs, heard.f0_hz),
        events=source.corpus.truth_events(clip) if source.corpus.has_truth else None,
        squint_rad=squint_rad(source, clip),
    )


def squint_rad(source: Source, clip: Clip) -> float:
    """By how much the optical axes of a synthetic speaker's eyes part more than the lines of sight."""
    if source.settings is None:
        return 0.0
    left, right = plan.speaker_of(source.settings, sound_of(source.settings, clip)).style.kappa
    return left[0] - right[0]


def sound_of(settings: plan.SynthesizeSettings, clip: Clip) -> plan.Sound:
    """The sound of the plan that a clip is a take of."""
    return plan.sounds(settings)[int(clip.sound.rsplit("-", 1)[1])]


def observe_sound(source: Source, takes: Sequence[Clip]) -> dict[str, np.ndarray]:
    """All takes of one sound, and how they differ."""
    seen = [see(source, clip) for clip in takes]
    pool = joined(figures.observe(one) for one in seen)
    if len(takes) > 1:
        parts = {
            "eye": [one.behaviour.eye_rad.mean(axis=1) for one in seen],
            "head": [one.behaviour.head for one in seen],
            "jaw": [one.motion.jaw[:, :1] for one in seen if one.motion is not None],
        }
        pool |= {f"takes.{part}": probes.drawn_share(np.stack(each))[None] for part, each in parts.items()}
    return pool


def drawn(source: Source, clip: Clip, take: int) -> Take:
    """A take of the sound of a clip from its seeds: one that the corpus holds, or a further one."""
    settings = source.settings
    assert settings is not None
    sound = sound_of(settings, clip)
    random = plan.generator(settings.seed, "motion", sound.index, take)
    annotation, style = source.corpus.annotation(clip), plan.speaker_of(settings, sound).style
    return perform(annotation, style, clip.seconds, random, settings.blink_profile)


def drawn_again(source: Source, clip: Clip) -> Take:
    """The take of a clip. Raises InputError if it is not the one that the corpus holds."""
    take = drawn(source, clip, clip.take)
    if take.events != source.corpus.truth_events(clip):
        raise InputError(f"{clip.id}: drawn again it has other events; the corpus is of other settings or code")
    return take


def observe_further(source: Source, clip: Clip) -> dict[str, np.ndarray]:
    """Large gaze shifts of takes that the corpus does not hold: it has too few of them for a figure."""
    found = []
    for number in FURTHER_TAKES:
        motion = drawn(source, clip, number).motion(clip.fps, int(clip.seconds * clip.fps))
        fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
        found.append(figures.observe_shifts(behaviour(motion.fps, fields, motion.valid)))
    return joined(found)


def observe_rates(source: Source, clip: Clip) -> dict[str, np.ndarray]:
    """Saccades of a take at all frame rates, and its blinks at the highest."""
    take = drawn_again(source, clip)
    pool: dict[str, np.ndarray] = {}
    finest = None
    for fps in RATES_FPS:
        motion = take.motion(float(fps), int(clip.seconds * fps))
        seen = behaviour(motion.fps, {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid})
        found = saccades.rendered(seen)
        finest = found if finest is None else finest
        pool |= saccades.of_rate(f"at{fps}", seen, found)
        pool |= saccades.same(f"same{fps}", finest, found)
        if fps == RATES_FPS[0]:
            pool |= blinks.observe_fast(seen)
    return pool


def of_corpus(source: Source, jobs: int) -> Found:
    """All figures of a corpus, and the pool that plots are drawn from."""
    sounds = chosen(source.corpus.clips)
    firsts = [takes[0] for takes in sounds]
    pool = joined(each(partial(observe_sound, source), sounds, jobs, "facts: clips"))
    found = figures.of_gaze(pool) | figures.of_head(pool) | figures.of_speech(pool) | figures.of_prosody(pool)
    found |= figures.of_blinks(pool) | figures.of_lids(pool) | figures.of_takes(pool)
    found |= (
        figures.of_shifts(pool) | of_draws(source) | figures.of_heads() | of_fit(source) | of_pupils(source, firsts)
    )
    if source.settings is not None:
        fast = joined(each(partial(observe_rates, source), firsts[:MOST_NATIVE], jobs, "facts: frame rates"))
        more = joined(each(partial(observe_further, source), firsts[:MOST_NATIVE], jobs, "facts: further takes"))
        found |= (
            figures.of_shifts(more)
            | figures.of_rates(fast)
            | figures.of_courses(fast)
            | {"lag": figures.onset_lag(pool)}
        )
        pool = {**pool, **fast}
    if (source.embed / "embedding.json").is_file():
        found |= of_probes(source, firsts, jobs) | of_towers(source, jobs)
    else:
        found |= dict.fromkeys(SOUND_AND_MOTION, missing("no speech features: the stage embed has not run"))
    return Found(pool, found)


def of_draws(source: Source) -> Figures:
    """Rates of blinks as they are drawn, for people and for the paper's profile."""
    seed = source.settings.seed if source.settings else 0
    random = np.random.default_rng(seed)
    people = (plan.generator(seed, "speaker", index) for index in range(DRAWN_SPEAKERS))
    return figures.of_draws(
        [draw_rate_per_min(PAPER, random) for _ in range(DRAWN_RATES)],
        [draw_style(each, PHYSIO).blinks_per_min for each in people],
    )


def of_fit(source: Source) -> Figures:
    """Table VIII, if the corpus has been fitted."""
    path = source.fit / "table8.json"
    if not path.is_file():
        return dict.fromkeys(("fit_error", "fit_peak", "fit_speed"), missing("not fitted: the stage fit has not run"))
    return figures.of_fit(json.loads(path.read_text()))


def of_pupils(source: Source, clips: Sequence[Clip]) -> Figures:
    """The simulated fitter and the projection; both want the truth."""
    if not source.corpus.has_truth:
        return dict.fromkeys(("raw_error", "raw_speed", "projected"), missing("no true motion"))
    random, rows = np.random.default_rng(0), []
    for clip in clips[:MOST_RAW]:
        truth, events = source.corpus.truth(clip), source.corpus.truth_events(clip)
        rows.append(pupils.gaze360_like(truth, events, source.corpus.observation(clip), random))
    camera = source.corpus.observation(clips[0]).camera
    return figures.of_pupils({"raw.sums": np.concatenate(rows)}, pupils.projected_px(camera))


def chosen(clips: Sequence[Clip]) -> list[list[Clip]]:
    """Sounds with all their takes, spread evenly over the corpus."""
    takes: dict[str, list[Clip]] = {}
    for clip in clips:
        takes.setdefault(clip.sound, []).append(clip)
    every = max(1, -(-len(clips) // MOST_CLIPS))
    return list(takes.values())[::every]


@dataclass(frozen=True)
class Recorded:
    """Figures of recorded people, and their saccades, by the letter that the page gives a source."""

    figures: dict[str, Figures]
    pools: dict[str, Pool]


def of_people(folder: Path) -> Recorded:
    """What the recordings in a folder tell; nothing where there is none."""
    tracked = [read_andersson(path).recording for path in sorted(folder.glob("andersson_*_MN.mat"))]
    filmed = [read_openface(path) for path in sorted(folder.glob("openface_*.csv.gz"))]
    found, pools = {}, {}
    if tracked:
        found["T"], pools["T"] = people.of_tracking(tracked), people.tracking_pool(tracked)
    if (folder / CONVERSATION).is_file():
        talk = read_conversation(folder / CONVERSATION)
        found["C"], pools["C"] = people.of_conversation(talk), people.conversation_pool(talk)
    if filmed:
        found["V"] = people.of_video(filmed)
    return Recorded(found, pools)


def shown(source: Source) -> Clip:
    """The clip of the timeline: of the first with several aversions and blinks, listening if any clip does."""
    best, most = source.corpus.clips[0], -1
    for clip in source.corpus.clips[:CANDIDATES]:
        seen = see(source, clip)
        assert seen.annotation is not None
        events = min(int(seen.behaviour.states.dwell_averted.sum()), 3) + min(len(seen.behaviour.blinks), 3)
        value = events + 10 * bool(seen.annotation.listening)
        if value > most:
            best, most = clip, value
    return best


def write(out: Path, source: Source, found: Found, recorded: Recorded, what: str) -> None:
    """The page and its pictures; each file is written beside its place and put there whole."""
    pictures = out / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, Callable[[Path], None]] = {
        "distributions": partial(plots.distributions, found.pool, recorded.pools),
        "timeline": lambda path: plots.timeline(see(source, clip), source.corpus.speech(clip), path),
    }
    clip = shown(source)
    if f"at{RATES_FPS[0]}.amplitude_deg" in found.pool:
        drawn = {"main-sequence": partial(plots.main_sequence, found.pool), **drawn}
    for name, draw in drawn.items():
        whole(pictures / f"facts-{name}.png", draw)
    links = {name: f"pictures/facts-{name}.png" for name in drawn}
    text = page.markdown(found.figures, recorded.figures, what, links)
    whole(out / "facts.md", lambda path: path.write_text(text))


def whole(path: Path, write_to: Callable[[Path], object]) -> None:
    """A file that appears when it is finished."""
    partial_path = path.with_name(f".{path.name}.partial")
    write_to(partial_path)
    partial_path.replace(path)


def described(source: Source) -> str:
    """A corpus in words: nothing of the machine, so that the page is the same everywhere."""
    clips = source.corpus.clips
    minutes = sum(clip.seconds for clip in clips) / 60
    speakers = len({clip.speaker for clip in clips})
    kind = "synthetic, true motion" if source.corpus.has_truth else "tracked, fitted motion"
    sounds = len({clip.sound for clip in clips})
    return f"{kind}, {len(clips)} clips of {sounds} sounds, {speakers} speakers, {minutes:.0f} minutes"


def main() -> None:
    """Measure, print, write."""
    workspace = Workspace.open(Path.cwd())
    if len(sys.argv) > 2:
        raise InputError(f"facts: should get one corpus or none, got {' '.join(sys.argv[1:])}")
    other = Path(sys.argv[1]) if sys.argv[1:] else None
    source = source_of(workspace, other or workspace.corpus)
    out = workspace.root / (Path("docs") if other is None else Path("build", "facts"))
    with clip_parallel(workspace.params.get("machine", {})):
        found = of_corpus(source, workspace.jobs)
    recorded = of_people(RECORDED)
    write(out, source, found, recorded, described(source))
    print(page.as_text(found.figures, recorded.figures))
    print(f"written: {out / 'facts.md'}")


if __name__ == "__main__":
    shell(main)
