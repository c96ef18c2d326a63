"""Pretrain a codebook of gaze, or a motion autoencoder of the face, on the fitted motion of the train split.

Run: python -m pipelines.pretrain gaze_frames
Reads: the corpus index, data/fit, data/embed. Writes: data/pretrain/<prior>: weights, history, code use.
Killed, it goes on from data/.pretrain-<prior>.progress; torchrun --nproc-per-node N shares the batches.
"""

import json
from pathlib import Path

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.faces import faces
from talkingeyes.corpus.store import Corpus
from talkingeyes.corpus.windows import recordings
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.orchestration.run import SUMS, Report, Workspace, main
from talkingeyes.training.checkpoint import save
from talkingeyes.training.face_priors import FacePriorSettings, FacePriorTask, prior_config
from talkingeyes.training.loop import train
from talkingeyes.training.place import Place
from talkingeyes.training.priors import PriorSettings, PriorTask
from talkingeyes.training.progress import Progress


def run(workspace: Workspace, name: str) -> Report:
    """Of gaze or of the face, as the section says."""
    prior = workspace.params.get("pretrain", {}).get(name)
    if isinstance(prior, dict) and prior.get("kind") == "face":
        return _face(workspace, name, workspace.settings(f"pretrain.{name}", FacePriorSettings))
    return _gaze(workspace, name, workspace.settings(f"pretrain.{name}", PriorSettings))


def _gaze(workspace: Workspace, name: str, settings: PriorSettings) -> Report:
    """Train, then count code use over all windows of the train split."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    task = PriorTask(settings, recordings(corpus, fit, embed, "train"), recordings(corpus, fit, embed, "val"))
    place = Place.of(workspace.params["machine"])
    progress = _progress(workspace, name, settings, place)
    history = train(task, settings.loop, f"pretrain {name}", place=place, progress=progress)
    place.leave_unless_first()
    use = task.use(task.train_recordings)
    figures = use.figures() | {"val_error_deg": task.use(task.val_recordings).error_deg}
    with workspace.output("pretrain", name) as folder:
        save(folder, task.module.state_dict(), settings.network.model_dump(mode="json"), history)
        (folder / "codes.json").write_text(json.dumps({"counts": use.counts.int().tolist(), **figures}))
    progress.remove()
    return Report(metrics=figures)


def _face(workspace: Workspace, name: str, settings: FacePriorSettings) -> Report:
    """Train, then take the autoencoder's units of its own latents and count the use of codes, if it has any."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    known, held_out = faces(corpus, fit, embed, "train"), faces(corpus, fit, embed, "val")
    basis = FaceBasis(known.head_model, known.expression_names)
    task = FacePriorTask(settings, known, held_out, basis)
    place = Place.of(workspace.params["machine"])
    progress = _progress(workspace, name, settings, place)
    history = train(task, settings.loop, f"pretrain {name}", place=place, progress=progress)
    place.leave_unless_first()
    task.measure()
    error = task.error(known)
    of_val = {
        f"val_{name}": value for name, value in task.error(held_out).figures().items() if name.startswith("error")
    }
    figures = error.figures() | of_val
    with workspace.output("pretrain", name) as folder:
        save(folder, task.module.state_dict(), prior_config(settings.network, basis), history)
        if len(error.counts):
            (folder / "codes.json").write_text(json.dumps({"counts": error.counts.int().tolist(), **figures}))
    progress.remove()
    return Report(metrics=figures)


def _progress(workspace: Workspace, name: str, settings: Settings, place: Place) -> Progress:
    """The file of this training, and all that its result follows from."""
    sums = [workspace.data(stage) / SUMS for stage in ("fit", "embed")]
    reads = (workspace.corpus / "clips.parquet", *sums, Path(__file__))
    made_of = (settings.model_dump(mode="json"), place.describe())
    return Progress.of(workspace.data(f".pretrain-{name}.progress"), made_of, reads)


if __name__ == "__main__":
    main(run)
