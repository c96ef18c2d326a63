"""Stage `critic`: train the evaluation networks: contrastive critics behind Corr. for eye-in-head, gaze in space and
head, the encoder behind the Frechet distance, and the classifier of emotion from head and gaze.

Reads   the corpus, data/fit, data/embed (train split; test and unseen only for the report after training)
Writes  data/critic/<part>/ and data/critic/encoder/ (weights, config, history) and data/critic/report.json: AUC with
        negatives of the same speaker and with all; Corr. of the truth, of the truth with other sounds of the speaker,
        and of a constant; data/critic/notes.txt: one line per part whose metrics have a caveat; data/critic/emotion.npz
        (not for a corpus of fewer than two emotions)
Run     python -m pipelines.critic; an interrupted run resumes from data/.critic-<part>.resume
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.fitted_clips import motion_path
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import recordings
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.measures.critic import (
    ChannelSelection,
    CriticScores,
    CriticSettings,
    score_critic,
    split_speakers,
    train_critic,
)
from talkingeyes.evaluation.papers.probtalk3d_metrics import EmotionClassifier
from talkingeyes.evaluation.report.emotion import EMOTION_FILE, fit_classifier, head_gaze_features
from talkingeyes.models.contrastive_critic import CRITIC_PARTS
from talkingeyes.orchestration.run import CHECKSUMS_FILE, Report, Workspace, main, parallel_map


@dataclass(frozen=True)
class CriticResult:
    """Scores of the critic of a part by group of clips, and a caveat for readers of its metrics."""

    verdicts: dict[str, CriticScores]
    caveat: str


def run(workspace: Workspace) -> Report:
    """Train the three parts, each in its own process."""
    settings = workspace.settings("critic", CriticSettings)
    machine = workspace.params["machine"]
    with workspace.output("critic") as folder:
        train = partial(
            train_part, workspace.corpus, workspace.data("fit"), workspace.data("embed"), folder, settings, machine
        )
        trained = dict(zip(CRITIC_PARTS, parallel_map(train, CRITIC_PARTS, workspace.jobs, "critic"), strict=True))
        verdicts = {part: one.verdicts for part, one in trained.items()}
        report = {
            part: {group: asdict(verdict) for group, verdict in groups.items()} for part, groups in verdicts.items()
        }
        (folder / "report.json").write_text(json.dumps(report, indent=1))
        notes = [f"{part}: {one.caveat}" for part, one in trained.items() if one.caveat]
        (folder / "notes.txt").write_text("".join(f"- {caveat}\n" for caveat in notes))
        for caveat in notes:
            print(f"critic of {caveat}")
        explained = train_encoder(workspace.corpus, workspace.data("fit"), workspace.data("embed"), folder, settings)
        if (classifier := train_emotion_classifier(workspace)) is not None:
            classifier.save(folder / EMOTION_FILE)
    for part in CRITIC_PARTS:
        workspace.data(f".critic-{part}.resume").unlink(missing_ok=True)
    metrics = {**dict(_flat(verdicts)), "encoder/explained": explained}
    return Report(metrics=metrics, artifacts=[workspace.data("critic", "report.json")])


def train_part(
    corpus_root: Path,
    fit: Path,
    embed: Path,
    folder: Path,
    settings: CriticSettings,
    machine: Mapping[str, Any],
    part: str,
) -> CriticResult:
    """Train and save the critic of one part; return its scores on each group of speakers."""
    from talkingeyes.training.checkpoint import save
    from talkingeyes.training.execution import ExecutionContext
    from talkingeyes.training.resume import ResumeFile

    context = ExecutionContext.single_process(machine)
    reads = (corpus_root / "clips.parquet", fit / CHECKSUMS_FILE, embed / CHECKSUMS_FILE, Path(__file__))
    fingerprint = (settings.model_dump(mode="json"), part, context.describe())
    resume = ResumeFile.of(folder.with_name(f".critic-{part}.resume"), fingerprint, reads)
    corpus = Corpus(corpus_root)
    channel_selection = ChannelSelection.of(json.loads((embed / "embedding.json").read_text()), settings.channels)
    trained = train_critic(part, recordings(corpus, fit, embed, "train"), channel_selection, settings, context, resume)
    (folder / part).mkdir()
    save(folder / part, trained.corr.critic.state_dict(), trained.config, trained.history)
    groups = {
        "held_out": trained.held_out,
        "test": recordings(corpus, fit, embed, "test", take=0),
        "unseen": recordings(corpus, fit, embed, "unseen", take=0),
        "test_and_unseen": recordings(corpus, fit, embed, "test", "unseen", take=0),
    }
    verdicts = {name: score_critic(trained.corr, list(group), settings.bootstrap) for name, group in groups.items()}
    return CriticResult(verdicts, trained.caveat)


def train_encoder(corpus_root: Path, fit: Path, embed: Path, folder: Path, settings: CriticSettings) -> float:
    """Train and save the encoder; return the fraction of variance that it explains on the held-out speakers."""
    from talkingeyes.evaluation.measures.motion_encoder import CHECKPOINT_NAME, fit_motion_encoder
    from talkingeyes.training.checkpoint import save

    known = recordings(Corpus(corpus_root), fit, embed, "train")
    division = split_speakers(known, settings)
    train, held_out = ([known[index] for index in indices] for indices in (division.train, division.held_out))
    trained = fit_motion_encoder(train, held_out, settings.encoder, settings.seed)
    (folder / CHECKPOINT_NAME).mkdir()
    save(folder / CHECKPOINT_NAME, trained.encoder.network.state_dict(), trained.encoder.config, trained.history)
    return max(row["explained_variance"] for row in trained.history)


def train_emotion_classifier(workspace: Workspace) -> EmotionClassifier | None:
    """Train the classifier of emotion from head and gaze on real motion; None if it has fewer than two emotions."""
    corpus, fit = Corpus(workspace.corpus), workspace.data("fit")
    clips = [each for each in corpus.select("train", take=0) if motion_path(fit, each).exists()]
    if len({clip.emotion for clip in clips}) < 2:
        return None
    measure = partial(_real_features, corpus.root, fit)
    features = np.array(list(parallel_map(measure, clips, workspace.jobs, "critic: emotions")))
    return fit_classifier(features, [clip.emotion for clip in clips])


def _real_features(root: Path, fit: Path, clip: Clip) -> Float[ndarray, " F"]:
    corpus = Corpus(root)
    motion = corpus.truth(clip) if corpus.has_truth else Motion.load(motion_path(fit, clip))
    return np.asarray(head_gaze_features(Samples.of(clip.fps, [motion]))[0])


def _flat(verdicts: dict[str, dict[str, CriticScores]]) -> Iterable[tuple[str, float]]:
    for part, groups in verdicts.items():
        for group, verdict in groups.items():
            for name, estimate in asdict(verdict).items():
                if estimate is not None:
                    yield f"{group}/{part}/{name}", estimate["value"]


if __name__ == "__main__":
    main(run)
