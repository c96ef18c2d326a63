"""Stage `information`: what speech tells a model about the motion of sounds that it was not trained on.

Run: python -m pipelines.information talkingeyes_events

Trains the model's twin without speech input, all else equal, and compares the likelihoods of fitted motion, the
training target, under both (evaluation/report/information.py).

Reads: the corpus index, data/fit, data/embed, data/train/<model>, and what its training reads.

Writes: data/information/<model>: without_speech/, the twin; metrics.json {split: {sound: {figure: {value, low, high}}}}
in nats per second for val, test and unseen, under the sound itself (`own`) and under another sound of the speaker
(`other`), which should give nothing.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.train import Trained, Training, train_motion
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.recordings import Recording, Recordings
from talkingeyes.corpus.sound_groups import SoundGroup, group_sounds
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.report.information import ClipLikelihood, information
from talkingeyes.evaluation.report.validation_metrics import ValidateSettings
from talkingeyes.models.speech_projection import SpeechProjectionSettings
from talkingeyes.models.waveform_encoder import WaveformSpeechSettings
from talkingeyes.orchestration.run import CHECKSUMS_FILE, InputPaths, Report, Workspace, main, parallel_map
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.execution import ExecutionContext
from talkingeyes.training.motion_generators import NetworkGenerator, load_generator
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings, TrainSettings

SPLITS = ("val", "test", "unseen")
Figures = dict[str, dict[str, dict[str, dict[str, float]]]]  # {split: {sound: {figure: estimate}}}


@dataclass(frozen=True)
class SoundLikelihoods:
    """Likelihoods of the motion of one clip: under its sound, under another (None: none), under the twin."""

    split: str
    own: ClipLikelihood
    other: ClipLikelihood | None
    without_speech: ClipLikelihood


def run(workspace: Workspace, name: str) -> Report:
    """Train the twin, and score in parallel over sounds."""
    settings, data = workspace.settings("validate", ValidateSettings), workspace.data
    without_speech = _train_without_speech(workspace, name)
    paths = workspace.input_paths(name)
    sounds = group_sounds(Corpus(paths.corpus), paths.fit, paths.embed, SPLITS, 1, settings.seed)
    with workspace.output("information", name) as folder:
        (folder / "without_speech").mkdir()
        without_speech.save(folder / "without_speech")
        task = partial(score_sound, paths, folder / "without_speech")
        work = parallel_map(task, sounds, workspace.jobs, f"information {name}")
        figures = summarise(list(work), settings)
        (folder / "metrics.json").write_text(json.dumps(figures, indent=1))
    without_speech.resume.remove()
    flat = {
        f"{split}/{sound}/{key}": estimate["value"]
        for split, of_split in figures.items()
        for sound, of_sound in of_split.items()
        for key, estimate in of_sound.items()
    }
    return Report(metrics=flat, artifacts=[data("information", name, "metrics.json")])


def _train_without_speech(workspace: Workspace, name: str) -> Trained[MotionTask]:
    """The model trained without speech: the input of its speech layers is constant."""
    settings = workspace.settings(f"model.{name}", MotionTaskSettings)
    speech = settings.speech.model_copy(update={"channels": ()})
    if isinstance(speech, WaveformSpeechSettings):
        speech = SpeechProjectionSettings.model_validate(speech.model_dump(exclude={"waveform_encoder"}))
    seed = workspace.settings("train", TrainSettings).seed
    context = ExecutionContext.single_process(workspace.params["machine"])
    model = workspace.data("train", name)
    codebook = getattr(_load(model).network.gaze, "codebook", None)
    training = Training(workspace, f"{name}_without_speech", seed, context)
    return train_motion(training, settings.model_copy(update={"speech": speech}), codebook, [model / CHECKSUMS_FILE])


def summarise(found: Sequence[SoundLikelihoods], settings: ValidateSettings) -> Figures:
    """Estimates by split, sound and figure, for the splits that occur."""
    figures: Figures = {}
    for split in SPLITS:
        of_split = [each for each in found if each.split == split]
        without_speech = [each.without_speech for each in of_split]
        for sound in ("own", "other"):
            scored = [likelihood for each in of_split if (likelihood := getattr(each, sound)) is not None]
            if scored:
                estimates = information(scored, without_speech, settings.bootstrap)
                figures.setdefault(split, {})[sound] = {key: asdict(value) for key, value in estimates.items()}
    return figures


def score_sound(paths: InputPaths, without_speech: Path, sound: SoundGroup) -> SoundLikelihoods:
    """Likelihoods of the fitted motion of one sound."""
    recording, *others = Recordings([sound.clip, *sound.others], paths.fit, paths.embed)
    speech = np.array(recording.speech)
    other = np.resize(others[0].speech, speech.shape) if others else None
    return SoundLikelihoods(
        sound.clip.split,
        _score(paths, paths.model, recording, speech),
        None if other is None else _score(paths, paths.model, recording, other),
        _score(paths, without_speech, recording, speech),
    )


def _score(paths: InputPaths, model: Path, recording: Recording, speech: Float[ndarray, "T C"]) -> ClipLikelihood:
    generator, provider = _model(paths, model)
    clip, inputs = recording.clip, provider.clip_inputs(recording.clip, len(recording))
    terms = generator.log_likelihood(speech, recording.head, recording.gaze, inputs)
    return ClipLikelihood(clip.id, clip.speaker, len(recording) / clip.fps, terms)


@lru_cache(maxsize=2)
def _model(paths: InputPaths, folder: Path) -> tuple[NetworkGenerator, ConditioningProvider]:
    """A model and the provider of its conditioning inputs, loaded once per process."""
    generator = _load(folder)
    needed, speakers = generator.network.required_inputs, generator.network.speakers
    conditioning_paths = ConditioningPaths(Corpus(paths.corpus), paths.embed)
    return generator, ConditioningProvider(needed, speakers, conditioning_paths)


def _load(folder: Path) -> NetworkGenerator:
    generator = load_generator(folder)
    if not isinstance(generator, NetworkGenerator):
        raise InputError(f"{folder}: should be a network whose motion has a likelihood, got a baseline")
    return generator


if __name__ == "__main__":
    main(run)
