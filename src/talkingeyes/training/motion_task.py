"""Joint training of speech to head and gaze (TalkingEyes section IV-D, eq. 8 to 15), monitored in free running."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.recordings import Normaliser, Recording
from talkingeyes.models.condition.conditioner import ConditioningInputs
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.equaliser import Equaliser
from talkingeyes.models.layers.schedules import set_trained_steps
from talkingeyes.models.speech_to_motion import SpeechInput, SpeechToMotion, SpeechToMotionSettings
from talkingeyes.training.checkpoint import Checkpoint
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.free_running import FreeRunningStatistics, free_running_statistics
from talkingeyes.training.initialisation import init_from
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.windows import WindowDataset, WindowSettings, motion_batch, motion_statistics

EQUALISER_CLIPS = 256  # maximum number of training clips for the fit of the equaliser


class TrainSettings(Settings):
    """Settings shared by all models of the train stage."""

    seed: int


class MotionTaskSettings(SpeechToMotionSettings):
    """Settings of a model and of its training."""

    # A trained model whose generators initialise this one; null: random initialisation.
    init_from: str | None
    windows: WindowSettings
    loop: LoopSettings
    # Number of val clips generated at each validation, in free running with the model's own head.
    validation_clips: int


class MotionTask:
    """Teacher-forced losses on windows; validation by free running."""

    def __init__(
        self,
        settings: MotionTaskSettings,
        seed: int,
        train: Sequence[Recording],
        val: Sequence[Recording],
        normaliser: Normaliser,
        codebook: GazeVQVAE | None,
        conditioning_paths: ConditioningPaths | None = None,
        start: Checkpoint | None = None,
    ) -> None:
        """`conditioning_paths`: paths of the conditioning inputs; `start`: the model named by `init_from`."""
        torch.manual_seed(seed)
        self.settings = settings
        # The first take of each val sound, up to the number of validation clips.
        self.validation_recordings = [each for each in val if each.clip.take == 0][: settings.validation_clips]
        # One pass over the recordings: each is read from its files.
        clips, heads, gazes = zip(*((each.clip, each.head, each.gaze) for each in train), strict=True)
        speakers = sorted({clip.speaker for clip in clips}) if settings.conditions else []
        self.module = SpeechToMotion(settings, normaliser.channels, codebook, speakers)
        self.conditioning_provider = ConditioningProvider(self.module.required_inputs, speakers, conditioning_paths)
        self.windows = WindowDataset(train, settings.windows, seed, partial(motion_batch, self.conditioning_provider))
        self.rng = self.windows.rng
        self.module.standardise_by(torch.from_numpy(normaliser.mean), torch.from_numpy(normaliser.std))
        self._normalise(np.concatenate(heads), np.concatenate(gazes))
        if start is not None:
            init_from(self.module, start)
        self.truth = free_running_statistics(
            [each.head for each in self.validation_recordings],
            [each.gaze for each in self.validation_recordings],
            self._fps,
        )

    @property
    def _fps(self) -> float:
        return self.validation_recordings[0].clip.fps

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 15 on a batch."""
        set_trained_steps(self.module, step - 1)
        return self.module.loss_terms(self.windows.sample_batch(self.settings.loop.batch, step))

    def validate(self) -> dict[str, float]:
        """Free running on the validation clips; the score is the negative distance to the statistics of the truth."""
        free_running = self._free_running_statistics(float(self.module.temperature))
        figures = {f"free_running/{name}": value for name, value in asdict(free_running).items()}
        return {"validation_score": -free_running.distance(self.truth), **figures}

    def truth_metrics(self) -> dict[str, float]:
        """The same statistics of the true validation clips."""
        return {f"ground_truth/{name}": value for name, value in asdict(self.truth).items()}

    def fit_equaliser(self) -> None:
        """Fit the head's equaliser, if it has one, to match the spectrum of sampled heads to that of the train
        split."""
        equaliser = getattr(self.module.head, "equaliser", None)
        if not isinstance(equaliser, Equaliser):
            return
        recordings = self.windows.recordings
        some = recordings[:: math.ceil(len(recordings) / EQUALISER_CLIPS)]
        equaliser.reset()
        sampled_heads = [
            self.module.generate_head(torch.from_numpy(np.array(each.speech)), [index], self._conditioning(each))[
                0
            ].numpy()
            for index, each in enumerate(some)
        ]
        equaliser.fit([each.head for each in some], sampled_heads)

    def choose_temperature(self) -> dict[str, float]:
        """Set the temperature whose free-running statistics on val are nearest to those of the truth."""
        distances = {
            each: self._free_running_statistics(each).distance(self.truth) for each in self.settings.temperatures
        }
        self.module.temperature.fill_(min(distances, key=lambda each: distances[each]))
        return {f"free_running_distance/{each:g}": distance for each, distance in distances.items()}

    def _free_running_statistics(self, temperature: float) -> FreeRunningStatistics:
        speeches = [
            SpeechInput(torch.from_numpy(np.array(each.speech)), [index], self._conditioning(each))
            for index, each in enumerate(self.validation_recordings)
        ]
        motions = self.module.generate_batch(speeches, temperature)
        return free_running_statistics(
            [each.head[0].cpu().numpy() for each in motions],
            [each.gaze[0].cpu().numpy() for each in motions],
            self._fps,
        )

    def _conditioning(self, recording: Recording) -> ConditioningInputs:
        return self.conditioning_provider.clip_inputs(recording.clip, len(recording))

    def _normalise(self, heads: Float[ndarray, "N 3"], gazes: Float[ndarray, "N 2 3"]) -> None:
        """Set the statistics of all training frames."""
        head, gaze = motion_statistics(heads), motion_statistics(gazes.reshape(-1, 6))
        self.module.head.normal.set(torch.from_numpy(head.mean), head.scale)
        self.module.gaze.normalise_by(torch.from_numpy(gaze.mean), gaze.scale)
