"""The acceptance table of a model: does motion that it makes move like people, at 25 and at 120 frames a second?

Run     python -m pipelines.facts_model [MODEL]       (default talkingeyes; after make repro)
Reads   the corpus, data/embed, data/train/MODEL; sounds that no model was trained on
Writes  docs/facts_model.md; of another model than the default build/facts/MODEL.md

Each sound is performed SAMPLES times, blinks included, with its partner's voice where it has one (or nobody would know
when to listen), and rendered at both rates, and at 500 for the law of saccades; once more as the model alone draws it.
Beside it stands the true motion of the same sounds at 25: what is out there as well is for want of motion. No stage:
nothing reads it. Rows of jaws, lids and of the fit are not a model's of head and gaze.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from pipelines.facts import observe_sound, source_of, squint_rad, whole
from talkingeyes.animation.direction import Direction
from talkingeyes.animation.perform import Performer
from talkingeyes.audio.prosody import prosody
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.windows import Recordings
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.facts import blinks, figures, head, page, saccades
from talkingeyes.evaluation.facts.acceptance import FACTS, Fact
from talkingeyes.evaluation.facts.clip import Measured, Pool, Seen, Sounding, joined
from talkingeyes.evaluation.facts.figures import Figures
from talkingeyes.evaluation.facts.source import Source
from talkingeyes.evaluation.table import line
from talkingeyes.orchestration.run import Workspace, clip_parallel, each, shell
from talkingeyes.training.telling import who_moves

UNHEARD = ("val", "test", "unseen")
SAMPLES = 16
# The model's own rate, that of a screen, and that of the law of saccades.
OWN_FPS, SCREEN_FPS, LAW_FPS = 25.0, 120.0, 500.0
INTRODUCTION = """# Facts of the default model

Written by `python -m pipelines.facts_model{words}`: motion of the model for {sounds} sounds that it was not trained on,
{samples} samples each, with the partner's voice where there is one, against the bands of [facts.md](facts.md), at 25
and at 120 frames a second; the law of saccades at 500. Beside it the true motion of the same sounds at 25 (its own rows
of the law: [facts.md](facts.md)). A model that knows speakers is told who speaks; whom it does not know is one of them,
always the same.

**At 25 frames a second {slow}; at 120 {fast}; as drawn {drawn}; of the truth {truth}.** Left out is what is not head,
gaze or blinks. Listening, saccadic intrusions, blinks, and the head's part in far gaze are laws laid over what the
model draws ([whole.md](whole.md)): the column "as drawn" has none of them but blinks, and no partner (`--as-drawn`).

"""


@dataclass(frozen=True)
class Performed:
    """What is read off the performances of one sound at 25 and at 120 frames a second, off those of the model alone at
    25, and off the truth."""

    slow: Pool
    fast: Pool
    drawn: Pool
    true: Pool


def main() -> None:
    """Perform, measure, print, write."""
    workspace = Workspace.open(Path.cwd())
    if len(sys.argv) > 2:
        raise InputError(f"facts_model: should get one model or none, got {' '.join(sys.argv[1:])}")
    name = sys.argv[1] if sys.argv[1:] else "talkingeyes"
    source, model = source_of(workspace, workspace.corpus), workspace.data("train", name)
    if not source.corpus.has_truth:
        raise InputError(f"{workspace.corpus}: should be a corpus with true motion, got one without")
    Performer.load(model)
    clips = [clip for clip in source.corpus.clips if clip.split in UNHEARD and clip.take == 0]
    with clip_parallel(workspace.params.get("machine", {})):
        found = list(each(partial(observe, source, model), list(enumerate(clips)), workspace.jobs, f"facts of {name}"))
    slow, fast, drawn, true = (
        joined(pools) for pools in zip(*((one.slow, one.fast, one.drawn, one.true) for one in found), strict=True)
    )
    columns = [with_law(by_take(slow)), of_pool(by_take(fast)), with_law(by_take(drawn)), of_pool(true)]
    text = markdown(columns, len(clips), f" {name}" if sys.argv[1:] else "")
    out = Path("docs/facts_model.md") if name == "talkingeyes" else Path("build/facts", f"{name}.md")
    (workspace.root / out).parent.mkdir(parents=True, exist_ok=True)
    whole(workspace.root / out, lambda path: path.write_text(text))
    print(text)


@lru_cache(maxsize=1)
def _performer(model: Path) -> Performer:
    """Loaded once a process."""
    return Performer.load(model)


def observe(source: Source, model: Path, numbered: tuple[int, Clip]) -> Performed:
    """One sound, performed by seeds of its own and as it was.

    By the same seeds, all sounds would begin with the same numbers: vergence, which hardly changes within a clip, would
    be that of so many draws as there are seeds.
    """
    number, clip = numbered
    embedding = np.array(Recordings([clip], source.fit, source.embed)[0].speech)
    performer, sound = _performer(model), source.corpus.speech(clip)

    def made(fps: float, direction: Direction) -> list[Motion]:
        drawn = performer.perform_embedded(embedding, SAMPLES, SAMPLES * number, fps, direction, sound)
        return [each.motion for each in drawn]

    def seen(motions: list[Motion]) -> Pool:
        return joined(figures.observe(see(source, clip, motion)) for motion in motions)

    def with_finest(direction: Direction) -> Pool:
        coarse, finest = made(OWN_FPS, direction), made(LAW_FPS, direction)
        return {**seen(coarse), **joined(of_law(*motions) for motions in zip(finest, coarse, strict=True))}

    known = performer.persons
    person = known[who_moves(known, clip.speaker, clip.speaker)] if known else None
    asked = Direction(partner=source.corpus.partner(clip), person=person)
    alone = with_finest(Direction(person=person, as_drawn=True))
    return Performed(with_finest(asked), seen(made(SCREEN_FPS, asked)), alone, observe_sound(source, [clip]))


def see(source: Source, clip: Clip, motion: Motion) -> Seen:
    """A performance with what is known of its sound; its jaw is not the model's."""
    heard = prosody(source.corpus.speech(clip), motion.fps, source.prosody)
    annotation = source.corpus.annotation(clip)
    fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
    frames = len(motion)
    return Seen(
        speaker=clip.speaker,
        sound=clip.sound,
        behaviour=behaviour(motion.fps, fields, motion.valid, annotation),
        annotation=annotation,
        sounding=Sounding(heard.energy_dbfs[:frames], heard.f0_hz[:frames]),
        squint_rad=squint_rad(source, clip),
    )


def of_law(finest: Motion, coarse: Motion) -> Pool:
    """Saccades at 500 frames a second, the same ones at 25, and the blinks' course."""
    high, low = (
        behaviour(each.fps, {"head": each.head, "gaze": each.gaze, "lid": each.lid}) for each in (finest, coarse)
    )
    found = saccades.rendered(high)
    return {
        **saccades.of_rate("at500", high, found),
        **saccades.same("same25", found, saccades.rendered(low)),
        **blinks.observe_fast(high),
    }


def by_take(pool: Pool) -> Pool:
    """Styles of the first sample of every sound, then of the second: half minutes of a speaker are of several sounds
    then, as those of the truth are, and not of one sound again and again."""
    styles = {name: values.reshape(-1, SAMPLES).T.ravel() for name, values in pool.items() if name.startswith("style.")}
    return {**pool, **styles}


def of_pool(pool: Pool) -> Figures:
    """The rows that head, gaze and blinks of one rate have."""
    found = figures.of_gaze(pool) | figures.of_head(pool) | figures.of_speech(pool)
    found |= figures.of_blinks(pool) | figures.of_shifts(pool)
    found |= {"cca": head.sentence_correlation(pool), "tie": head.frame_correlation(pool)}
    return found


def with_law(pool: Pool) -> Figures:
    """The same, and the rows of the law of saccades and of the course of blinks."""
    return of_pool(pool) | figures.of_rates(pool) | figures.of_courses(pool)


def markdown(columns: Sequence[Figures], sounds: int, words: str) -> str:
    """The page: rows of the acceptance table, a column a rate, and the truth."""
    rows = [line(["", "band", "25 fps", "120 fps", "25 fps, as drawn", "truth, 25 fps"]), line(["---"] * 6)]
    for fact in FACTS:
        if any(fact.name in each for each in columns):
            cells = [cell(fact, each.get(fact.name)) for each in columns]
            rows.append(line([page.named(fact), page.band(fact), *cells]))
    slow, fast, drawn, truth = map(counts, columns)
    introduction = INTRODUCTION.format(
        words=words, sounds=sounds, samples=SAMPLES, slow=slow, fast=fast, drawn=drawn, truth=truth
    )
    return introduction + "\n".join([*rows, ""])


def counts(found: Figures) -> str:
    """How many of the rows that were measured are in their bands, and how many are out."""
    verdicts = [page.verdict(fact, found[fact.name]) for fact in FACTS if fact.name in found]
    return f"{verdicts.count('in')} are in, {verdicts.count('OUT')} out"


def cell(fact: Fact, found: Measured | None) -> str:
    """A figure, and whether it is out."""
    if found is None or found.value is None:
        return "" if found is None else f"- ({found.reason})"
    return f"{page.number(found.value)}{'' if fact.met(found.value) else ' **out**'}"


if __name__ == "__main__":
    shell(importlib.import_module("pipelines.facts_model").main)  # by its name, so that worker processes find `observe`
