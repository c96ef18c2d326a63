"""Stage `train`: train one model of head and gaze or of the face on the fitted motion of the train split.

Run: python -m pipelines.train talkingeyes

Reads: the corpus index, data/fit, data/embed, data/pretrain/<tokenizer>, data/train/<model> if the model is initialised
from another or combines others; the corpus's sound, for a model with a waveform encoder. Writes: data/train/<model>:
everything that generation needs. An interrupted run resumes from data/.train-<model>.resume; torchrun --nproc-per-node
N splits the batches.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from torch import nn

from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.corpus.faces import face_recordings
from talkingeyes.corpus.poses import pose_recordings
from talkingeyes.corpus.recordings import Normaliser, recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.motion_style import SPEAKERS_FILE
from talkingeyes.head.anny import anny_head
from talkingeyes.head.sag import FaceSurface
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.emotion_mean import EmotionMeans, EmotionMeanSettings
from talkingeyes.models.face.style import StyleVocabulary, clip_style
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.models.replay import ReplayBank, ReplaySettings
from talkingeyes.orchestration.run import CHECKSUMS_FILE, Report, Workspace, main
from talkingeyes.training.baseline_checkpoint import save_baseline
from talkingeyes.training.checkpoint import load, save
from talkingeyes.training.conditioning import ConditioningPaths, motion_array
from talkingeyes.training.execution import ExecutionContext
from talkingeyes.training.face_generators import face_config, face_space
from talkingeyes.training.face_task import FaceData, FaceTask, FaceTaskSettings
from talkingeyes.training.face_tokenizer import load_face_tokenizer
from talkingeyes.training.loop import TrainingTask, train
from talkingeyes.training.motion_generators import (
    HeadThenGazeSettings,
    network_config,
    pose_config,
    save_head_then_gaze,
)
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings, TrainSettings
from talkingeyes.training.pgface_task import PGFaceTask, PGFaceTaskSettings, pgface_config, read_shape_recording
from talkingeyes.training.pose_task import PoseTask, PoseTaskSettings
from talkingeyes.training.resume import ResumeFile

AnyTask = TypeVar("AnyTask", bound=TrainingTask)
NetworkSettings = MotionTaskSettings | FaceTaskSettings | PoseTaskSettings | PGFaceTaskSettings


@dataclass(frozen=True)
class Training:
    """What the training of a model starts from."""

    workspace: Workspace
    name: str
    seed: int
    context: ExecutionContext

    @property
    def inputs(self) -> tuple[Corpus, Path, Path]:
        """The corpus, and the folders of fitted motion and of speech features."""
        return Corpus(self.workspace.corpus), self.workspace.data("fit"), self.workspace.data("embed")

    @property
    def normaliser(self) -> Normaliser:
        """Channels and statistics of the speech features."""
        return Normaliser.of(self.workspace.data("embed"))

    def run(
        self, task: AnyTask, settings: NetworkSettings, config: Mapping[str, Any], reads: Sequence[Path] = ()
    ) -> Trained[AnyTask]:
        """Train a network, or validate it if it has no loop; processes that do not write results end here.

        An interrupted training of this name is resumed if its settings and what it reads are the same; `reads`: files
        besides those that every training reads.
        """
        resume = self._resume_file(settings, reads)
        if settings.loop is None:
            history = [{"step": 0.0, **task.validate()}]
        else:
            title, on_validation = f"train {self.name}", self.workspace.on_validation
            history = train(task, settings.loop, title, on_validation, self.context, resume)
        self.context.exit_unless_main()
        return Trained(task, config, history, resume)

    @contextmanager
    def output(self) -> Iterator[Path]:
        """The folder of the model. The encoder's settings, blink rates and speaker styles of the corpus are copied into
        it, so that it is self-contained."""
        self.context.exit_unless_main()
        with self.workspace.output("train", self.name) as folder:
            yield folder
            for stage, name in (("embed", "embedding.json"), ("fit", "blinks.json"), ("fit", SPEAKERS_FILE)):
                shutil.copyfile(self.workspace.data(stage, name), folder / name)

    def write(self, trained: Trained[AnyTask], *chosen: Mapping[str, float]) -> dict[str, float]:
        """Write what generation needs; `chosen`: what was chosen on val. Returns the metrics."""
        with self.output() as folder:
            trained.save(folder, *chosen)
        trained.resume.remove()
        figures = {name: value for row in (trained.history[-1], *chosen) for name, value in row.items()}
        return {**figures, "parameters": _parameters(trained.task.module)}

    def _resume_file(self, settings: NetworkSettings, more: Sequence[Path]) -> ResumeFile:
        """The resume file of this training, with a fingerprint of all its dependencies."""
        data = self.workspace.data
        folders = [data("fit"), data("embed"), data("pretrain", str(settings.tokenizer))]
        if isinstance(settings, MotionTaskSettings) and settings.init_from:
            folders.append(data("train", settings.init_from))
        index, sums = self.workspace.corpus / "clips.parquet", [folder / CHECKSUMS_FILE for folder in folders]
        made_of = (settings.model_dump(mode="json"), self.seed, self.context.describe())
        return ResumeFile.of(data(f".train-{self.name}.resume"), made_of, (index, *sums, *more, Path(__file__)))


@dataclass(frozen=True)
class Trained(Generic[AnyTask]):
    """A trained network, before anything is chosen on val, and the configuration that rebuilds it."""

    task: AnyTask
    config: Mapping[str, Any]
    history: list[dict[str, float]]
    resume: ResumeFile

    def save(self, folder: Path, *chosen: Mapping[str, float]) -> None:
        """Write what generation needs."""
        save(folder, self.task.module.state_dict(), self.config, [*self.history, *chosen])


def run(workspace: Workspace, name: str) -> Report:
    """Train a network or fit a baseline; both write the same kind of folder."""
    seed = workspace.settings("train", TrainSettings).seed
    training = Training(workspace, name, seed, ExecutionContext.of(workspace.params["machine"]))
    model = workspace.params.get("model", {}).get(name)
    kind = str(model.get("kind")) if isinstance(model, dict) else ""
    train_kind, settings = KINDS.get(kind, (_baseline, BaselineSettings))
    return train_kind(training, workspace.settings(f"model.{name}", settings))


def _motion(training: Training, settings: MotionTaskSettings) -> Report:
    trained = train_motion(training, settings, _codebook(training.workspace, settings.tokenizer))
    task = trained.task
    task.fit_equaliser()
    chosen = task.choose_temperature()
    temperature = {"temperature": float(task.module.temperature)}
    return Report(metrics={**training.write(trained, chosen), **temperature, **task.truth_metrics()})


def train_motion(
    training: Training, settings: MotionTaskSettings, codebook: GazeVQVAE | None, reads: Sequence[Path] = ()
) -> Trained[MotionTask]:
    """Train a network of head and gaze; `reads`: files besides those that every training reads."""
    corpus, fit, embed = training.inputs
    of_train, of_val = (recordings(corpus, fit, embed, split, take=0) for split in ("train", "val"))
    start = load(training.workspace.data("train", settings.init_from)) if settings.init_from else None
    normaliser, paths = training.normaliser, ConditioningPaths(corpus, embed)
    task = MotionTask(settings, training.seed, of_train, of_val, normaliser, codebook, paths, start)
    return training.run(task, settings, network_config(settings, normaliser.channels, codebook, task.module), reads)


def _face(training: Training, settings: FaceTaskSettings) -> Report:
    data, tokenizer = _face_data(training), None
    if settings.tokenizer:
        folder = training.workspace.data("pretrain", settings.tokenizer)
        tokenizer = load_face_tokenizer(folder)
        tokenizer.basis.require_match(data.basis, str(folder), "pretrain it on this motion")
    task = FaceTask(settings, training.seed, data, tokenizer)
    return Report(metrics=training.write(training.run(task, settings, face_config(settings, data, tokenizer))))


def _face_data(training: Training) -> FaceData:
    train_faces, val_faces = (face_recordings(*training.inputs, split, take=0) for split in ("train", "val"))
    basis = FaceBasis(train_faces.head_model, train_faces.expression_names)
    return FaceData(train_faces, val_faces, basis, StyleVocabulary.of(train_faces.clips), training.normaliser)


def _poses(training: Training, settings: PoseTaskSettings) -> Report:
    """A model of the head alone; its curves, including the discriminator's, are logged to MLflow."""
    training = _single_process(training)
    of_train, of_val = (pose_recordings(*training.inputs, settings.poses, split, take=0) for split in ("train", "val"))
    task = PoseTask(settings, training.seed, of_train, of_val, training.normaliser)
    trained = training.run(task, settings, pose_config(settings, training.normaliser, task.module))
    figures = training.write(trained)
    adversary = _parameters(task.discriminator) if task.discriminator else 0
    sizes = {"parameters": figures["parameters"] - adversary, "discriminator_parameters": adversary}
    return Report(metrics={**figures, **sizes}, history=trained.history)


def _pgface(training: Training, settings: PGFaceTaskSettings) -> Report:
    """PGFace: face shape from speech and head pose."""
    training, surface = _single_process(training), FaceSurface(anny_head())
    corpus, fit, embed = training.inputs
    of_train, of_val = (
        [
            read_shape_recording(fit, embed, clip, settings.poses)
            for clip in recordings(corpus, fit, embed, split, take=0).clips
        ]
        for split in ("train", "val")
    )
    task = PGFaceTask(settings, training.seed, of_train, of_val, training.normaliser, surface)
    trained = training.run(task, settings, pgface_config(settings, training.normaliser, surface))
    return Report(metrics=training.write(trained), history=trained.history)


def _combine_models(training: Training, settings: HeadThenGazeSettings) -> Report:
    """Combine two trained models in one folder, without training."""
    head, gaze = (load(training.workspace.data("train", each)) for each in settings.source_models)
    with training.output() as folder:
        save_head_then_gaze(folder, settings, head, gaze)
    return Report()


def _baseline(training: Training, settings: BaselineSettings) -> Report:
    """A bank of the motions of the train split: faces, or heads and gaze."""
    more: dict[str, Any] = {}
    if "face" in settings.parts:
        faces = _face_data(training)
        more = face_space(faces)
        clips = [(each.speech, faces.basis.to_vector(each.expression, each.jaw)) for each in faces.train]
    else:
        found = recordings(*training.inputs, "train")
        clips = [(each.speech, motion_array(each.head, each.gaze)) for each in found]
    speech, motions = zip(*clips, strict=True)
    bank = MotionBank.of(speech, motions, training.normaliser.mean, training.normaliser.std)
    with training.output() as folder:
        save_baseline(folder, settings, bank, more)
    return Report(metrics={"clips": len(bank.features)})


def _emotion_mean(training: Training, settings: EmotionMeanSettings) -> Report:
    """The mean face of each emotion."""
    data = _face_data(training)
    faces = [data.basis.to_vector(each.expression, each.jaw) for each in data.train]
    means = EmotionMeans.of(faces, [clip_style(each.clip).emotion for each in data.train])
    with training.output() as folder:
        save_baseline(folder, settings, means, face_space(data))
    return Report(metrics={"clips": len(faces)})


def _replay(training: Training, settings: ReplaySettings) -> Report:
    """A bank of the clips of the train split, to look up in."""
    found = recordings(*training.inputs, "train", take=0)
    speech, motions = zip(*((each.speech, motion_array(each.head, each.gaze)) for each in found), strict=True)
    bank = ReplayBank.of(speech, motions, training.normaliser.channels, found.clips[0].fps)
    with training.output() as folder:
        save_baseline(folder, settings, bank)
    return Report(metrics={"clips": len(found), "onsets": len(bank.onsets)})


def _codebook(workspace: Workspace, tokenizer: str | None) -> GazeVQVAE | None:
    if tokenizer is None:
        return None
    checkpoint = load(workspace.data("pretrain", tokenizer))
    codebook = GazeVQVAE(validate_section(tokenizer, GazeVQVAESettings, checkpoint.config))
    codebook.load_state_dict(checkpoint.tensors)
    return codebook.freeze()


def _single_process(training: Training) -> Training:
    return replace(training, context=ExecutionContext.single_process(training.workspace.params["machine"]))


def _parameters(module: nn.Module) -> int:
    return sum(each.numel() for each in module.parameters())


KINDS: dict[str, tuple[Callable[[Training, Any], Report], type[Settings]]] = {
    "speech_to_motion": (_motion, MotionTaskSettings),
    "speech_to_face": (_face, FaceTaskSettings),
    "speech_to_pose": (_poses, PoseTaskSettings),
    "pgface": (_pgface, PGFaceTaskSettings),
    "head_then_gaze": (_combine_models, HeadThenGazeSettings),
    "emotion_mean": (_emotion_mean, EmotionMeanSettings),
    "aligned_replay": (_replay, ReplaySettings),
    "pieced_replay": (_replay, ReplaySettings),
}


if __name__ == "__main__":
    main(run)
