"""Comparison of a model's motion with the reference ranges of human behaviour, at 25 and at 120 fps.

Run     python -m pipelines.reference_ranges_model [MODEL]       (default talkingeyes_events; after make repro)
Reads   the corpus, data/embed, data/train/MODEL; sounds that no model was trained on
Writes  docs/reference_ranges_model.md and .csv; for another model than the default build/reference_ranges/MODEL.md

Each sound is animated SAMPLES times, with blinks and with its partner's voice if it has one (listening depends on it),
and rendered at both rates, and at 500 fps for the main sequence. A further column has the model's output without
post-processing. The true motion of the same sounds at 25 fps is shown for comparison: ranges that it also misses are
due to the small amount of motion. Not a stage: nothing reads its output. Rows of jaws, lids and of the fit do not apply
to a model of head and gaze.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from pipelines.reference_ranges import axis_divergence_rad, extract_sound, source_of
from pipelines.result_tables import as_csv, read_tables
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls
from talkingeyes.audio.prosody import prosody
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.paper_metrics.table3 import markdown_table
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
# The model's own rate, a display rate, and the rate for the main sequence.
OWN_FPS, SCREEN_FPS, MAIN_SEQUENCE_FPS = 25.0, 120.0, 500.0
INTRODUCTION = """# Reference ranges: the default model

Written by `python -m pipelines.reference_ranges_model{words}`: motion of the model for {sounds} sounds that it was not
trained on, {samples} samples each, with the partner's voice where there is one, compared with
[reference ranges](reference_ranges.md) of head, gaze and blinks. The model is conditioned on the speaker; an unseen
speaker is replaced by a fixed random training speaker.

| motion | ranges |
| --- | --- |
| at 25 fps | {slow} |
| at 120 fps | {fast} |
| as sampled, 25 fps | {sampled} |
| true motion of the same sounds, 25 fps | {truth} |

"As sampled" (`--no-postprocessing`) has no partner and no rule-based layers: listening, saccadic intrusions, the head
contribution to large gaze shifts ([whole.md](whole.md)). It has blinks. Ranges that the truth also misses are due to
the small amount of motion. The main sequence is measured at 500 fps.

"""
OUTSIDE = """## Outside the range

Statistics with a value outside their range; all are in [{data_file}]({data_file}).

"""


@dataclass(frozen=True)
class AnimationPools:
    """Pooled arrays of one sound: animations at 25 and at 120 fps, unprocessed animations at 25 fps, and the truth."""

    slow: PooledArrays
    fast: PooledArrays
    sampled: PooledArrays
    true: PooledArrays


def main() -> None:
    """Animate, measure, print and write."""
    workspace = Workspace.open(Path.cwd())
    if len(sys.argv) > 2:
        raise InputError(f"reference_ranges_model: should get one model or none, got {' '.join(sys.argv[1:])}")
    name = sys.argv[1] if sys.argv[1:] else "talkingeyes_events"
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
    slow, fast, sampled, true = (
        join_pools(pools) for pools in zip(*((one.slow, one.fast, one.sampled, one.true) for one in found), strict=True)
    )
    columns = [
        measure_with_main_sequence(order_by_take(slow)),
        measure_pool(order_by_take(fast)),
        measure_with_main_sequence(order_by_take(sampled)),
        measure_pool(true),
    ]
    text = markdown(columns, len(clips), f" {name}" if sys.argv[1:] else "")
    out = (
        Path("docs/reference_ranges_model.md")
        if name == "talkingeyes_events"
        else Path("build/reference_ranges", f"{name}.md")
    )
    (workspace.root / out).parent.mkdir(parents=True, exist_ok=True)
    for path, content in (
        (out, page_of(text, f"{out.stem}.csv")),
        (out.with_suffix(".csv"), as_csv([read_tables(text)["Statistics"]])),
    ):
        with atomic_write(workspace.root / path) as temporary:
            temporary.write_text(content)
    print(text)


@lru_cache(maxsize=1)
def _performer(model: Path) -> Animator:
    """The model, loaded once per process."""
    return Animator.load(model)


def extract(corpus_inputs: CorpusInputs, model: Path, numbered: tuple[int, Clip]) -> AnimationPools:
    """Pooled arrays of one sound, animated with its own seeds, and of its truth.

    With equal seeds for all sounds, all would start with the same random numbers: vergence, which hardly changes within
    a clip, would have only as many values as there are seeds.
    """
    format_number, clip = numbered
    embedding = np.array(Recordings([clip], corpus_inputs.fit, corpus_inputs.embed)[0].speech)
    animator, sound = _performer(model), corpus_inputs.corpus.speech(clip)

    def made(fps: float, controls: Controls) -> list[Motion]:
        animations = animator.generate_from_embedding(embedding, SAMPLES, SAMPLES * format_number, fps, controls, sound)
        return [each.motion for each in animations]

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
    """An animation with the data of its sound; the model has no jaw."""
    sound_prosody = prosody(corpus_inputs.corpus.speech(clip), motion.fps, corpus_inputs.prosody)
    annotation = corpus_inputs.corpus.annotation(clip)
    fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
    frames = len(motion)
    return ClipData(
        speaker=clip.speaker,
        sound=clip.sound,
        behaviour=behaviour(motion.fps, fields, motion.valid, annotation),
        annotation=annotation,
        frame_prosody=FrameProsody(sound_prosody.energy_dbfs[:frames], sound_prosody.f0_hz[:frames]),
        axis_divergence_rad=axis_divergence_rad(corpus_inputs, clip),
    )


def extract_main_sequence(finest: Motion, coarse: Motion) -> PooledArrays:
    """Saccades at 500 fps, the same ones at 25 fps, and the kinematics of blinks."""
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
    """Order styles by sample, then by sound: half minutes of a speaker then combine several sounds, like those of the
    truth, instead of samples of a single sound."""
    styles = {name: values.reshape(-1, SAMPLES).T.ravel() for name, values in pool.items() if name.startswith("style.")}
    return {**pool, **styles}


def measure_pool(pool: PooledArrays) -> Measurements:
    """Rows for head, gaze and blinks at one rate."""
    found = measurements.measure_gaze(pool) | measurements.measure_head(pool) | measurements.measure_speech(pool)
    found |= measurements.measure_blinks(pool) | measurements.measure_gaze_shifts(pool)
    found |= {"prosody_cca": head.sentence_correlation(pool), "pitch_level_correlation": head.frame_correlation(pool)}
    return found


def measure_with_main_sequence(pool: PooledArrays) -> Measurements:
    """These rows, and those of the main sequence and of the kinematics of blinks."""
    return measure_pool(pool) | measurements.measure_main_sequence(pool) | measurements.measure_blink_kinematics(pool)


def markdown(columns: Sequence[Measurements], sounds: int, words: str) -> str:
    """The whole table: rows of the reference ranges, with columns for the rates and the truth."""
    headings = ["", "reference range", "25 fps", "120 fps", "25 fps, as sampled", "truth, 25 fps"]
    rows = []
    for reference_range in REFERENCE_RANGES:
        if any(reference_range.name in each for each in columns):
            cells = [cell(reference_range, each.get(reference_range.name)) for each in columns]
            label = page.label(reference_range).replace("|", "\\|")
            rows.append([label, page.range_text(reference_range), *cells])
    slow, fast, sampled, truth = map(counts, columns)
    introduction = INTRODUCTION.format(
        words=words, sounds=sounds, samples=SAMPLES, slow=slow, fast=fast, sampled=sampled, truth=truth
    )
    return introduction + f"## Statistics\n\n{markdown_table(headings, rows)}\n"


def page_of(text: str, data_file: str) -> str:
    """The page: the introduction, and the statistics with a value outside their range."""
    table = read_tables(text)["Statistics"]
    rows = table.markdown(table.columns, lambda row: any("**outside**" in cell for cell in row))
    return f"{text.partition('## Statistics')[0]}{OUTSIDE.format(data_file=data_file)}{rows}\n"


def counts(found: Measurements) -> str:
    """Numbers of measured rows within and outside their ranges."""
    verdicts = [
        page.range_status(reference_range, found[reference_range.name])
        for reference_range in REFERENCE_RANGES
        if reference_range.name in found
    ]
    return f"{verdicts.count('within')} within, {verdicts.count('outside')} outside"


def cell(reference_range: ReferenceRange, found: Measurement | None) -> str:
    """A value, marked if it is outside its range."""
    if found is None or found.value is None:
        return "" if found is None else f"- ({found.reason})"
    return f"{page.format_number(found.value)}{'' if reference_range.contains(found.value) else ' **outside**'}"


if __name__ == "__main__":
    run_command(
        importlib.import_module("pipelines.reference_ranges_model").main
    )  # by module name, so that worker processes can import `extract`
