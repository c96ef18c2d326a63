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
from talkingeyes.training.face_tokenizer import FaceTokenizerSettings, FaceTokenizerTask
from talkingeyes.training.gaze_tokenizer import GazeTokenizerSettings, GazeTokenizerTask
from talkingeyes.training.loop import train
from talkingeyes.training.resume import ResumeFile


def run(workspace: Workspace, name: str) -> Report:
    """Pretrain a tokenizer of gaze or of the face, by the kind of its section; measure its code usage."""
    task, context = _task(workspace, name), ExecutionContext.of(workspace.params["machine"])
    resume = _resume_file(workspace, name, task.settings, context)
    history = train(task, task.settings.loop, f"pretrain {name}", context=context, resume=resume)
    context.exit_unless_main()
    figures, counts = task.finish()
    with workspace.output("pretrain", name) as folder:
        save(folder, task.module.state_dict(), task.config(), history)
        if len(counts):
            (folder / "codes.json").write_text(json.dumps({"counts": counts.int().tolist(), **figures}))
    resume.remove()
    return Report(metrics=figures)


def _task(workspace: Workspace, name: str) -> GazeTokenizerTask | FaceTokenizerTask:
    inputs = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    tokenizer = workspace.params.get("pretrain", {}).get(name)
    if isinstance(tokenizer, dict) and tokenizer.get("kind") == "face":
        faces, val_faces = (face_recordings(*inputs, split, take=0) for split in ("train", "val"))
        basis = FaceBasis(faces.head_model, faces.expression_names)
        return FaceTokenizerTask(workspace.settings(f"pretrain.{name}", FaceTokenizerSettings), faces, val_faces, basis)
    settings = workspace.settings(f"pretrain.{name}", GazeTokenizerSettings)
    return GazeTokenizerTask(settings, *(recordings(*inputs, split, take=0) for split in ("train", "val")))


def _resume_file(workspace: Workspace, name: str, settings: Settings, context: ExecutionContext) -> ResumeFile:
    """The resume file of this training, with a fingerprint of all its dependencies."""
    sums = [workspace.data(stage) / CHECKSUMS_FILE for stage in ("fit", "embed")]
    reads = (workspace.corpus / "clips.parquet", *sums, Path(__file__))
    fingerprint = (settings.model_dump(mode="json"), context.describe())
    return ResumeFile.of(workspace.data(f".pretrain-{name}.resume"), fingerprint, reads)


if __name__ == "__main__":
    main(run)
