"""Training of a model of the head alone on windows of poses; PoseGAN adds a discriminator (Zhang et al., section 4).

The weights kept are those whose poses on val move most like true ones (`MovementRatios`). The paper keeps the "best
performing" weights without naming a criterion; a distance would select the stillest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.poses import PoseRecording
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.models.baselines import mean_and_std
from talkingeyes.models.head.discriminator import lagged_differences
from talkingeyes.models.head.pose_generator import RetrievingPoseGenerator
from talkingeyes.models.layers.schedules import set_trained_steps
from talkingeyes.models.speech_to_pose import START_POSES, PoseBatch, SpeechToPose, SpeechToPoseSettings
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.pose_windows import PoseWindowSampler, cut_windows, pose_scale


class PoseWindowSettings(Settings):
    """Training windows."""

    # Frames of a window and between the starts of two windows (the paper: 256 and 5).
    frames: Annotated[int, Field(gt=1)]
    hop: Annotated[int, Field(gt=0)]


class PoseTaskSettings(SpeechToPoseSettings):
    """Settings of a model of the head alone and of its training."""

    windows: PoseWindowSettings
    # null: no training.
    loop: LoopSettings | None
    # Number of val clips, of training speakers, generated at each validation.
    validation_clips: Annotated[int, Field(gt=0)]


@dataclass(frozen=True)
class MovementRatios:
    """Spread of pose, velocity and acceleration relative to the truth, as means over the six dimensions."""

    range: float
    speed: float
    acceleration: float

    def distance(self) -> float:
        """Distance from the truth (0 is best): the sum of absolute log ratios."""
        return sum(abs(math.log(max(each, 1e-3))) for each in asdict(self).values())


def movement_ratios(
    generated: Sequence[Float[ndarray, "T 6"]], true: Sequence[Float[ndarray, "T 6"]]
) -> MovementRatios:
    """Ratios over several clips together."""
    shares = []
    for order in range(3):
        ours, theirs = (np.concatenate([np.diff(each, order, axis=0) for each in poses]) for poses in (generated, true))
        shares.append(float((ours.std(0) / theirs.std(0).clip(1e-9)).mean()))
    return MovementRatios(*shares)


class PoseTask:
    """Windows of all training speakers; validation by free running over successive windows, as at inference."""

    def __init__(
        self,
        settings: PoseTaskSettings,
        seed: int,
        train: Sequence[PoseRecording],
        val: Sequence[PoseRecording],
        normaliser: Normaliser,
    ) -> None:
        torch.manual_seed(seed)
        self.settings, self.train = settings, train
        length = settings.windows.frames
        self.windows = PoseWindowSampler(train, length, settings.windows.hop, seed)
        self.rng = self.windows.rng
        if not self.windows.starts:
            raise InputError(
                f"windows.frames: should be at most the longest clip, got {length} at {settings.poses.fps:g} fps"
            )
        speakers = sorted({each.clip.speaker for each in train})
        self.validation_recordings = [each for each in val if each.clip.speaker in speakers][
            : settings.validation_clips
        ]
        self.module = SpeechToPose(settings, normaliser.channels, speakers)
        self.module.speech.standardise_by(torch.from_numpy(normaliser.mean), torch.from_numpy(normaliser.std))
        self._prepare()

    @property
    def discriminator(self) -> torch.nn.Module | None:
        """The discriminator, if there is one."""
        return self.module.discriminator

    def losses(self, step: int) -> dict[str, Tensor]:
        """Losses on a new batch, which is kept for the discriminator."""
        set_trained_steps(self.module, step - 1)
        self.batch = self._draw()
        predicted = self.module.predict(self.batch)
        self.generated = predicted.pose
        return predicted.loss_terms

    def discriminator_losses(self, step: int) -> dict[str, Tensor]:
        """Losses of the discriminator on the same batch."""
        return self.module.discriminator_terms(self.batch, self.generated)

    def validate(self) -> dict[str, float]:
        """Free running; the score is the negative distance to the movement of true heads."""
        generated = [
            self.module.sample(each.speech, [index], self.module.style_of(each.clip.speaker))[0]
            for index, each in enumerate(self.validation_recordings)
        ]
        ratios = movement_ratios(generated, [each.pose for each in self.validation_recordings])
        return {
            "validation_score": -ratios.distance(),
            **{f"free_running/{name}": value for name, value in asdict(ratios).items()},
        }

    def _draw(self) -> PoseBatch:
        assert self.settings.loop is not None
        starts = self.windows.sample(self.settings.loop.batch)
        speech, pose = cut_windows(self.train, starts, self.settings.windows.frames)
        style = np.stack([self.module.style_of(self.train[index].clip.speaker) for index, _ in starts])
        batch = (speech, pose, torch.from_numpy(style))
        return PoseBatch(*(each.to(self.module.scale.device) for each in batch))

    def _prepare(self) -> None:
        """Set statistics, start poses, and the training windows of the baselines."""
        scale = pose_scale(self.train)
        self.module.scale.copy_(torch.from_numpy(scale))
        self.module.mean_pose.copy_(torch.from_numpy(np.stack([each.centre for each in self.train]).mean(0)))
        if self.module.discriminator is not None:
            changes = [lagged_differences(torch.from_numpy(each.pose / scale)[None]) for each in self.train]
            deviations = [torch.cat([each[0] for each in of_lag]).std(0) for of_lag in zip(*changes, strict=True)]
            self.module.discriminator.scale.copy_(torch.stack(deviations))
        for index, speaker in enumerate(self.module.speakers):
            own = np.concatenate([each.pose for each in self.train if each.clip.speaker == speaker]) / scale
            spread = np.linspace(0, len(own) - 1, START_POSES).astype(int)
            self.module.start_poses[index] = torch.from_numpy(own[spread])
        if isinstance(self.module.head, RetrievingPoseGenerator):
            self.module.head.set_training_windows(*self._training_windows(scale))

    def _training_windows(self, scale: Float[ndarray, " 6"]) -> tuple[Float[Tensor, "N L 6"], Float[Tensor, "N D"]]:
        """Training windows with 50 % overlap, and the features of their speech."""
        length = self.settings.windows.frames
        sound, pose = [], []
        for each in self.train:
            for start in range(0, len(each) - length + 1, length // 2):
                part = self.module.speech.standardise(torch.from_numpy(each.speech[start : start + length])[None])[0]
                sound.append(torch.from_numpy(mean_and_std(part.numpy())))
                pose.append(torch.from_numpy(each.pose[start : start + length] / scale))
        return torch.stack(pose), torch.stack(sound)
