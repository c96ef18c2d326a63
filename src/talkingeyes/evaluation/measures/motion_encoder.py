"""Features of windows of motion from a frozen network, for Frechet distance, MMD, precision and coverage.

The encoder is trained on fitted motion of the train split only, never on the output of a model, and is the same for all
rows of a table: a network trained on a generator rewards that generator's faults. The stage `critic` trains it and
chooses the checkpoint on held-out speakers. Reads and writes data/critic/encoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.corpus.recordings import Recording
from talkingeyes.models.motion_autoencoder import MotionAutoencoder, MotionAutoencoderSettings, window_features
from talkingeyes.training.checkpoint import load
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.loop import train as fit

CHECKPOINT_NAME = "encoder"


class EncoderSettings(Settings):
    """The subsection `encoder` of the section `critic`."""

    window_s: Annotated[float, Field(ge=2, le=4)]
    hop_s: Annotated[float, Field(gt=0)]  # between the starts of consecutive windows of a clip
    network: MotionAutoencoderSettings
    loop: LoopSettings


class MotionEncoder:
    """The frozen network, which maps the windows of a clip to features."""

    def __init__(self, network: MotionAutoencoder, settings: EncoderSettings, fps: float) -> None:
        self.network, self.settings, self.fps = network.eval(), settings, fps

    @property
    def config(self) -> dict[str, Any]:
        """Configuration stored with the weights."""
        return {"fps": self.fps, **self.settings.model_dump(mode="json")}

    @classmethod
    def load(cls, folder: Path) -> MotionEncoder:
        """Load the encoder from the output folder of the stage `critic`."""
        checkpoint = load(folder / CHECKPOINT_NAME)
        fps = float(checkpoint.config["fps"])
        stored = {k: v for k, v in checkpoint.config.items() if k != "fps"}
        settings = validate_section("critic.encoder", EncoderSettings, stored)
        tensors = checkpoint.tensors
        network = MotionAutoencoder(settings.network, step_count(settings, fps), tensors["mean"], tensors["std"])
        network.load_state_dict(tensors)
        return cls(network, settings, fps)

    @torch.no_grad()
    def __call__(
        self, head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"], fps: float
    ) -> Float[ndarray, "W D"]:
        """Features of all windows of S samples, sample by sample; empty if the motion is shorter than a window.

        Motion at a higher frame rate is subsampled. Raises InputError if the rate is not a multiple of the encoder's.
        """
        every = round(fps / self.fps)
        if every < 1 or abs(fps - every * self.fps) > 1e-6 * fps:
            raise InputError(f"encoder: frame rate of motion should be a multiple of {self.fps:g} fps, got {fps:g}")
        frames, hop = round(self.settings.window_s * self.fps), round(self.settings.hop_s * self.fps)
        cut = [sliding_windows(each[:, ::every], frames, hop) for each in (head, gaze)]
        if not len(cut[0]):
            return np.zeros((0, self.network.feature_count))
        steps = window_features(cut[0], cut[1], self.fps, self.settings.network.step_frames)
        return self.network.features(torch.from_numpy(steps.astype(np.float32))).numpy().astype(np.float64)


@dataclass(frozen=True)
class TrainedEncoder:
    """A trained encoder and the history of its training."""

    encoder: MotionEncoder
    history: list[dict[str, float]]


def sliding_windows(samples: Float[ndarray, "S T *C"], frames: int, hop: int) -> Float[ndarray, "W F *C"]:
    """Sliding windows of all samples, ordered by sample."""
    starts = np.arange(0, samples.shape[1] - frames + 1, max(1, hop))
    cut = samples[:, starts[:, None] + np.arange(frames)]
    return np.asarray(cut.reshape(-1, frames, *samples.shape[2:]))


def step_count(settings: EncoderSettings, fps: float) -> int:
    """Network steps per window."""
    return round(settings.window_s * fps) // settings.network.step_frames


def fit_motion_encoder(
    train: Sequence[Recording], held_out: Sequence[Recording], settings: EncoderSettings, seed: int
) -> TrainedEncoder:
    """Train the encoder; the checkpoint is chosen on the held-out recordings."""
    task = AutoencoderTask(train, held_out, settings, seed)
    history = fit(task, settings.loop, CHECKPOINT_NAME)
    with torch.no_grad():
        task.network.fit_error_statistics(task.known)
    return TrainedEncoder(MotionEncoder(task.network, settings, task.fps), history)


class AutoencoderTask:
    """Autoencoding task: reconstruct random windows of the training speakers from their latent code."""

    def __init__(
        self, train: Sequence[Recording], held_out: Sequence[Recording], settings: EncoderSettings, seed: int
    ) -> None:
        self.settings, self.fps = settings, train[0].clip.fps
        self.frames = round(settings.window_s * self.fps)
        self.recordings = [each for each in train if len(each) >= self.frames]
        if not self.recordings:
            raise InputError(f"critic.encoder.window_s: should fit into a train clip, got {settings.window_s:g}")
        self.rng = np.random.default_rng([seed, 2])
        self.held = self._all(held_out)
        self.known = self._all(train)
        statistics = self.known.flatten(0, 1)
        torch.manual_seed(seed)
        self.network = MotionAutoencoder(
            settings.network,
            step_count(settings, self.fps),
            statistics.mean(dim=0),
            statistics.std(dim=0).clamp_min(1e-3),
        )
        self.module: nn.Module = self.network

    def losses(self, step: int) -> dict[str, Tensor]:
        """Mean squared error and KL divergence per input value."""
        chosen = self.rng.integers(len(self.recordings), size=self.settings.loop.batch)
        cut = [self._random_window(self.recordings[int(index)]) for index in chosen]
        steps = self._described(np.stack([head for head, _ in cut]), np.stack([gaze for _, gaze in cut]))
        steps = steps.to(self.network.mean.device)
        noise = self.rng.standard_normal((len(steps), self.settings.network.latent)).astype(np.float32)
        found = self.network(steps, torch.from_numpy(noise).to(steps.device))
        error = (found.steps - self.network.standardised(steps)).square().mean()
        divergence = found.divergence.mean() / steps[0].numel()
        return {"total": error + self.settings.network.kl_weight * divergence, "error": error, "divergence": divergence}

    def validate(self) -> dict[str, float]:
        """Fraction of the variance of held-out windows that the reconstruction explains."""
        held = self.held.to(self.network.mean.device)
        noise = held.new_zeros(len(held), self.settings.network.latent)
        target = self.network.standardised(held)
        explained = 1 - float((self.network(held, noise).steps - target).square().mean() / target.square().mean())
        return {"validation_score": explained, "explained_variance": explained}

    def _random_window(self, recording: Recording) -> tuple[Float[ndarray, "F 3"], Float[ndarray, "F 2 3"]]:
        start = int(self.rng.integers(len(recording) - self.frames + 1))
        return recording.head[start : start + self.frames], recording.gaze[start : start + self.frames]

    def _all(self, recordings: Sequence[Recording]) -> Float[Tensor, "W N C"]:
        hop = round(self.settings.hop_s * self.fps)
        cuts = [
            self._described(*(sliding_windows(part[None], self.frames, hop) for part in (each.head, each.gaze)))
            for each in recordings
        ]
        return torch.cat(cuts)

    def _described(self, head: Float[ndarray, "B F 3"], gaze: Float[ndarray, "B F 2 3"]) -> Float[Tensor, "B N C"]:
        steps = window_features(head.astype(float), gaze.astype(float), self.fps, self.settings.network.step_frames)
        return torch.from_numpy(steps.astype(np.float32))
