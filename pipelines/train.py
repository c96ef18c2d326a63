"""Train one speech-to-motion model on the fitted motion of the train split.

Run: python -m pipelines.train talkingeyes
Reads: the corpus index, data/fit, data/embed, data/pretrain/<prior>.
Writes: data/train/<model>: all that generation needs.
Killed, it goes on from data/.train-<model>.progress; torchrun --nproc-per-node N shares the batches.
"""

import shutil
from pathlib import Path

import numpy as np

from talkingeyes.corpus.store import Corpus
from talkingeyes.corpus.windows import Normaliser, recordings
from talkingeyes.fitting.manner import SPEAKERS_FILE
from talkingeyes.learning.checkpoint import load, save
from talkingeyes.learning.loop import train
from talkingeyes.learning.place import Place
from talkingeyes.learning.progress import Progress
from talkingeyes.learning.trained import network_config, save_baseline
from talkingeyes.learning.translation import TrainSettings, TranslationSettings, TranslationTask
from talkingeyes.models.baselines import BaselineSettings, bank_of
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.run import SUMS, Report, Workspace, main


def run(workspace: Workspace, name: str) -> Report:
    """A network is trained, a baseline fitted; both leave the same kind of folder."""
    seed = workspace.settings("train", TrainSettings).seed
    place = Place.of(workspace.params["machine"])
    model = workspace.params.get("model", {}).get(name)
    if isinstance(model, dict) and model.get("kind") == "speech_to_motion":
        return _network(workspace, name, workspace.settings(f"model.{name}", TranslationSettings), seed, place)
    place.leave_unless_first()
    return _baseline(workspace, name, workspace.settings(f"model.{name}", BaselineSettings))


def _network(workspace: Workspace, name: str, settings: TranslationSettings, seed: int, place: Place) -> Report:
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser = Normaliser.of(embed)
    codebook = _codebook(workspace, settings.prior)
    data = recordings(corpus, fit, embed, "train"), recordings(corpus, fit, embed, "val")
    task = TranslationTask(settings, seed, *data, normaliser, codebook)
    progress = _progress(workspace, name, settings, seed, place)
    history = train(task, settings.loop, f"train {name}", report=workspace.watch, place=place, progress=progress)
    place.leave_unless_first()
    chosen = task.choose_temperature()
    figures = {**history[-1], **chosen, "temperature": float(task.module.temperature), **task.truth_figures()}
    with workspace.output("train", name) as folder:
        config = network_config(settings, normaliser.channels, codebook)
        save(folder, task.module.state_dict(), config, [*history, chosen])
        _keep_what_animate_needs(workspace, folder)
    progress.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    return Report(metrics={**figures, "parameters": weights})


def _progress(workspace: Workspace, name: str, settings: TranslationSettings, seed: int, place: Place) -> Progress:
    """The file of this training, and all that its result follows from."""
    folders = [workspace.data("fit"), workspace.data("embed"), workspace.data("pretrain", str(settings.prior))]
    reads = (workspace.corpus / "clips.parquet", *(folder / SUMS for folder in folders), Path(__file__))
    made_of = (settings.model_dump(mode="json"), seed, place.describe())
    return Progress.of(workspace.data(f".train-{name}.progress"), made_of, reads)


def _codebook(workspace: Workspace, prior: str | None) -> GazeVQVAE | None:
    if prior is None:
        return None
    checkpoint = load(workspace.data("pretrain", prior))
    codebook = GazeVQVAE(GazeVQVAESettings.model_validate(checkpoint.config))
    codebook.load_state_dict(checkpoint.tensors)
    return codebook.freeze()


def _baseline(workspace: Workspace, name: str, settings: BaselineSettings) -> Report:
    embed = workspace.data("embed")
    normaliser = Normaliser.of(embed)
    clips = recordings(Corpus(workspace.corpus), workspace.data("fit"), embed, "train")
    std = np.maximum(normaliser.std, 1e-6)
    bank = bank_of(
        [(np.asarray(each.speech) - normaliser.mean) / std for each in clips],
        [each.head for each in clips],
        [each.gaze for each in clips],
    )
    with workspace.output("train", name) as folder:
        save_baseline(folder, settings, bank, normaliser.mean, normaliser.std)
        _keep_what_animate_needs(workspace, folder)
    return Report(metrics={"clips": len(bank.features)})


def _keep_what_animate_needs(workspace: Workspace, folder: Path) -> None:
    """The encoder's settings, the blinks of the corpus and its speakers' habits, so that a model's folder is whole."""
    shutil.copyfile(workspace.data("embed", "embedding.json"), folder / "embedding.json")
    shutil.copyfile(workspace.data("fit", "blinks.json"), folder / "blinks.json")
    if workspace.data("fit", SPEAKERS_FILE).exists():
        shutil.copyfile(workspace.data("fit", SPEAKERS_FILE), folder / SPEAKERS_FILE)


if __name__ == "__main__":
    main(run)
