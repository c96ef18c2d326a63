"""Comparison of a model's motion with the reference ranges of human behaviour, at 25 and at 120 fps.

Run     python -m pipelines.reference_ranges_model [MODEL] [--split test]   (talkingeyes_events, val; after make report)
Reads   the corpus, data/fit, data/embed, data/train/MODEL and the models that it is compared with; sounds of val, or of
        test and unseen for a release
Writes  docs/reference_ranges_model.md and .csv; for another model or split build/reference_ranges/MODEL[-test].md

Each sound is animated SAMPLES times, with blinks and with its partner's voice if it has one (listening depends on it),
and rendered at both rates, and at 500 fps for the main sequence. A further column has the model's output without
post-processing, others that of the live model and of the baselines. The true and the fitted motion of all takes of the
same sounds, and fitted motion of other sounds of the speaker (Mismatched), are shown for comparison: ranges that the
truth also misses are due to the small amount of motion. Rows on sound and motion are of the motion as sampled: probes
of PROBED samples of the sounds, and towers trained on a sample for each of 600 training sounds. Not a stage: nothing
reads its output. Rows of jaws, lids and of the fit do not apply to a model of head and gaze, nor the lag of the head
behind the eyes, which needs true events.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.audio_motion_probes import (
    MotionsOf,
    measure_probes,
    measure_towers,
    reason_against_towers,
    reference_motions,
    tower_clips,
)
from pipelines.reference_ranges import axis_divergence_rad, extract_sound, source_of
from pipelines.result_tables import as_csv, read_tables
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls
from talkingeyes.audio.prosody import prosody
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.fitted_clips import motion_path
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.corpus.sound_groups import SoundGroup, group_sounds
from talkingeyes.corpus.store import shard_path
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.benchmark.metric_class import LEARNT
from talkingeyes.evaluation.reference_ranges import blinks, head, measurements, page, probes, saccades
from talkingeyes.evaluation.reference_ranges.clip_data import (
    ClipData,
    FrameProsody,
    Measurement,
    PooledArrays,
    join_pools,
)
from talkingeyes.evaluation.reference_ranges.corpus_inputs import CorpusInputs
from talkingeyes.evaluation.reference_ranges.measurements import Measurements
from talkingeyes.evaluation.reference_ranges.range_class import range_class
from talkingeyes.evaluation.reference_ranges.ranges import RANGES_BY_SECTION, REFERENCE_RANGES, ReferenceRange
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.run import Workspace, parallel_backend, parallel_map, run_command
from talkingeyes.training.conditioning import speaker_index

DEFAULT_MODEL = "talkingeyes_events"
SPLITS = {"val": ("val",), "test": ("test", "unseen")}
COMPARED = {"Live": "talkingeyes_live", "Random": "random", "Similar Sample": "similar", "Untrained": "untrained"}
SLOW, FAST, SAMPLED = "25 fps", "120 fps", "25 fps, as sampled"
MISMATCHED, FITTED, TRUTH = "Mismatched", "fitted, 25 fps", "truth, 25 fps"
COLUMNS = (SLOW, FAST, SAMPLED, *COMPARED, MISMATCHED, FITTED, TRUTH)
SAMPLES, PROBED = 16, 4
SEED = 0  # of the choice of other sounds
# The model's own rate, a display rate, and the rate for the main sequence.
OWN_FPS, SCREEN_FPS, MAIN_SEQUENCE_FPS = 25.0, 120.0, 500.0
INTRODUCTION = """# Reference ranges: the default model

Written by `python -m pipelines.reference_ranges_model{words}`: motion of the model for {sounds} sounds of
{split}, which it was not trained on, {samples} samples each, with the partner's voice where there is one, compared with
[reference ranges](reference_ranges.md) of head, gaze and blinks. The model is conditioned on the speaker; an unseen
speaker is replaced by a fixed random training speaker.

{counts}

"As sampled" (`--no-postprocessing`) has no partner and no rule-based layers: listening, saccadic intrusions, the head
contribution to large gaze shifts ([whole.md](whole.md)). It has blinks. The columns after it are as sampled, too:
Random is a training clip under any sound, Untrained the default with random weights, Mismatched fitted motion of
another sound. Ranges that the truth also misses are due to the small amount of motion. The main sequence is measured
at 500 fps.

"Made" is what makes the value in the first two columns: `learnt`; `corrected`: learnt, then changed by a factor, filter
or guidance; `rule`: a rule with published rates; `construction`: any weights give it. Only what is learnt says how good
the model is. A range tests a single statistic: Random, which is real motion under another sound, is within most of
them. It cannot be within those of sound and motion, which the second table shows.

"""
TIES = """## Sound and motion

Can the sound of a motion be found out? Probes predict motion from speech, of speakers outside their fit ({probed}
samples a sound). Matching is between 8 s of the sound and of others of the speaker, by networks trained on the motion
of the same column for up to 600 training sounds; a speaker of val has one sound, so it needs `--split test`.

"""
REASON = re.compile(r"\| - \([^|]*\) (?=\|)")  # of a missing value; only the CSV file has it
OUTSIDE = """## Outside the range

Statistics with a value of the model outside their range; all are in [{data_file}]({data_file}).

"""


def main() -> None:
    """Animate, measure, print and write."""
    parser = argparse.ArgumentParser(description="Compare a model's motion with the reference ranges of people.")
    parser.add_argument("model", nargs="?", default=DEFAULT_MODEL)
    parser.add_argument("--split", choices=SPLITS, default="val", help="test and unseen are for reports of a release")
    asked = parser.parse_args()
    workspace = Workspace.open(Path.cwd())
    corpus_inputs = source_of(workspace, workspace.corpus)
    if not corpus_inputs.corpus.has_truth:
        raise InputError(f"{workspace.corpus}: should be a corpus with true motion, got one without")
    model = workspace.data("train", asked.model)
    compared = {title: workspace.data("train", name) for title, name in COMPARED.items()}
    for path in (model, *compared.values()):
        Animator.load(path)
    groups = group_sounds(
        corpus_inputs.corpus, corpus_inputs.fit, corpus_inputs.embed, ("train", *SPLITS[asked.split]), PROBED, SEED
    )
    sounds = [group for group in groups if group.clip.split != "train"]
    with parallel_backend(workspace.params.get("machine", {})):
        found = list(
            parallel_map(
                partial(extract, corpus_inputs, model, compared),
                list(enumerate(sounds)),
                workspace.jobs,
                f"reference ranges of {asked.model}",
            )
        )
        references: dict[str, MotionsOf] = {
            FITTED: partial(fitted_motions, corpus_inputs),
            TRUTH: partial(reference_motions, corpus_inputs),
        }
        others = {group.clip.id: group.others for group in groups}
        if all(others.values()):
            references[MISMATCHED] = partial(mismatched_motions, corpus_inputs, others)
        tied = measure_ties(
            corpus_inputs, {SAMPLED: model, **compared}, references, SPLITS[asked.split], workspace.jobs
        )
    columns = [measure(name, join_pools(one[name] for one in found)) | tied.get(name, {}) for name in COLUMNS]
    default = (asked.model, asked.split) == (DEFAULT_MODEL, "val")
    name = asked.model if asked.split == "val" else f"{asked.model}-{asked.split}"
    words = "" if default else f" {asked.model} --split {asked.split}"
    text = markdown(columns, len(sounds), " and ".join(SPLITS[asked.split]), words)
    out = Path("docs/reference_ranges_model.md") if default else Path("build/reference_ranges", f"{name}.md")
    (workspace.root / out).parent.mkdir(parents=True, exist_ok=True)
    for path, content in (
        (out, page_of(text, f"{out.stem}.csv")),
        (out.with_suffix(".csv"), as_csv([read_tables(text)["Statistics"]])),
    ):
        with atomic_write(workspace.root / path) as temporary:
            temporary.write_text(content)
    print(text)


@cache
def _animator(model: Path) -> Animator:
    """A model, loaded once per process."""
    return Animator.load(model)


def extract(
    corpus_inputs: CorpusInputs, model: Path, compared: Mapping[str, Path], numbered: tuple[int, SoundGroup]
) -> dict[str, PooledArrays]:
    """Pooled arrays of each column for one sound, animated with its own seeds.

    With equal seeds for all sounds, all would start with the same random numbers: vergence, which hardly changes within
    a clip, would have only as many values as there are seeds.
    """
    number, sound = numbered
    clip = sound.clip

    def made(path: Path, fps: float, partner: Float[ndarray, " N"] | None, postprocessing: bool) -> list[Motion]:
        return animate(
            corpus_inputs, path, clip, SAMPLES, SAMPLES * number, fps, partner, postprocessing=postprocessing
        )

    def seen(motions: Sequence[Motion]) -> PooledArrays:
        pool = join_pools(measurements.extract(data) for data in load_clip_data(corpus_inputs, clip, motions))
        if len(motions) > 1:
            for part, takes in (
                ("eye", [each.gaze.mean(axis=1) for each in motions]),
                ("head", [each.head for each in motions]),
            ):
                pool[f"takes.{part}"] = probes.between_take_variance(np.stack(takes))[None]
        return pool

    def with_finest(partner: Float[ndarray, " N"] | None, postprocessing: bool) -> PooledArrays:
        coarse, finest = (made(model, fps, partner, postprocessing) for fps in (OWN_FPS, MAIN_SEQUENCE_FPS))
        return {
            **seen(coarse),
            **join_pools(extract_main_sequence(*motions) for motions in zip(finest, coarse, strict=True)),
        }

    partner = corpus_inputs.corpus.partner(clip)
    return {
        SLOW: with_finest(partner, postprocessing=True),
        FAST: seen(made(model, SCREEN_FPS, partner, postprocessing=True)),
        SAMPLED: with_finest(None, postprocessing=False),
        **{name: seen(made(path, OWN_FPS, None, postprocessing=False)) for name, path in compared.items()},
        MISMATCHED: seen(mismatched_motions(corpus_inputs, {clip.id: sound.others}, clip)) if sound.others else {},
        FITTED: seen([motion for take in sound.takes for motion in fitted_motions(corpus_inputs, take)]),
        TRUTH: extract_sound(corpus_inputs, sound.takes),
    }


def fitted_motions(corpus_inputs: CorpusInputs, clip: Clip) -> list[Motion]:
    """The fitted motion of a clip, as MotionsOf."""
    return [Motion.load(motion_path(corpus_inputs.fit, clip))]


def mismatched_motions(corpus_inputs: CorpusInputs, others: Mapping[str, Sequence[Clip]], clip: Clip) -> list[Motion]:
    """Fitted motions of the other sounds of a clip, as MotionsOf; as long as the shortest, and no longer than the
    clip."""
    motions = [motion for other in others[clip.id] for motion in fitted_motions(corpus_inputs, other)]
    frames = min(int(clip.seconds * clip.fps), *map(len, motions))
    return [motion.cut(0, frames) for motion in motions]


def animate(
    corpus_inputs: CorpusInputs,
    model: Path,
    clip: Clip,
    samples: int,
    seed: int,
    fps: float = OWN_FPS,
    partner: Float[ndarray, " N"] | None = None,
    postprocessing: bool = False,
) -> list[Motion]:
    """Motions of a model for the sound of a clip, of its speaker or a fixed random one."""
    animator = _animator(model)
    known = animator.persons
    person = known[speaker_index(known, clip.speaker, clip.speaker)] if known else None
    controls = Controls(partner=partner, person=person, no_postprocessing=not postprocessing)
    embedding = np.array(Recordings([clip], corpus_inputs.fit, corpus_inputs.embed)[0].speech)
    sound = corpus_inputs.corpus.speech(clip)
    return [each.motion for each in animator.generate_from_embedding(embedding, samples, seed, fps, controls, sound)]


def measure_ties(
    corpus_inputs: CorpusInputs,
    models: Mapping[str, Path],
    references: Mapping[str, MotionsOf],
    judged: Sequence[str],
    jobs: int,
) -> dict[str, Measurements]:
    """Rows on sound and motion of each column: of motions as sampled, and of recorded ones."""
    train, tested = tower_clips(corpus_inputs, judged)
    animated = [(tested, PROBED)] if reason_against_towers(corpus_inputs, judged) else [(train, 1), (tested, PROBED)]
    with tempfile.TemporaryDirectory(prefix="talkingeyes-") as folder:
        sources = dict(references)
        for column, path in models.items():
            place = Path(folder, column)
            for clips, samples in animated:
                task = partial(save_motions, corpus_inputs, path, samples, place)
                list(parallel_map(task, list(enumerate(clips)), jobs, f"motions of {column}"))
            sources[column] = partial(load_motions, place)
        return {
            column: measure_probes(corpus_inputs, motions_of, tested, jobs)
            | measure_towers(corpus_inputs, motions_of, jobs, judged, jaw=False)
            for column, motions_of in sources.items()
        }


def save_motions(
    corpus_inputs: CorpusInputs, model: Path, samples: int, folder: Path, numbered: tuple[int, Clip]
) -> None:
    """Write motions of a model for the sound of a clip into a folder of the clip."""
    number, clip = numbered
    place = shard_path(folder, clip.id, "")
    place.mkdir(parents=True)
    for index, motion in enumerate(animate(corpus_inputs, model, clip, samples, samples * number)):
        motion.save(place / f"{index}.npz")


def load_motions(folder: Path, clip: Clip) -> list[Motion]:
    """The motions that `save_motions` wrote for a clip."""
    return [Motion.load(path) for path in sorted(shard_path(folder, clip.id, "").iterdir())]


def load_clip_data(corpus_inputs: CorpusInputs, clip: Clip, motions: Sequence[Motion]) -> Iterator[ClipData]:
    """Animations of a sound, all at one frame rate, with the data of the sound; a model has no jaw."""
    sound_prosody = prosody(corpus_inputs.corpus.speech(clip), motions[0].fps, corpus_inputs.prosody)
    annotation = corpus_inputs.corpus.annotation(clip)
    divergence_rad = axis_divergence_rad(corpus_inputs, clip)
    for motion in motions:
        fields, frames = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}, len(motion)
        yield ClipData(
            speaker=clip.speaker,
            behaviour=behaviour(motion.fps, fields, motion.valid, annotation),
            annotation=annotation,
            frame_prosody=FrameProsody(sound_prosody.energy_dbfs[:frames], sound_prosody.f0_hz[:frames]),
            axis_divergence_rad=divergence_rad,
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
    """Order the styles of a model by sample, then by sound: half minutes of a speaker then combine several sounds, like
    those of the truth, instead of samples of a single sound."""
    styles = {name: values.reshape(-1, SAMPLES).T.ravel() for name, values in pool.items() if name.startswith("style.")}
    return {**pool, **styles}


def measure(column: str, pool: PooledArrays) -> Measurements:
    """Rows for head, gaze and blinks; of the model at 25 fps also of the main sequence and the kinematics of blinks."""
    if column not in (MISMATCHED, FITTED, TRUTH):
        pool = order_by_take(pool)
    found = measurements.measure_gaze(pool) | measurements.measure_head(pool) | measurements.measure_speech(pool)
    found |= measurements.measure_blinks(pool) | measurements.measure_gaze_shifts(pool)
    found |= {"prosody_cca": head.sentence_correlation(pool), "pitch_level_correlation": head.frame_correlation(pool)}
    found |= {f"between_take_{part}": probes.between_take_fraction(pool, part) for part in ("eye", "head")}
    if column in (SLOW, SAMPLED):
        found |= measurements.measure_main_sequence(pool) | blinks.blink_kinematics(pool)
    return found


def markdown(columns: Sequence[Measurements], sounds: int, split: str, words: str) -> str:
    """The whole table: rows of the reference ranges, with columns for the rates, the baselines and the truth."""
    rows = []
    for reference_range in REFERENCE_RANGES:
        if any(reference_range.name in each for each in columns):
            cells = [cell(reference_range, each.get(reference_range.name)) for each in columns]
            label = page.label(reference_range).replace("|", "\\|")
            bounds = [reference_range.published, page.range_text(reference_range)]
            rows.append([label, *bounds, range_class(reference_range.name), *cells])
    counted = [[name, counts(each, learnt=True), counts(each)] for name, each in zip(COLUMNS, columns, strict=True)]
    introduction = INTRODUCTION.format(
        words=words,
        sounds=sounds,
        split=split,
        samples=SAMPLES,
        counts=markdown_table(["motion", "ranges that are learnt", "all ranges"], counted),
    )
    return (
        introduction
        + f"## Statistics\n\n{markdown_table(['', 'published', 'reference range', 'made', *COLUMNS], rows)}\n"
    )


def page_of(text: str, data_file: str) -> str:
    """The page: the introduction, rows on sound and motion, and those with a value of the model outside their range."""
    table = read_tables(text)["Statistics"]
    of_model = [table.columns.index(name) for name in (SLOW, FAST, SAMPLED)]
    rows = table.markdown(table.columns, lambda row: any("**outside**" in row[index] for index in of_model))
    tied = {page.label(each) for each in RANGES_BY_SECTION["Sound and motion"]}
    shown = [name for name in table.columns if name not in (SLOW, FAST)]
    random = table.columns.index("Random")
    ties = table.markdown(shown, lambda row: row[0] in tied and not row[random].startswith("- ("))
    parts = (TIES.format(probed=PROBED), ties, "\n\n", OUTSIDE.format(data_file=data_file), rows, "\n")
    return text.partition("## Statistics")[0] + REASON.sub("| - ", "".join(parts))


def counts(found: Measurements, learnt: bool = False) -> str:
    """Numbers of measured rows within and outside their ranges; with `learnt`, of those that the default learns."""
    verdicts = [
        page.range_status(reference_range, found[reference_range.name])
        for reference_range in REFERENCE_RANGES
        if reference_range.name in found and (not learnt or range_class(reference_range.name) == LEARNT)
    ]
    return f"{verdicts.count('within')} within, {verdicts.count('outside')} outside"


def cell(reference_range: ReferenceRange, found: Measurement | None) -> str:
    """A value, marked if it is outside its range."""
    if found is None or found.value is None:
        return "" if found is None else f"- ({found.reason})"
    return f"{page.format_number(found.value)}{'' if reference_range.contains(found.value) else ' **outside**'}"


if __name__ == "__main__":
    run_command(main)
