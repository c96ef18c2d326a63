"""Stage `pretrain`: a codebook of gaze, or a motion autoencoder of the face, on the fitted motion of the train split.

Run: python -m pipelines.pretrain gaze_frames

Reads: the corpus index, data/fit, data/embed. Writes: data/pretrain/<tokenizer>: weights, history, code usage. An
interrupted run resumes from data/.pretrain-<tokenizer>.resume; torchrun --nproc-per-node N splits the batches.
"""

import json
from pathlib import Path

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.faces import face_recordings
from talkingeyes.corpus.recordings import recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.orchestration.run import CHECKSUMS_FILE, Report, Workspace, main
from talkingeyes.training.checkpoint import save
from talkingeyes.training.execution import ExecutionContext
from talkingeyes.training.face_tokenizer import FaceTokenizerSettings, FaceTokenizerTask, face_tokenizer_config
from talkingeyes.training.gaze_tokenizer import GazeTokenizerSettings, GazeTokenizerTask
from talkingeyes.training.loop import train
from talkingeyes.training.resume import ResumeFile


def run(workspace: Workspace, name: str) -> Report:
    """Pretrain a tokenizer of gaze or of the face, by the kind of its section."""
    tokenizer = workspace.params.get("pretrain", {}).get(name)
    if isinstance(tokenizer, dict) and tokenizer.get("kind") == "face":
        return _face(workspace, name, workspace.settings(f"pretrain.{name}", FaceTokenizerSettings))
    return _gaze(workspace, name, workspace.settings(f"pretrain.{name}", GazeTokenizerSettings))


def _gaze(workspace: Workspace, name: str, settings: GazeTokenizerSettings) -> Report:
    """Train, then measure code usage over all windows of the train split."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    task = GazeTokenizerTask(settings, recordings(corpus, fit, embed, "train"), recordings(corpus, fit, embed, "val"))
    context = ExecutionContext.of(workspace.params["machine"])
    resume = _resume_file(workspace, name, settings, context)
    history = train(task, settings.loop, f"pretrain {name}", context=context, resume=resume)
    context.exit_unless_main()
    code_usage = task.code_usage(task.train_recordings)
    figures = code_usage.figures() | {"val_reconstruction_error_deg": task.code_usage(task.val_recordings).error_deg}
    with workspace.output("pretrain", name) as folder:
        save(folder, task.module.state_dict(), settings.network.model_dump(mode="json"), history)
        (folder / "codes.json").write_text(json.dumps({"counts": code_usage.counts.int().tolist(), **figures}))
    resume.remove()
    return Report(metrics=figures)


def _face(workspace: Workspace, name: str, settings: FaceTokenizerSettings) -> Report:
    """Train, then fit the statistics of the latents and measure code usage, if there are codes."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    train_faces, val_faces = face_recordings(corpus, fit, embed, "train"), face_recordings(corpus, fit, embed, "val")
    basis = FaceBasis(train_faces.head_model, train_faces.expression_names)
    task = FaceTokenizerTask(settings, train_faces, val_faces, basis)
    context = ExecutionContext.of(workspace.params["machine"])
    resume = _resume_file(workspace, name, settings, context)
    history = train(task, settings.loop, f"pretrain {name}", context=context, resume=resume)
    context.exit_unless_main()
    task.fit_latent_statistics()
    error = task.error(train_faces)
    of_val = {
        f"val_{name}": value for name, value in task.error(val_faces).figures().items() if name.startswith("error")
    }
    figures = error.figures() | of_val
    with workspace.output("pretrain", name) as folder:
        save(folder, task.module.state_dict(), face_tokenizer_config(settings.network, basis), history)
        if len(error.counts):
            (folder / "codes.json").write_text(json.dumps({"counts": error.counts.int().tolist(), **figures}))
    resume.remove()
    return Report(metrics=figures)


def _resume_file(workspace: Workspace, name: str, settings: Settings, context: ExecutionContext) -> ResumeFile:
    """The resume file of this training, with a fingerprint of all its dependencies."""
    sums = [workspace.data(stage) / CHECKSUMS_FILE for stage in ("fit", "embed")]
    reads = (workspace.corpus / "clips.parquet", *sums, Path(__file__))
    fingerprint = (settings.model_dump(mode="json"), context.describe())
    return ResumeFile.of(workspace.data(f".pretrain-{name}.resume"), fingerprint, reads)


if __name__ == "__main__":
    main(run)
