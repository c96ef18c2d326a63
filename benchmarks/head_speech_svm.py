"""Table 1 of Zhang et al. against the amount of speech: does a one-class SVM find own poses above random ones?

Run: python -m benchmarks.head_speech_svm [DATA]        default: build/posegan_paper/data
Reads DATA/synthesize, DATA/fit and DATA/embed of experiment=posegan_paper (target=fit, then target=embed).
Prints a table: for each amount of speech per speaker, windows of 256 frames accepted with own poses, with poses of
another clip of the same speaker and with poses of other speakers; and the area under the ROC curve of own against
another clip, threshold-free, with a 95 % interval over test clips (0.5: no relation between speech and pose is found).

Three settings: test clips that the SVM has not seen; test windows out of the clips that it was trained on (such as a
split of overlapping windows gives); and a control, poses that follow speech with a given correlation.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.corpus.poses import PoseRecording, PoseSettings, pose_recordings
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.head_pose.evaluation import SVM, SVM_HOP, WINDOW_FRAMES
from talkingeyes.evaluation.head_pose.one_class_svm import correlations, fit_pca
from talkingeyes.evaluation.head_pose.windows import sliding_windows
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command

MINUTES = (2, 4, 8, 16, 32, 48)  # the last: all clips of the train split
CONTROLS = (0.1, 0.2, 0.3, 0.5)
DRAWS = 1000


@dataclass(frozen=True)
class ClipWindows:
    """Windows of one clip: principal components of speech, and poses."""

    speaker: str
    speech: Float[ndarray, "N L S"]
    pose: Float[ndarray, "N L 6"]


@dataclass(frozen=True)
class Scores:
    """Values of the decision function by window for one speaker; `clip` is the test clip of each window."""

    own: Float[ndarray, " N"]
    same_speaker: Float[ndarray, " N"]
    other_speakers: Float[ndarray, " N"]
    clip: ndarray


def main() -> None:
    """Print the table."""
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("build/posegan_paper/data")
    train, test = read_windows(data)
    print("| setting | minutes | own | another clip, same speaker | other speakers | AUC own / another clip |")
    print("|---|---|---|---|---|---|")
    for minutes in MINUTES:
        print(row("unseen clips", minutes, train, test))
    for minutes in MINUTES:
        print(row("windows of seen clips", minutes, *split_windows(train)))
    for correlation in CONTROLS:
        control = [[following(each, correlation) for each in clips] for clips in (train, test)]
        print(row(f"control, correlation {correlation}", MINUTES[-1], *control))


def read_windows(data: Path) -> tuple[list[ClipWindows], list[ClipWindows]]:
    """Windows of train and test clips of the speakers in both."""
    settings = PoseSettings.model_validate(compose(["experiment=posegan_paper"])["model"]["posegan"]["poses"])
    normaliser = Normaliser.of(data / "embed")
    std = np.maximum(normaliser.std, 1e-6)

    def recordings(split: str) -> Sequence[PoseRecording]:
        return pose_recordings(Corpus(data / "synthesize"), data / "fit", data / "embed", settings, split, take=0)

    frames = np.concatenate([((each.speech - normaliser.mean) / std)[::10] for each in recordings("train")])
    pca = fit_pca(frames[None], SVM)

    def windows(each: PoseRecording) -> ClipWindows:
        components = np.asarray(pca.transform((each.speech - normaliser.mean) / std))
        speech, pose = (sliding_windows(rows, WINDOW_FRAMES, SVM_HOP) for rows in (components, each.pose))
        return ClipWindows(each.clip.speaker, speech, pose)

    train, test = ([windows(each) for each in recordings(split)] for split in ("train", "test"))
    both = {each.speaker for each in train} & {each.speaker for each in test}
    return [each for each in train if each.speaker in both], [each for each in test if each.speaker in both]


def split_windows(clips: Sequence[ClipWindows]) -> tuple[list[ClipWindows], list[ClipWindows]]:
    """Every fifth window of each clip as test, the others as train."""
    kept = [np.arange(len(each.pose)) % 5 != 0 for each in clips]
    return tuple(  # type: ignore[return-value]
        [ClipWindows(each.speaker, each.speech[part], each.pose[part]) for each, part in zip(clips, parts, strict=True)]
        for parts in (kept, [~each for each in kept])
    )


def following(clip: ClipWindows, correlation: float) -> ClipWindows:
    """Poses of which each number has this correlation with one component of speech, added in each window."""
    components, pose = (_standard(each) for each in (clip.speech[:, :, :6], clip.pose))
    return ClipWindows(clip.speaker, clip.speech, correlation * components + np.sqrt(1 - correlation**2) * pose)


def _standard(rows: Float[ndarray, "N L D"]) -> Float[ndarray, "N L D"]:
    return np.asarray((rows - rows.mean(1, keepdims=True)) / rows.std(1, keepdims=True).clip(1e-9))


def row(setting: str, minutes: int, train: Sequence[ClipWindows], test: Sequence[ClipWindows]) -> str:
    """One line of the table: means over the speakers."""
    scores = [speaker_scores(each, minutes, train, test) for each in sorted({clip.speaker for clip in test})]
    accepted = [
        float(np.mean([(getattr(each, name) > 0).mean() for each in scores]))
        for name in ("own", "same_speaker", "other_speakers")
    ]
    low, high = np.percentile(list(_redrawn(scores)), [2.5, 97.5])
    area = float(np.mean([roc_auc(each.own, each.same_speaker) for each in scores]))
    cells = [setting, str(minutes), *(f"{each:.2f}" for each in accepted), f"{area:.3f} ({low:.3f} to {high:.3f})"]
    return f"| {' | '.join(cells)} |"


def speaker_scores(speaker: str, minutes: int, train: Sequence[ClipWindows], test: Sequence[ClipWindows]) -> Scores:
    """Train the SVM on the first minutes of a speaker's clips (of a minute each) and score his test windows."""
    from sklearn.svm import OneClassSVM

    own = [each for each in train if each.speaker == speaker][:minutes]
    seen = np.concatenate([correlations(each.speech, each.pose) for each in own])
    svm = OneClassSVM(nu=SVM.nu, gamma="scale").fit(seen)
    rng = np.random.default_rng(SVM.seed)
    tested = [index for index, each in enumerate(test) if each.speaker == speaker]

    def scored(choose: Any) -> Float[ndarray, " N"]:
        return np.concatenate(
            [svm.decision_function(correlations(test[index].speech, choose(index))) for index in tested]
        )

    def of_another(index: int, same: bool) -> Float[ndarray, "N L 6"]:
        sources = [other for other, each in enumerate(test) if other != index and (each.speaker == speaker) == same]
        pool = np.concatenate([test[other].pose for other in sources])
        return np.asarray(pool[rng.integers(len(pool), size=len(test[index].pose))])

    return Scores(
        own=scored(lambda index: test[index].pose),
        same_speaker=scored(lambda index: of_another(index, same=True)),
        other_speakers=scored(lambda index: of_another(index, same=False)),
        clip=np.repeat(tested, [len(test[index].pose) for index in tested]),
    )


def roc_auc(own: Float[ndarray, " N"], other: Float[ndarray, " M"]) -> float:
    """Probability that an own window scores above another, ties counted half."""
    from sklearn.metrics import roc_auc_score

    labels = np.repeat([1, 0], [len(own), len(other)])
    return float(roc_auc_score(labels, np.concatenate([own, other])))


def _redrawn(scores: Sequence[Scores]) -> Iterator[float]:
    """The mean area over speakers, with the test clips of each drawn again with replacement."""
    rng = np.random.default_rng(SVM.seed)
    rows = [{clip: np.flatnonzero(each.clip == clip) for clip in np.unique(each.clip)} for each in scores]
    for _ in range(DRAWS):
        areas = []
        for each, of_clip in zip(scores, rows, strict=True):
            drawn = np.concatenate([of_clip[clip] for clip in rng.choice(list(of_clip), len(of_clip))])
            areas.append(roc_auc(each.own[drawn], each.same_speaker[drawn]))
        yield float(np.mean(areas))


if __name__ == "__main__":
    run_command(main)
