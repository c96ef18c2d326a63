"""The contrastive audio-motion critic: training with InfoNCE (van den Oord et al. 2018), Corr., and scores.

A positive is the speech and the motion of one window of the train split. The negatives are the motions of other sounds
of the same speaker and the right motion shifted in time. Motions of other speakers are not used as negatives, so the
critic cannot lower its loss by identifying the speaker. The best checkpoint is chosen on held-out train speakers.

Where no speaker has two sounds, as in a corpus of single short videos, time shifts are the only negatives in training
and validation. Such a critic detects synchrony, not which sound a motion belongs to; `TIME_SHIFTS_ONLY` is the caveat
reported with its scores.

Corr. (section V-B.3) is the cosine of the critic's features of sound and motion over windows of 8 s. Higher is not
better: a conditional mean is more predictable than true motion, and a constant can score above a random sample. Corr.
is therefore read as a difference from the Corr. of the truth, next to shuffled truth and a constant.

A Corr. cannot be interpreted without the scores of its critic: how often the right motion scores above another motion
of the same speaker, and the Corr. of the truth, of the truth under other sounds, and of a motionless face.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.corpus.recordings import Recording
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, Statistic, bootstrap, mean_statistic
from talkingeyes.evaluation.measures.motion_encoder import EncoderSettings
from talkingeyes.models.contrastive_critic import (
    CRITIC_PARTS,
    MIRROR_SIGNS,
    Critic,
    CriticNetworkSettings,
    part_angles,
    similarity,
)
from talkingeyes.training.checkpoint import load
from talkingeyes.training.execution import CPU_CONTEXT, ExecutionContext
from talkingeyes.training.loop import LoopSettings, train
from talkingeyes.training.resume import ResumeFile


class CriticSettings(Settings):
    """The section `critic`."""

    seed: int
    channels: Annotated[list[str], Field(min_length=1)]  # channels of the speech embedding, the critic's input
    window_s: Annotated[float, Field(gt=0)]
    hop_s: Annotated[float, Field(gt=0)]
    held_out: Annotated[float, Field(gt=0, lt=1)]  # fraction of train speakers held out to choose the checkpoint
    windows_per_speaker: Annotated[int, Field(ge=2)]  # windows of one speaker in a batch, of different sounds
    time_shifted_negatives: Annotated[int, Field(ge=0)]  # time-shifted negatives of each window
    min_shift_s: Annotated[float, Field(gt=0)]  # smallest time shift of a negative
    scale_augmentation: Annotated[float, Field(ge=1)]  # largest factor of the random scaling of motion, up or down
    temperature: Annotated[float, Field(gt=0)]  # initial temperature of InfoNCE; it is learned
    network: CriticNetworkSettings
    loop: LoopSettings
    encoder: EncoderSettings  # encoder for the Frechet distance; trained on the same speakers as the critics
    bootstrap: BootstrapSettings


# Maximum number of clips in a score over pairs of clips.
MAX_SCORED_CLIPS = 300
TIME_SHIFTS_ONLY = (
    "trained with time shifts as the only negatives, as no train speaker has two sounds: this Corr. measures whether "
    "motion is in time with the sound, not whether it fits this sound rather than another"
)


@dataclass(frozen=True)
class SpeakerSplit:
    """Indices of the recordings of training speakers and of held-out speakers."""

    train: list[int]
    held_out: list[int]


def split_speakers(recordings: Sequence[Recording], settings: CriticSettings) -> SpeakerSplit:
    """Split the speakers at random into training and held-out. Raises InputError if there are fewer than two."""
    speaker_of = [recording.clip.speaker for recording in recordings]
    speakers = sorted(set(speaker_of))
    if len(speakers) < 2:
        raise InputError(f"critic: should have train clips of at least two speakers, got {len(speakers)}")
    count = min(len(speakers) - 1, max(1, round(settings.held_out * len(speakers))))
    out = set(np.random.default_rng(settings.seed).choice(speakers, size=count, replace=False).tolist())
    train = [index for index, speaker in enumerate(speaker_of) if speaker not in out]
    return SpeakerSplit(train, [index for index, speaker in enumerate(speaker_of) if speaker in out])


@dataclass(frozen=True)
class WindowBatch:
    """Speech features and motion angles of B windows, and which pairs share a speaker but not a sound."""

    speech_features: Float[Tensor, "B T H"]
    angles: Float[Tensor, "B T A"]
    negatives: Bool[ndarray, "B B"]

    def to(self, device: torch.device) -> WindowBatch:
        """Copy of the batch on a device."""
        return WindowBatch(self.speech_features.to(device), self.angles.to(device), self.negatives)


def first_windows(recordings: Sequence[Recording], part: str, channels: Int[ndarray, " H"], frames: int) -> WindowBatch:
    """First window of up to MAX_SCORED_CLIPS recordings, evenly spaced; shorter recordings only if all are shorter."""
    chosen = [
        recordings[int(index)] for index in np.linspace(0, len(recordings) - 1, min(MAX_SCORED_CLIPS, len(recordings)))
    ]
    whole = [recording for recording in chosen if len(recording) >= frames] or chosen
    return cut_windows(whole, part, channels, frames, [0] * len(whole))


def cut_windows(
    recordings: Sequence[Recording], part: str, channels: Int[ndarray, " H"], frames: int, starts: Sequence[int]
) -> WindowBatch:
    """Cut one window of each recording, all to the length of the shortest."""
    frames = min(frames, *(len(recording) - start for recording, start in zip(recordings, starts, strict=True)))
    cuts = [slice(start, start + frames) for start in starts]
    pairs = list(zip(recordings, cuts, strict=True))
    motion = np.stack([part_angles(part, recording.head[cut], recording.gaze[cut]) for recording, cut in pairs])
    speech_features = np.stack([recording.speech[cut][:, channels] for recording, cut in pairs])
    speakers = np.array([recording.clip.speaker for recording in recordings])
    sounds = np.array([recording.clip.sound for recording in recordings])
    return WindowBatch(
        torch.from_numpy(speech_features.astype(np.float32)),
        torch.from_numpy(motion.astype(np.float32)),
        (speakers[:, None] == speakers) & (sounds[:, None] != sounds),
    )


@dataclass(frozen=True)
class ChannelSelection:
    """Channels of the speech embedding that a critic uses: their indices, means and standard deviations."""

    index: Int[ndarray, " H"]
    mean: Float[ndarray, " H"]
    std: Float[ndarray, " H"]

    @classmethod
    def of(cls, embedding: Mapping[str, Any], channels: Sequence[str]) -> ChannelSelection:
        """Select channels by name from embedding.json. Raises InputError for an unknown channel."""
        names = list(embedding["channels"])
        missing = [name for name in channels if name not in names]
        if missing:
            raise InputError(f"critic.channels: should be channels of the embedding, got {', '.join(missing)}")
        index = np.array([names.index(name) for name in channels])
        mean, std = (np.asarray(embedding[key], np.float32)[index] for key in ("mean", "std"))
        return cls(index, mean, np.maximum(std, np.float32(1e-6)))


def new_critic(
    part: str, recordings: Sequence[Recording], channel_selection: ChannelSelection, settings: CriticSettings
) -> Critic:
    """An untrained critic. All angles of a part share one scale, so that a nearly still channel is not amplified."""
    deviations, speeds = [], []
    for recording in recordings:
        motion = part_angles(part, recording.head, recording.gaze)
        deviations.append(np.square(motion - np.median(motion, axis=0)).mean())
        speeds.append(np.linalg.norm(np.diff(motion, axis=0), axis=-1).mean())
    motion_scale = torch.tensor([float(np.sqrt(np.mean(deviations))), float(np.mean(speeds))]).clamp_min(1e-6)
    index, mean, std = (
        torch.from_numpy(each) for each in (channel_selection.index, channel_selection.mean, channel_selection.std)
    )
    torch.manual_seed(settings.seed)
    critic = Critic(settings.network, index, mean, std, motion_scale, len(MIRROR_SIGNS[part]))
    critic.log_scale.data.fill_(-np.log(settings.temperature))
    return critic


@dataclass(frozen=True)
class TrainedCritic:
    """A trained critic as a metric, its stored configuration, its history and the recordings of held-out speakers.

    `caveat`: a limit to state with its scores; empty if there is none.
    """

    corr: CriticCorrelation
    config: dict[str, Any]
    history: list[dict[str, float]]
    held_out: list[Recording]
    caveat: str


def train_critic(
    part: str,
    recordings: Sequence[Recording],
    channel_selection: ChannelSelection,
    settings: CriticSettings,
    context: ExecutionContext = CPU_CONTEXT,
    resume: ResumeFile | None = None,
) -> TrainedCritic:
    """Train the critic of one part; `resume` continues an interrupted training."""
    split = split_speakers(recordings, settings)
    fps = recordings[0].clip.fps
    critic = new_critic(part, [recordings[index] for index in split.train], channel_selection, settings)
    task = ContrastiveTask(part, critic, recordings, split, fps, settings)
    history = train(task, settings.loop, f"critic of {part}", context=context, resume=resume)
    frames, hop = round(settings.window_s * fps), max(1, round(settings.hop_s * fps))
    config = {"part": part, "frames": frames, "hop": hop, **settings.model_dump(mode="json", exclude={"encoder"})}
    held_out = [recordings[index] for index in split.held_out]
    caveat = TIME_SHIFTS_ONLY if task.time_shifts_only else ""
    return TrainedCritic(CriticCorrelation(part, critic, frames, hop), config, history, held_out, caveat)


class ContrastiveTask:
    """InfoNCE training task; a batch holds windows of a few speakers with several sounds each."""

    def __init__(
        self,
        part: str,
        critic: Critic,
        recordings: Sequence[Recording],
        split: SpeakerSplit,
        fps: float,
        settings: CriticSettings,
    ) -> None:
        self.part, self.settings, self.recordings = part, settings, recordings
        self.channels = critic.speech_channels.numpy()
        self.frames = round(settings.window_s * fps)
        self.shift_min = round(settings.min_shift_s * fps / settings.network.step_frames)
        self.rng = np.random.default_rng([settings.seed, CRITIC_PARTS.index(part)])
        self.critic = critic
        self.module: nn.Module = critic
        self.clips_by_speaker: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
        for index in split.train:
            clip = recordings[index].clip
            self.clips_by_speaker[clip.speaker][clip.sound].append(index)
        several = sorted(name for name, sounds in self.clips_by_speaker.items() if len(sounds) > 1)
        self.time_shifts_only = not several
        if self.time_shifts_only and not settings.time_shifted_negatives:
            raise InputError(
                "critic.time_shifted_negatives: should be above 0 where no train speaker has two sounds, got 0"
            )
        self.speakers = several or sorted(self.clips_by_speaker)
        self.held_out_windows = first_windows(
            [recordings[index] for index in split.held_out], part, self.channels, self.frames
        )

    def losses(self, step: int) -> dict[str, Tensor]:
        """InfoNCE in both directions; the negatives include time shifts of the right motion."""
        batch = self._sample_batch().to(self.critic.log_scale.device)
        speech, motion = self.critic.speech(batch.speech_features), self.critic.motion(batch.angles)
        logit_scale = self.critic.log_scale.exp().clamp_max(100.0)
        allowed = torch.from_numpy(batch.negatives | np.eye(len(speech), dtype=bool)).to(speech.device)
        between = (logit_scale * similarity(speech, motion)).masked_fill(~allowed, -torch.inf)
        wrong = self._time_shift_similarity(speech, motion) * logit_scale
        right = torch.arange(len(speech), device=speech.device)
        by_sound = functional.cross_entropy(torch.cat([between, wrong], dim=1), right)
        by_motion = functional.cross_entropy(torch.cat([between.T, wrong], dim=1), right)
        return {"total": (by_sound + by_motion) / 2}

    def validate(self) -> dict[str, float]:
        """AUC on held-out speakers.

        `validation_score` uses negatives of the same speaker, or time shifts if there are none; `auc_all` all pairs.
        """
        held_out_windows = self.held_out_windows.to(self.critic.log_scale.device)
        speech, motion = (
            self.critic.speech(held_out_windows.speech_features),
            self.critic.motion(held_out_windows.angles),
        )
        similar = similarity(speech, motion).cpu().numpy()
        right, others = np.diag(similar), similar[~np.eye(len(similar), dtype=bool)]
        if self.held_out_windows.negatives.any():
            score = auc(right, similar[self.held_out_windows.negatives])
        else:
            steps, least = motion.shape[1], self._min_shift(motion.shape[1])
            score = auc(
                right, _shifted_similarity(speech, motion, range(least, steps - least + 1)).cpu().numpy().ravel()
            )
        return {"validation_score": score, **({"auc_all": auc(right, others)} if len(others) else {})}

    def _sample_batch(self) -> WindowBatch:
        chosen: list[int] = []
        for name in self.rng.permutation(self.speakers):
            sounds = self.clips_by_speaker[name]
            names = self.rng.permutation(sorted(sounds))[: self.settings.windows_per_speaker]
            chosen += [int(self.rng.choice(sounds[sound])) for sound in names]
            if len(chosen) >= self.settings.loop.batch:
                break
        recordings = [self.recordings[index] for index in chosen]
        starts = [int(self.rng.integers(max(1, len(each) - self.frames + 1))) for each in recordings]
        batch = cut_windows(recordings, self.part, self.channels, self.frames, starts)
        mirror = np.where(self.rng.random((len(chosen), 1)) < 0.5, MIRROR_SIGNS[self.part], 1.0)
        bound = np.log(self.settings.scale_augmentation)
        gain = mirror * np.exp(self.rng.uniform(-bound, bound, (len(chosen), 1)))
        return WindowBatch(
            batch.speech_features, batch.angles * torch.from_numpy(gain[:, None].astype(np.float32)), batch.negatives
        )

    def _time_shift_similarity(
        self, speech: Float[Tensor, "B N F"], motion: Float[Tensor, "B N F"]
    ) -> Float[Tensor, "B W"]:
        """Cosines with motion features rolled in time by random shifts, W to a window."""
        steps, least = motion.shape[1], self._min_shift(motion.shape[1])
        shifts = self.rng.integers(least, steps - least + 1, size=self.settings.time_shifted_negatives)
        return _shifted_similarity(speech, motion, shifts.tolist())

    def _min_shift(self, steps: int) -> int:
        """Smallest time shift in steps of the network; half a window if the window is too short for it."""
        return min(self.shift_min, steps // 2)


def _shifted_similarity(
    speech: Float[Tensor, "B N F"], motion: Float[Tensor, "B N F"], shifts: Iterable[int]
) -> Float[Tensor, "B W"]:
    columns = [functional.cosine_similarity(speech.flatten(1), motion.roll(shift, 1).flatten(1)) for shift in shifts]
    return torch.stack(columns, dim=1) if columns else speech.new_zeros(len(speech), 0)


def auc(positives: Float[ndarray, " P"], negatives: Float[ndarray, " N"]) -> float:
    """Area under the ROC curve: probability that a positive scores above a negative; ties count half."""
    ordered = np.sort(negatives)
    below, not_above = (np.searchsorted(ordered, positives, side=side) for side in ("left", "right"))
    return float((below + not_above).mean() / 2 / len(ordered))


class CriticCorrelation:
    """Corr. of one part, computed with a frozen critic."""

    def __init__(self, part: str, critic: Critic, frames: int, hop: int) -> None:
        """Use windows of `frames` frames, one every `hop` frames."""
        self.part, self.critic, self.frames, self.hop = part, critic.eval(), frames, hop

    @classmethod
    def load(cls, folder: Path, part: str) -> CriticCorrelation:
        """Load the critic of a part from the output folder of the stage `critic`."""
        checkpoint = load(folder / part)
        tensors, config = checkpoint.tensors, checkpoint.config
        critic = Critic(
            validate_section("critic.network", CriticNetworkSettings, config["network"]),
            tensors["speech_channels"],
            tensors["speech_mean"],
            tensors["speech_std"],
            tensors["motion_scale"],
            len(MIRROR_SIGNS[part]),
        )
        critic.load_state_dict(tensors)
        return cls(part, critic, int(config["frames"]), int(config["hop"]))

    def __call__(
        self, speech: Float[ndarray, "T C"], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, " S"]:
        """Corr. of each sample, as the mean over windows; a clip shorter than a window is one window."""
        return np.asarray(self.score_sounds([speech], head, gaze)[0])

    @torch.no_grad()
    def score_sounds(
        self, sounds: Sequence[Float[ndarray, "_ C"]], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, "N S"]:
        """Corr. of each sample under each of several sounds, over the frames that sound and motion share.

        The features of a motion window are computed once for all sounds.
        """
        motion = torch.from_numpy(part_angles(self.part, head, gaze).astype(np.float32))
        motion_features: dict[tuple[int, int], Tensor] = {}
        found = []
        for sound in sounds:
            speech_features = torch.from_numpy(sound[:, self.critic.speech_channels.numpy()].astype(np.float32))
            frames = min(len(sound), motion.shape[1])
            values = []
            for start in range(0, max(0, frames - self.frames) + 1, self.hop):
                stop = min(start + self.frames, frames)
                if (start, stop) not in motion_features:
                    motion_features[start, stop] = self.critic.motion(motion[:, start:stop]).flatten(1)
                window_features = self.critic.speech(speech_features[None, start:stop]).flatten(1)
                values.append(torch.cosine_similarity(window_features, motion_features[start, stop]).numpy())
            found.append(np.mean(values, axis=0))
        return np.asarray(found)


@dataclass(frozen=True)
class CriticScores:
    """Scores over a group of clips; None where they need two sounds of a speaker and no speaker has two.

    `corr_minus_shuffled` is `corr_truth` minus `corr_shuffled`, over the same clips.
    """

    auc_same_speaker: Estimate | None
    auc_all: Estimate | None
    corr_truth: Estimate
    corr_shuffled: Estimate | None
    corr_constant: Estimate
    corr_minus_shuffled: Estimate | None


@torch.no_grad()
def score_critic(corr: CriticCorrelation, recordings: Sequence[Recording], settings: BootstrapSettings) -> CriticScores:
    """Score a critic on the first windows of recordings; "truth" is fitted motion, as in the training of the critic."""
    group = first_windows(recordings, corr.part, corr.critic.speech_channels.numpy(), corr.frames)
    speech = corr.critic.speech(group.speech_features)
    similar = similarity(speech, corr.critic.motion(group.angles)).numpy().astype(np.float64)
    still = similarity(speech, corr.critic.motion(torch.zeros_like(group.angles[:1]))).numpy()[:, 0].astype(np.float64)
    right, count = np.diag(similar).copy(), len(similar)
    others = [similar[row, np.arange(count) != row] for row in range(count)]
    negatives = [similar[row, group.negatives[row]] for row in range(count)]
    paired = np.flatnonzero(group.negatives.any(axis=1))
    shuffled = np.array([negatives[row].mean() for row in paired])
    same = [negatives[row] for row in paired]
    return CriticScores(
        auc_same_speaker=bootstrap(_auc(right[paired], same), len(paired), settings) if len(paired) else None,
        auc_all=bootstrap(_auc(right, others), count, settings) if count > 1 else None,
        corr_truth=bootstrap(mean_statistic(right), count, settings),
        corr_shuffled=bootstrap(mean_statistic(shuffled), len(paired), settings) if len(paired) else None,
        corr_constant=bootstrap(mean_statistic(still), count, settings),
        corr_minus_shuffled=bootstrap(mean_statistic(right[paired] - shuffled), len(paired), settings)
        if len(paired)
        else None,
    )


def _auc(right: Float[ndarray, " N"], wrong: Sequence[Float[ndarray, " _"]]) -> Statistic:
    def statistic(clips: Int[ndarray, " N"]) -> float:
        return auc(right[clips], np.concatenate([wrong[clip] for clip in clips]))

    return statistic
