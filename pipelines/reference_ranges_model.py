"""The acceptance table of a model: does motion that it makes move like people, at 25 and at 120 frames a second?

Run     python -m pipelines.reference_ranges_model [MODEL]       (default talkingeyes; after make repro)
Reads   the corpus, data/embed, data/train/MODEL; sounds that no model was trained on
Writes  docs/reference_ranges_model.md; of another model than the default build/reference_ranges/MODEL.md

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

from pipelines.reference_ranges import axis_divergence_rad, extract_sound, source_of, write_atomically
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls
from talkingeyes.audio.prosody import prosody
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.paper_metrics.table3 import markdown_row
from talkingeyes.evaluation.reference_ranges import blinks, head, measurements, page, saccades
from talkingeyes.evaluation.reference_ranges.clip_data import (
    ClipData,
    FrameProsody,
    Measurement,
    PooledArrays,
    join_pools,
)
from talkingeyes.evaluation.reference_ranges.corpus_inputs import CorpusInputs
from talkingeyes.evaluation.reference_ranges.measurements import Measurements
from talkingeyes.evaluation.reference_ranges.ranges import REFERENCE_RANGES, ReferenceRange
from talkingeyes.orchestration.run import Workspace, parallel_backend, parallel_map, run_command
from talkingeyes.training.conditioning import speaker_index

HELD_OUT_SPLITS = ("val", "test", "unseen")
SAMPLES = 16
# The model's own rate, that of a screen, and that of the law of saccades.
OWN_FPS, SCREEN_FPS, MAIN_SEQUENCE_FPS = 25.0, 120.0, 500.0
INTRODUCTION = """# Reference ranges: the default model

Written by `python -m pipelines.reference_ranges_model{words}`: motion of the model for {sounds} sounds that it was not
trained on, {samples} samples each, with the partner's voice where there is one, against the bands of
[reference_ranges.md](reference_ranges.md), at 25 and at 120 frames a second; the law of saccades at 500. Beside it the
true motion of the same sounds at 25 (its own rows of the law: [reference_ranges.md](reference_ranges.md)). A model that
knows speakers is told who speaks; whom it does not know is one of them, always the same.

**At 25 frames a second {slow}; at 120 {fast}; as drawn {drawn}; of the truth {truth}.** Left out is what is not head,
gaze or blinks. Listening, saccadic intrusions, blinks, and the head's part in far gaze are laws laid over what the
model draws ([whole.md](whole.md)): the column "as drawn" has none of them but blinks, and no partner
(`--no-postprocessing`).

"""


@dataclass(frozen=True)
class AnimationPools:
    """What is read off the performances of one sound at 25 and at 120 frames a second, off those of the model alone at
    25, and off the truth."""

    slow: PooledArrays
    fast: PooledArrays
    drawn: PooledArrays
    true: PooledArrays


def main() -> None:
    """Perform, measure, print, write."""
    workspace = Workspace.open(Path.cwd())
    if len(sys.argv) > 2:
        raise InputError(f"reference_ranges_model: should get one model or none, got {' '.join(sys.argv[1:])}")
    name = sys.argv[1] if sys.argv[1:] else "talkingeyes"
    corpus_inputs, model = source_of(workspace, workspace.corpus), workspace.data("train", name)
    if not corpus_inputs.corpus.has_truth:
        raise InputError(f"{workspace.corpus}: should be a corpus with true motion, got one without")
    Animator.load(model)
    clips = [clip for clip in corpus_inputs.corpus.clips if clip.split in HELD_OUT_SPLITS and clip.take == 0]
    with parallel_backend(workspace.params.get("machine", {})):
        found = list(
            parallel_map(
                partial(extract, corpus_inputs, model),
                list(enumerate(clips)),
                workspace.jobs,
                f"reference ranges of {name}",
            )
        )
    slow, fast, drawn, true = (
        join_pools(pools) for pools in zip(*((one.slow, one.fast, one.drawn, one.true) for one in found), strict=True)
    )
    columns = [
        measure_with_main_sequence(order_by_take(slow)),
        measure_pool(order_by_take(fast)),
        measure_with_main_sequence(order_by_take(drawn)),
        measure_pool(true),
    ]
    text = markdown(columns, len(clips), f" {name}" if sys.argv[1:] else "")
    out = (
        Path("docs/reference_ranges_model.md")
        if name == "talkingeyes"
        else Path("build/reference_ranges", f"{name}.md")
    )
    (workspace.root / out).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(workspace.root / out, lambda path: path.write_text(text))
    print(text)


@lru_cache(maxsize=1)
def _performer(model: Path) -> Animator:
    """Loaded once a process."""
    return Animator.load(model)


def extract(corpus_inputs: CorpusInputs, model: Path, numbered: tuple[int, Clip]) -> AnimationPools:
    """One sound, performed by seeds of its own and as it was.

    By the same seeds, all sounds would begin with the same numbers: vergence, which hardly changes within a clip, would
    be that of so many draws as there are seeds.
    """
    format_number, clip = numbered
    embedding = np.array(Recordings([clip], corpus_inputs.fit, corpus_inputs.embed)[0].speech)
    animator, sound = _performer(model), corpus_inputs.corpus.speech(clip)

    def made(fps: float, controls: Controls) -> list[Motion]:
        drawn = animator.generate_from_embedding(embedding, SAMPLES, SAMPLES * format_number, fps, controls, sound)
        return [each.motion for each in drawn]

    def seen(motions: list[Motion]) -> PooledArrays:
        return join_pools(measurements.extract(load_clip_data(corpus_inputs, clip, motion)) for motion in motions)

    def with_finest(controls: Controls) -> PooledArrays:
        coarse, finest = made(OWN_FPS, controls), made(MAIN_SEQUENCE_FPS, controls)
        return {
            **seen(coarse),
            **join_pools(extract_main_sequence(*motions) for motions in zip(finest, coarse, strict=True)),
        }

    known = animator.persons
    person = known[speaker_index(known, clip.speaker, clip.speaker)] if known else None
    asked = Controls(partner=corpus_inputs.corpus.partner(clip), person=person)
    alone = with_finest(Controls(person=person, no_postprocessing=True))
    return AnimationPools(
        with_finest(asked), seen(made(SCREEN_FPS, asked)), alone, extract_sound(corpus_inputs, [clip])
    )


def load_clip_data(corpus_inputs: CorpusInputs, clip: Clip, motion: Motion) -> ClipData:
    """A performance with what is known of its sound; its jaw is not the model's."""
    heard = prosody(corpus_inputs.corpus.speech(clip), motion.fps, corpus_inputs.prosody)
    annotation = corpus_inputs.corpus.annotation(clip)
    fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
    frames = len(motion)
    return ClipData(
        speaker=clip.speaker,
        sound=clip.sound,
        behaviour=behaviour(motion.fps, fields, motion.valid, annotation),
        annotation=annotation,
        frame_prosody=FrameProsody(heard.energy_dbfs[:frames], heard.f0_hz[:frames]),
        axis_divergence_rad=axis_divergence_rad(corpus_inputs, clip),
    )


def extract_main_sequence(finest: Motion, coarse: Motion) -> PooledArrays:
    """Saccades at 500 frames a second, the same ones at 25, and the blinks' course."""
    high, low = (
        behaviour(each.fps, {"head": each.head, "gaze": each.gaze, "lid": each.lid}) for each in (finest, coarse)
    )
    found = saccades.detect_rendered(high)
    return {
        **saccades.extract_at_rate("at500", high, found),
        **saccades.match_frame_rates("same25", found, saccades.detect_rendered(low)),
        **blinks.extract_kinematics(high),
    }


def order_by_take(pool: PooledArrays) -> PooledArrays:
    """Styles of the first sample of every sound, then of the second: half minutes of a speaker are of several sounds
    then, as those of the truth are, and not of one sound again and again."""
    styles = {name: values.reshape(-1, SAMPLES).T.ravel() for name, values in pool.items() if name.startswith("style.")}
    return {**pool, **styles}


def measure_pool(pool: PooledArrays) -> Measurements:
    """The rows that head, gaze and blinks of one rate have."""
    found = measurements.measure_gaze(pool) | measurements.measure_head(pool) | measurements.measure_speech(pool)
    found |= measurements.measure_blinks(pool) | measurements.measure_gaze_shifts(pool)
    found |= {"cca": head.sentence_correlation(pool), "tie": head.frame_correlation(pool)}
    return found


def measure_with_main_sequence(pool: PooledArrays) -> Measurements:
    """The same, and the rows of the law of saccades and of the course of blinks."""
    return measure_pool(pool) | measurements.measure_main_sequence(pool) | measurements.measure_blink_kinematics(pool)


def markdown(columns: Sequence[Measurements], sounds: int, words: str) -> str:
    """The page: rows of the acceptance table, a column a rate, and the truth."""
    rows = [
        markdown_row(["", "band", "25 fps", "120 fps", "25 fps, as drawn", "truth, 25 fps"]),
        markdown_row(["---"] * 6),
    ]
    for reference_range in REFERENCE_RANGES:
        if any(reference_range.name in each for each in columns):
            cells = [cell(reference_range, each.get(reference_range.name)) for each in columns]
            rows.append(markdown_row([page.label(reference_range), page.range_text(reference_range), *cells]))
    slow, fast, drawn, truth = map(counts, columns)
    introduction = INTRODUCTION.format(
        words=words, sounds=sounds, samples=SAMPLES, slow=slow, fast=fast, drawn=drawn, truth=truth
    )
    return introduction + "\n".join([*rows, ""])


def counts(found: Measurements) -> str:
    """How many of the rows that were measured are in their bands, and how many are out."""
    verdicts = [
        page.range_status(reference_range, found[reference_range.name])
        for reference_range in REFERENCE_RANGES
        if reference_range.name in found
    ]
    return f"{verdicts.count('in')} are in, {verdicts.count('OUT')} out"


def cell(reference_range: ReferenceRange, found: Measurement | None) -> str:
    """A figure, and whether it is out."""
    if found is None or found.value is None:
        return "" if found is None else f"- ({found.reason})"
    return f"{page.format_number(found.value)}{'' if reference_range.contains(found.value) else ' **out**'}"


if __name__ == "__main__":
    run_command(
        importlib.import_module("pipelines.reference_ranges_model").main
    )  # by its name, so that worker processes find `extract`
