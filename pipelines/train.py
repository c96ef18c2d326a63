"""Train one model, of head and gaze or of the face, on the fitted motion of the train split.

Run: python -m pipelines.train talkingeyes
Reads: the corpus index, data/fit, data/embed, data/pretrain/<prior>, data/train/<model> where it starts from another
or is made of others; the corpus's sound, for a model that hears the waveform.
Writes: data/train/<model>: all that generation needs.
Killed, it goes on from data/.train-<model>.progress; torchrun --nproc-per-node N shares the batches.
"""

import shutil
from pathlib import Path

import numpy as np

from talkingeyes.corpus.faces import faces
from talkingeyes.corpus.poses import pose_recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.corpus.windows import Normaliser, recordings
from talkingeyes.fitting.manner import SPEAKERS_FILE
from talkingeyes.head.anny import open_head
from talkingeyes.head.sag import FaceSurface
from talkingeyes.models.baselines import BaselineSettings, bank_of, bank_of_motions
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.orchestration.run import SUMS, Report, Workspace, main
from talkingeyes.training.checkpoint import load, save
from talkingeyes.training.face_priors import load_prior
from talkingeyes.training.face_trained import face_config, save_face_baseline
from talkingeyes.training.face_translation import FaceData, FaceTask, FaceTranslationSettings
from talkingeyes.training.loop import train
from talkingeyes.training.pgface import PGFaceSettings, PGFaceTask, pgface_config, read_shapes
from talkingeyes.training.place import Place
from talkingeyes.training.poses import PoseModelSettings, PoseTask
from talkingeyes.training.progress import Progress
from talkingeyes.training.telling import Beside
from talkingeyes.training.trained import HeadThenGazeSettings, network_config, save_baseline, save_head_then_gaze
from talkingeyes.training.trained_canonical import CanonicalModelSettings, find, save_canonical
from talkingeyes.training.trained_poses import pose_config
from talkingeyes.training.translation import TrainSettings, TranslationSettings, TranslationTask

NetworkSettings = TranslationSettings | FaceTranslationSettings | PoseModelSettings | PGFaceSettings


def run(workspace: Workspace, name: str) -> Report:
    """A network is trained, a baseline fitted; both leave the same kind of folder."""
    seed = workspace.settings("train", TrainSettings).seed
    place = Place.of(workspace.params["machine"])
    model = workspace.params.get("model", {}).get(name)
    if isinstance(model, dict) and model.get("kind") == "speech_to_motion":
        return _network(workspace, name, workspace.settings(f"model.{name}", TranslationSettings), seed, place)
    if isinstance(model, dict) and model.get("kind") == "speech_to_face":
        return _face(workspace, name, workspace.settings(f"model.{name}", FaceTranslationSettings), seed, place)
    if isinstance(model, dict) and model.get("kind") == "speech_to_pose":
        return _poses(workspace, name, workspace.settings(f"model.{name}", PoseModelSettings), seed)
    if isinstance(model, dict) and model.get("kind") == "pgface":
        return _pgface(workspace, name, workspace.settings(f"model.{name}", PGFaceSettings), seed)
    place.leave_unless_first()
    return _without_steps(workspace, name, model.get("kind") if isinstance(model, dict) else None, seed)


def _without_steps(workspace: Workspace, name: str, kind: str | None, seed: int) -> Report:
    """What has no loop: models made of others, and baselines."""
    if kind == "head_then_gaze":
        return _joined(workspace, name, workspace.settings(f"model.{name}", HeadThenGazeSettings))
    if kind == "canonical":
        return _canonical(workspace, name, workspace.settings(f"model.{name}", CanonicalModelSettings), seed)
    settings = workspace.settings(f"model.{name}", BaselineSettings)
    return (
        _face_baseline(workspace, name, settings) if "face" in settings.parts else _baseline(workspace, name, settings)
    )


def _network(workspace: Workspace, name: str, settings: TranslationSettings, seed: int, place: Place) -> Report:
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser = Normaliser.of(embed)
    codebook = _codebook(workspace, settings.prior)
    data = recordings(corpus, fit, embed, "train"), recordings(corpus, fit, embed, "val")
    start = load(workspace.data("train", settings.start_from)) if settings.start_from else None
    task = TranslationTask(settings, seed, *data, normaliser, codebook, Beside(corpus, embed), start)
    progress = _progress(workspace, name, settings, seed, place)
    history = train(task, settings.loop, f"train {name}", report=workspace.watch, place=place, progress=progress)
    place.leave_unless_first()
    task.equalise()
    chosen = task.choose_temperature()
    figures = {**history[-1], **chosen, "temperature": float(task.module.temperature), **task.truth_figures()}
    with workspace.output("train", name) as folder:
        config = network_config(settings, normaliser.channels, codebook, task.module)
        save(folder, task.module.state_dict(), config, [*history, chosen])
        _keep_what_animate_needs(workspace, folder)
    progress.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    return Report(metrics={**figures, "parameters": weights})


def _face(workspace: Workspace, name: str, settings: FaceTranslationSettings, seed: int, place: Place) -> Report:
    data = _face_data(workspace)
    prior = load_prior(workspace.data("pretrain", settings.prior)) if settings.prior else None
    if prior is not None:
        prior.basis.require(
            data.basis, str(workspace.data("pretrain", str(settings.prior))), "pretrain it on this motion"
        )
    task = FaceTask(settings, seed, data, prior)
    progress = _progress(workspace, name, settings, seed, place)
    history = train(task, settings.loop, f"train {name}", report=workspace.watch, place=place, progress=progress)
    place.leave_unless_first()
    chosen = task.choose_temperature()
    figures = {**history[-1], **chosen, "temperature": float(task.module.temperature)}
    with workspace.output("train", name) as folder:
        save(folder, task.module.state_dict(), face_config(settings, data, prior), [*history, chosen])
        _keep_what_animate_needs(workspace, folder)
    progress.remove()
    return Report(metrics={**figures, "parameters": sum(each.numel() for each in task.module.parameters())})


def _face_data(workspace: Workspace) -> FaceData:
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    known = faces(corpus, fit, embed, "train")
    basis = FaceBasis(known.head_model, known.expression_names)
    vocabulary = StyleVocabulary.of(known.clips)
    return FaceData(known, faces(corpus, fit, embed, "val"), basis, vocabulary, Normaliser.of(embed))


def _poses(workspace: Workspace, name: str, settings: PoseModelSettings, seed: int) -> Report:
    """A model of the head alone; its curves, the rival's among them, go to the record of runs."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser, place = Normaliser.of(embed), Place.alone(workspace.params["machine"])
    of_train, of_val = (
        pose_recordings(corpus, fit, embed, settings.poses, split, take=0) for split in ("train", "val")
    )
    task = PoseTask(settings, seed, of_train, of_val, normaliser)
    progress = _progress(workspace, name, settings, seed, place)
    if settings.loop is None:
        history = [{"step": 0.0, **task.validate()}]
    else:
        history = train(task, settings.loop, f"train {name}", report=workspace.watch, place=place, progress=progress)
    with workspace.output("train", name) as folder:
        save(folder, task.module.state_dict(), pose_config(settings, normaliser, task.module), history)
        _keep_what_animate_needs(workspace, folder)
    progress.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    of_rival = sum(parameter.numel() for parameter in task.rival.parameters()) if task.rival else 0
    figures = {**history[-1], "parameters": weights - of_rival, "parameters_rival": of_rival}
    return Report(metrics=figures, history=history)


def _pgface(workspace: Workspace, name: str, settings: PGFaceSettings, seed: int) -> Report:
    """The face's shape of speech and head pose."""
    corpus, fit, embed = Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed")
    normaliser, place, surface = (
        Normaliser.of(embed),
        Place.alone(workspace.params["machine"]),
        FaceSurface(open_head()),
    )
    of_train, of_val = (
        [read_shapes(fit, embed, clip, settings.poses) for clip in recordings(corpus, fit, embed, split, take=0).clips]
        for split in ("train", "val")
    )
    task = PGFaceTask(settings, seed, of_train, of_val, normaliser, surface)
    progress = _progress(workspace, name, settings, seed, place)
    history = train(task, settings.loop, f"train {name}", report=workspace.watch, place=place, progress=progress)
    with workspace.output("train", name) as folder:
        save(folder, task.module.state_dict(), pgface_config(settings, normaliser, surface), history)
        _keep_what_animate_needs(workspace, folder)
    progress.remove()
    weights = sum(parameter.numel() for parameter in task.module.parameters())
    return Report(metrics={**history[-1], "parameters": weights}, history=history)


def _joined(workspace: Workspace, name: str, settings: HeadThenGazeSettings) -> Report:
    """Nothing is trained: two models that are stand in one folder."""
    head, gaze = (load(workspace.data("train", each)) for each in settings.made_of)
    with workspace.output("train", name) as folder:
        save_head_then_gaze(folder, settings, head, gaze)
        _keep_what_animate_needs(workspace, folder)
    return Report()


def _canonical(workspace: Workspace, name: str, settings: CanonicalModelSettings, seed: int) -> Report:
    """In closed form, behind the head of a model that is."""
    embed = workspace.data("embed")
    clips = recordings(Corpus(workspace.corpus), workspace.data("fit"), embed, "train")
    found = find(settings, clips, Normaliser.of(embed), seed)
    with workspace.output("train", name) as folder:
        save_canonical(folder, settings, found, load(workspace.data("train", *settings.made_of)))
        _keep_what_animate_needs(workspace, folder)
    return Report(metrics={f"correlation/{at}": float(each) for at, each in enumerate(found.found.correlations)})


def _progress(workspace: Workspace, name: str, settings: NetworkSettings, seed: int, place: Place) -> Progress:
    """The file of this training, and all that its result follows from."""
    folders = [workspace.data("fit"), workspace.data("embed"), workspace.data("pretrain", str(settings.prior))]
    if isinstance(settings, TranslationSettings) and settings.start_from:
        folders.append(workspace.data("train", settings.start_from))
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


def _face_baseline(workspace: Workspace, name: str, settings: BaselineSettings) -> Report:
    data = _face_data(workspace)
    std = np.maximum(data.normaliser.std, 1e-6)
    bank = bank_of_motions(
        [(np.asarray(each.speech) - data.normaliser.mean) / std for each in data.train],
        [data.basis.joined(each.expression, each.jaw) for each in data.train],
    )
    with workspace.output("train", name) as folder:
        save_face_baseline(folder, settings, bank, data)
        _keep_what_animate_needs(workspace, folder)
    return Report(metrics={"clips": len(bank.features)})


def _keep_what_animate_needs(workspace: Workspace, folder: Path) -> None:
    """The encoder's settings, the blinks of the corpus and its speakers' habits, so that a model's folder is whole."""
    for stage, name in (("embed", "embedding.json"), ("fit", "blinks.json"), ("fit", SPEAKERS_FILE)):
        shutil.copyfile(workspace.data(stage, name), folder / name)


if __name__ == "__main__":
    main(run)
