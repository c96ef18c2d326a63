"""Stage `train`: train one model of head and gaze or of the face on the fitted motion of the train split.

Run: python -m pipelines.train talkingeyes

Reads: the corpus index, data/fit, data/embed, data/pretrain/<tokenizer>, data/train/<model> if the model is initialised
from another or combines others; the corpus's sound, for a model with a waveform encoder. Writes: data/train/<model>:
everything that generation needs. An interrupted run resumes from data/.train-<model>.resume; torchrun --nproc-per-node
N splits the batches.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.faces import face_recordings
from talkingeyes.corpus.poses import pose_recordings
from talkingeyes.corpus.recordings import Normaliser, recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.motion_style import SPEAKERS_FILE
from talkingeyes.head.anny import anny_head
from talkingeyes.head.sag import FaceSurface
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.orchestration.run import CHECKSUMS_FILE, Report, Workspace, main
from talkingeyes.training.baseline_checkpoint import save_baseline
from talkingeyes.training.canonical_gaze import CanonicalModelSettings, fit_canonical_gaze, save_canonical
from talkingeyes.training.checkpoint import load, save
from talkingeyes.training.conditioning import ConditioningPaths, motion_array
from talkingeyes.training.execution import ExecutionContext
from talkingeyes.training.face_generators import face_config, face_space
from talkingeyes.training.face_task import FaceData, FaceTask, FaceTaskSettings
from talkingeyes.training.face_tokenizer import load_face_tokenizer
from talkingeyes.training.loop import train
from talkingeyes.training.motion_generators import (
    HeadThenGazeSettings,
    network_config,
    save_head_then_gaze,
)
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings, TrainSettings
from talkingeyes.training.pgface_task import PGFaceTask, PGFaceTaskSettings, pgface_config, read_shape_recording
from talkingeyes.training.pose_generators import pose_config
from talkingeyes.training.pose_task import PoseTask, PoseTaskSettings
from talkingeyes.training.resume import ResumeFile

NetworkSettings = MotionTaskSettings | FaceTaskSettings | PoseTaskSettings | PGFaceTaskSettings


def run(workspace: Workspace, name: str) -> Report:
    """Train a network or fit a baseline; both write the same kind of folder."""
    seed = workspace.settings("train", TrainSettings).seed
    context = ExecutionContext.of(workspace.params["machine"])
    model = workspace.params.get("model", {}).get(name)
    if isinstance(model, dict) and model.get("kind") == "speech_to_motion":
        return _network(workspace, name, workspace.settings(f"model.{name}", MotionTaskSettings), seed, context)
    if isinstance(model, dict) and model.get("kind") == "speech_to_face":
        return _face(workspace, name, workspace.settings(f"model.{name}", FaceTaskSettings), seed, context)
    if isinstance(model, dict) and model.get("kind") == "speech_to_pose":
        return _poses(workspace, name, workspace.settings(f"model.{name}", PoseTaskSettings), seed)
    if isinstance(model, dict) and model.get("kind") == "pgface":
        return _pgface(workspace, name, workspace.settings(f"model.{name}", PGFaceTaskSettings), seed)
    context.exit_unless_main()
    return _fit_without_loop(workspace, name, model.get("kind") if isinstance(model, dict) else None, seed)


def _fit_without_loop(workspace: Workspace, name: str, kind: str | None, seed: int) -> Report:
    """Models without a training loop: combinations of models, and baselines."""
    if kind == "head_then_gaze":
        return _combine_models(workspace, name, workspace.settings(f"model.{name}", HeadThenGazeSettings))
    if kind == "canonical_correlation":
        return _canonical(workspace, name, workspace.settings(f"model.{name}", CanonicalModelSettings), seed)
    return _baseline(workspace, name, workspace.settings(f"model.{name}", BaselineSettings))


def _network(
    workspace: Workspace, name: str, settings: MotionTaskSettings, seed: int, context: ExecutionContext
) -> Report:
    codebook = _codebook(workspace, settings.tokenizer)
    trained = train_motion(workspace, name, settings, seed, codebook, context)
    task = trained.task
    task.fit_equaliser()
    chosen = task.choose_temperature()
    figures = {**trained.history[-1], **chosen, "temperature": float(task.module.temperature), **task.truth_metrics()}
    with workspace.output("train", name) as folder:
        trained.save(folder, [*trained.history, chosen])
        _copy_inference_files(workspace, folder)
    trained.resume.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    return Report(metrics={**figures, "parameters": weights})


@dataclass(frozen=True)
class TrainedMotion:
    """A trained network of head and gaze, before anything is chosen on val."""

    task: MotionTask
    history: list[dict[str, float]]
    resume: ResumeFile
    channels: tuple[str, ...]
    codebook: GazeVQVAE | None

    def save(self, folder: Path, history: Sequence[Mapping[str, float]]) -> None:
        """Write what generation needs."""
        config = network_config(self.task.settings, self.channels, self.codebook, self.task.module)
        save(folder, self.task.module.state_dict(), config, history)


def train_motion(
    workspace: Workspace,
    name: str,
    settings: MotionTaskSettings,
    seed: int,
    codebook: GazeVQVAE | None,
    context: ExecutionContext,
    reads: Sequence[Path] = (),
) -> TrainedMotion:
    """Train a network of head and gaze. An interrupted training of this name is resumed if its settings and what it
    reads are the same; `reads`: files besides those that every training reads."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser = Normaliser.of(embed)
    data = recordings(corpus, fit, embed, "train"), recordings(corpus, fit, embed, "val")
    start = load(workspace.data("train", settings.init_from)) if settings.init_from else None
    task = MotionTask(settings, seed, *data, normaliser, codebook, ConditioningPaths(corpus, embed), start)
    resume = _resume_file(workspace, name, settings, seed, context, reads)
    history = train(
        task, settings.loop, f"train {name}", on_validation=workspace.on_validation, context=context, resume=resume
    )
    context.exit_unless_main()
    return TrainedMotion(task, history, resume, normaliser.channels, codebook)


def _face(workspace: Workspace, name: str, settings: FaceTaskSettings, seed: int, context: ExecutionContext) -> Report:
    data = _face_data(workspace)
    tokenizer = load_face_tokenizer(workspace.data("pretrain", settings.tokenizer)) if settings.tokenizer else None
    if tokenizer is not None:
        tokenizer.basis.require_match(
            data.basis, str(workspace.data("pretrain", str(settings.tokenizer))), "pretrain it on this motion"
        )
    task = FaceTask(settings, seed, data, tokenizer)
    resume = _resume_file(workspace, name, settings, seed, context)
    history = train(
        task, settings.loop, f"train {name}", on_validation=workspace.on_validation, context=context, resume=resume
    )
    context.exit_unless_main()
    chosen = task.choose_temperature()
    figures = {**history[-1], **chosen, "temperature": float(task.module.temperature)}
    with workspace.output("train", name) as folder:
        save(folder, task.module.state_dict(), face_config(settings, data, tokenizer), [*history, chosen])
        _copy_inference_files(workspace, folder)
    resume.remove()
    return Report(metrics={**figures, "parameters": sum(each.numel() for each in task.module.parameters())})


def _face_data(workspace: Workspace) -> FaceData:
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    train_faces = face_recordings(corpus, fit, embed, "train")
    basis = FaceBasis(train_faces.head_model, train_faces.expression_names)
    vocabulary = StyleVocabulary.of(train_faces.clips)
    return FaceData(train_faces, face_recordings(corpus, fit, embed, "val"), basis, vocabulary, Normaliser.of(embed))


def _poses(workspace: Workspace, name: str, settings: PoseTaskSettings, seed: int) -> Report:
    """A model of the head alone; its curves, including the discriminator's, are logged to MLflow."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser, context = Normaliser.of(embed), ExecutionContext.single_process(workspace.params["machine"])
    of_train, of_val = (
        pose_recordings(corpus, fit, embed, settings.poses, split, take=0) for split in ("train", "val")
    )
    task = PoseTask(settings, seed, of_train, of_val, normaliser)
    resume = _resume_file(workspace, name, settings, seed, context)
    if settings.loop is None:
        history = [{"step": 0.0, **task.validate()}]
    else:
        history = train(
            task, settings.loop, f"train {name}", on_validation=workspace.on_validation, context=context, resume=resume
        )
    with workspace.output("train", name) as folder:
        save(folder, task.module.state_dict(), pose_config(settings, normaliser, task.module), history)
        _copy_inference_files(workspace, folder)
    resume.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    discriminator_parameters = (
        sum(parameter.numel() for parameter in task.discriminator.parameters()) if task.discriminator else 0
    )
    figures = {
        **history[-1],
        "parameters": weights - discriminator_parameters,
        "discriminator_parameters": discriminator_parameters,
    }
    return Report(metrics=figures, history=history)


def _pgface(workspace: Workspace, name: str, settings: PGFaceTaskSettings, seed: int) -> Report:
    """PGFace: face shape from speech and head pose."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser, context, surface = (
        Normaliser.of(embed),
        ExecutionContext.single_process(workspace.params["machine"]),
        FaceSurface(anny_head()),
    )
    of_train, of_val = (
        [
            read_shape_recording(fit, embed, clip, settings.poses)
            for clip in recordings(corpus, fit, embed, split, take=0).clips
        ]
        for split in ("train", "val")
    )
    task = PGFaceTask(settings, seed, of_train, of_val, normaliser, surface)
    resume = _resume_file(workspace, name, settings, seed, context)
    history = train(
        task, settings.loop, f"train {name}", on_validation=workspace.on_validation, context=context, resume=resume
    )
    with workspace.output("train", name) as folder:
        save(folder, task.module.state_dict(), pgface_config(settings, normaliser, surface), history)
        _copy_inference_files(workspace, folder)
    resume.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    return Report(metrics={**history[-1], "parameters": weights}, history=history)


def _combine_models(workspace: Workspace, name: str, settings: HeadThenGazeSettings) -> Report:
    """Combine two trained models in one folder, without training."""
    head, gaze = (load(workspace.data("train", each)) for each in settings.source_models)
    with workspace.output("train", name) as folder:
        save_head_then_gaze(folder, settings, head, gaze)
        _copy_inference_files(workspace, folder)
    return Report()


def _canonical(workspace: Workspace, name: str, settings: CanonicalModelSettings, seed: int) -> Report:
    """Fit canonical correlation in closed form, for the head of a trained model."""
    embed = workspace.data("embed")
    clips = recordings(Corpus(workspace.corpus), workspace.data("fit"), embed, "train")
    found = fit_canonical_gaze(settings, clips, Normaliser.of(embed), seed)
    with workspace.output("train", name) as folder:
        save_canonical(folder, settings, found, load(workspace.data("train", *settings.source_models)))
        _copy_inference_files(workspace, folder)
    return Report(metrics={f"correlation/{at}": float(each) for at, each in enumerate(found.correlation.correlations)})


def _resume_file(
    workspace: Workspace,
    name: str,
    settings: NetworkSettings,
    seed: int,
    context: ExecutionContext,
    more: Sequence[Path] = (),
) -> ResumeFile:
    """The resume file of this training, with a fingerprint of all its dependencies."""
    folders = [workspace.data("fit"), workspace.data("embed"), workspace.data("pretrain", str(settings.tokenizer))]
    if isinstance(settings, MotionTaskSettings) and settings.init_from:
        folders.append(workspace.data("train", settings.init_from))
    reads = (
        workspace.corpus / "clips.parquet",
        *(folder / CHECKSUMS_FILE for folder in folders),
        *more,
        Path(__file__),
    )
    made_of = (settings.model_dump(mode="json"), seed, context.describe())
    return ResumeFile.of(workspace.data(f".train-{name}.resume"), made_of, reads)


def _codebook(workspace: Workspace, tokenizer: str | None) -> GazeVQVAE | None:
    if tokenizer is None:
        return None
    checkpoint = load(workspace.data("pretrain", tokenizer))
    codebook = GazeVQVAE(validate_section(tokenizer, GazeVQVAESettings, checkpoint.config))
    codebook.load_state_dict(checkpoint.tensors)
    return codebook.freeze()


def _baseline(workspace: Workspace, name: str, settings: BaselineSettings) -> Report:
    """A bank of the motions of the train split: faces, or heads and gaze."""
    more: dict[str, Any] = {}
    if "face" in settings.parts:
        faces = _face_data(workspace)
        more = face_space(faces)
        clips = [(each.speech, faces.basis.to_vector(each.expression, each.jaw)) for each in faces.train]
    else:
        corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
        clips = [(each.speech, motion_array(each.head, each.gaze)) for each in recordings(corpus, fit, embed, "train")]
    normaliser = Normaliser.of(workspace.data("embed"))
    speech, motions = zip(*clips, strict=True)
    bank = MotionBank.of(speech, motions, normaliser.mean, normaliser.std)
    with workspace.output("train", name) as folder:
        save_baseline(folder, settings, bank, more)
        _copy_inference_files(workspace, folder)
    return Report(metrics={"clips": len(bank.features)})


def _copy_inference_files(workspace: Workspace, folder: Path) -> None:
    """Copy the encoder's settings, blink rates and speaker styles of the corpus, so that a model's folder is
    self-contained."""
    for stage, name in (("embed", "embedding.json"), ("fit", "blinks.json"), ("fit", SPEAKERS_FILE)):
        shutil.copyfile(workspace.data(stage, name), folder / name)


if __name__ == "__main__":
    main(run)
