"""Models of one person: trained on the first part of their recordings, measured on the last.

Run     python -m pipelines.results.own_person CORPUS [overrides]     CORPUS as `talkingeyes track` makes it of one
        person
Reads   conf/experiment/own_person.yaml; the packaged default model
Writes  in the folder that `workspace` names (build/own_person): data/train/own_person, the packaged default trained on
        for this person; data/train/posegan, a head (Zhang et al.); data/train/posegan_own_gaze, both;
        own_person.md, how they move beside the left-out part. For `talkingeyes animate --model`.

Fit, speech features and PoseGAN are kept in the result store; an interrupted training resumes.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipelines import train
from pipelines.experiment import run_pipeline
from talkingeyes.animation.model_file import PACKAGED_MODEL, open_model
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.recordings import Recording, recordings
from talkingeyes.corpus.samples import SampleSettings
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, ratio_statistic
from talkingeyes.evaluation.papers.posegan_movement import PARTS, ClipStyle, StyleComparison, compare_styles
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.models.condition.conditioner import NO_CONDITIONING
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import Workspace, parallel_backend, run_command
from talkingeyes.training.conditioning import ConditioningProvider
from talkingeyes.training.motion_generators import (
    NetworkGenerator,
    Speech,
    TrainedGenerator,
    load_generator,
    required_inputs,
    training_speakers,
)

# Models by row of the page.
ROWS = {
    "own_person": "the default, trained on",
    "posegan_own_gaze": "PoseGAN's head, gaze of `own_person`",
    "packaged": "the packaged default, random speakers",
}
PAGE = """# Motion of {speaker}

{train_s:.0f} s of recording for training, {val_s:.0f} s for the choice of PoseGAN's weights; compared with the last
{test_s:.0f} s ({clips} clips), which no model has seen: {samples} samples of each clip. Distance of styles (log
standard deviations of rotations and of their first and second differences; 0.1 is about 10 %), ratios of range and
speed, and log-likelihood of the recorded motion, nats per second (of the packaged default: without a speaker, which is
better than a random one). 95 % intervals over the clips of the last part; with few clips they are too narrow.

"""


def main() -> None:
    """Train the models, measure them and write the page."""
    if not (arguments := sys.argv[1:]) or ("=" in arguments[0] and not Path(arguments[0]).exists()):
        raise InputError("CORPUS: should be a folder of `talkingeyes track`, got none")
    params = compose(["experiment=own_person", f"corpus={Path(arguments[0]).resolve()}", *arguments[1:]])
    workspace = Workspace(Path(params["workspace"]), params)
    speaker = require_one_person(workspace.corpus)
    run_pipeline({**params, "target": "train@posegan"}, workspace.root)
    with parallel_backend(params["machine"]):
        train_models(workspace)
    page = measure(workspace, speaker)
    (workspace.root / "own_person.md").write_text(page)
    print(page)


def require_one_person(corpus: Path) -> str:
    """The only speaker of a corpus. Raises InputError if there are several, or if a split has no clip."""
    clips = Corpus(corpus).clips
    if len(speakers := {clip.speaker for clip in clips}) != 1:
        raise InputError(f"{corpus}: should hold clips of one person, got {', '.join(sorted(speakers)[:9]) or 'none'}")
    if missing := {"train", "val", "test"} - {clip.split for clip in clips}:
        raise InputError(f"{corpus}: should have three clips or more, got none for {', '.join(sorted(missing))}")
    return speakers.pop()


def train_models(workspace: Workspace) -> None:
    """Train the packaged default on for this person, and join PoseGAN's head with its gaze."""
    with open_model(PACKAGED_MODEL) as packaged, workspace.output("train", "packaged") as folder:
        shutil.copytree(packaged, folder, dirs_exist_ok=True)
    for name in ("own_person", "posegan_own_gaze"):
        train.run(workspace, name)


def measure(workspace: Workspace, speaker: str) -> str:
    """The page: how the person moves in the part for training, and how the models move, beside the left-out part."""
    inputs = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    clips = {split: recordings(*inputs, split)[:] for split in ("train", "val", "test")}
    settings = BootstrapSettings.model_validate(workspace.params["evaluate"]["bootstrap"])
    samples = workspace.settings("sample", SampleSettings)
    person = [_recorded(each) for each in clips["test"]]
    training = compare_styles([_recorded(each) for each in clips["train"]], person, settings, same_clips=False)
    rows = [_row("recorded: the part for training", training, None)]
    for name, title in ROWS.items():
        generator = load_generator(workspace.data("train", name))
        speeches = _speeches(generator, clips["test"], samples)
        styles = [ClipStyle.of(each.head, each.gaze) for each in generator.generate_batch(speeches)]
        compared = compare_styles(styles, person, settings, same_clips=True)
        if name == "packaged":
            speeches = [replace(each, conditioning=NO_CONDITIONING) for each in speeches]
        rows.append(_row(title, compared, _log_likelihood(generator, speeches, clips["test"], settings)))
    seconds = {f"{split}_s": sum(each.clip.seconds for each in found) for split, found in clips.items()}
    text = PAGE.format(speaker=speaker, clips=len(person), samples=samples.samples, **seconds)
    columns = [f"{part}: {name}" for part in PARTS for name in ("distance", "range", "speed")]
    return text + markdown_table(["", *columns, "log-likelihood"], rows)


def _recorded(clip: Recording) -> ClipStyle:
    return ClipStyle.of(clip.head[None].astype(float), clip.gaze[None].astype(float))


def _speeches(generator: TrainedGenerator, clips: Sequence[Recording], settings: SampleSettings) -> list[Speech]:
    """The sounds of clips with seeds, and the speaker, if the model takes one."""
    needed, rng = required_inputs(generator), np.random.default_rng(settings.seed)
    provider = ConditioningProvider(needed, training_speakers(generator), None)
    return [
        Speech(
            np.array(each.speech),
            rng.integers(2**31, size=settings.samples).tolist(),
            each.clip.fps,
            provider.clip_inputs(each.clip, len(each)),
        )
        for each in clips
    ]


def _log_likelihood(
    generator: TrainedGenerator, speeches: Sequence[Speech], clips: Sequence[Recording], settings: BootstrapSettings
) -> Estimate | None:
    """Log-likelihood of recorded motion, nats per second; None for a generator without one."""
    if not isinstance(generator, NetworkGenerator):
        return None
    nats = [
        sum(generator.log_likelihood(speech.embedding, clip.head, clip.gaze, speech.conditioning).values())
        for speech, clip in zip(speeches, clips, strict=True)
    ]
    seconds = np.array([len(clip) / clip.clip.fps for clip in clips])
    return bootstrap(ratio_statistic(np.array(nats), seconds), len(clips), settings)


def _row(title: str, compared: Mapping[str, StyleComparison], log_likelihood: Estimate | None) -> list[str]:
    estimates = [each for part in PARTS for each in vars(compared[part]).values()]
    return [title, *map(_cell, [*estimates, log_likelihood])]


def _cell(estimate: Estimate | None) -> str:
    if estimate is None:
        return ""
    if estimate.low == estimate.high:  # a single clip
        return f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} <sub>{estimate.low:.2f}–{estimate.high:.2f}</sub>"


if __name__ == "__main__":
    run_command(main)
