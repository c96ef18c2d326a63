"""Pretrain a codebook of gaze on the fitted motion of the train split.

Run: python -m pipelines.pretrain gaze_patches
Reads: the corpus index, data/fit, data/embed. Writes: data/pretrain/<prior>: weights, history, code use.
Killed, it goes on from data/.pretrain-<prior>.progress; torchrun --nproc-per-node N shares the batches.
"""

import json
from pathlib import Path

from talkingeyes.corpus.store import Corpus
from talkingeyes.corpus.windows import recordings
from talkingeyes.learning.checkpoint import save
from talkingeyes.learning.loop import train
from talkingeyes.learning.place import Place
from talkingeyes.learning.priors import PriorSettings, PriorTask
from talkingeyes.learning.progress import Progress
from talkingeyes.run import SUMS, Report, Workspace, main


def run(workspace: Workspace, name: str) -> Report:
    """Train, then count code use over all windows of the train split."""
    settings = workspace.settings(f"pretrain.{name}", PriorSettings)
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    task = PriorTask(settings, recordings(corpus, fit, embed, "train"), recordings(corpus, fit, embed, "val"))
    place = Place.of(workspace.params["machine"])
    reads = (workspace.corpus / "clips.parquet", fit / SUMS, embed / SUMS, Path(__file__))
    made_of = (settings.model_dump(mode="json"), place.describe())
    progress = Progress.of(workspace.data(f".pretrain-{name}.progress"), made_of, reads)
    history = train(task, settings.loop, f"pretrain {name}", place=place, progress=progress)
    place.leave_unless_first()
    use = task.use(task.train_recordings)
    figures = use.figures() | {"val_error_deg": task.use(task.val_recordings).error_deg}
    with workspace.output("pretrain", name) as folder:
        save(folder, task.module.state_dict(), settings.network.model_dump(mode="json"), history)
        (folder / "codes.json").write_text(json.dumps({"counts": use.counts.int().tolist(), **figures}))
    progress.remove()
    return Report(metrics=figures)


if __name__ == "__main__":
    main(run)
