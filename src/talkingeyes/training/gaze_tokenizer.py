"""Pretraining of a gaze codebook (TalkingEyes section IV-C, eq. 7)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.recordings import Recording
from talkingeyes.models.gaze.categorical import stay_mask
from talkingeyes.models.gaze.gaze_signal import to_signal, to_signal_tensor
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.models.layers import distributed
from talkingeyes.models.layers.quantiser import code_figures, perplexity
from talkingeyes.models.losses import as_norm
from talkingeyes.training.conditioning import WITHOUT_CONDITIONING
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.windows import WindowDataset, WindowSettings, motion_batch, motion_statistics


class GazeTokenizerSettings(Settings):
    """Settings of a codebook and of its training."""

    kind: Literal["gaze"]
    seed: int
    network: GazeVQVAESettings
    windows: WindowSettings
    loop: LoopSettings


@dataclass(frozen=True)
class CodeUsage:
    """Counts of codes over all windows of a split, the reconstruction error, and the fraction of stays."""

    counts: Float[Tensor, " K"]
    error_deg: float
    stay_fraction: float

    def figures(self) -> dict[str, float]:
        """Number and fraction of used codes, perplexity, fraction of stays, reconstruction error."""
        errors = {"stay_fraction": self.stay_fraction, "reconstruction_error_deg": self.error_deg}
        return code_figures(self.counts) | errors


class GazeTokenizerTask:
    """Self-reconstruction of true gaze through the codebook."""

    def __init__(self, settings: GazeTokenizerSettings, train: Sequence[Recording], val: Sequence[Recording]) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.train_recordings, self.val_recordings = settings, train, val
        self.module = GazeVQVAE(settings.network)
        self.windows = WindowDataset(
            train, settings.windows, settings.seed, partial(motion_batch, WITHOUT_CONDITIONING)
        )
        self.rng = self.windows.rng
        frames = np.concatenate([to_signal(settings.network.signal, each.head, each.gaze) for each in train])
        measured = motion_statistics(frames)
        self.module.normalise_by(torch.from_numpy(measured.mean), measured.scale)

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 7 on a batch; a codebook of moving averages minimises the codebook term itself."""
        batch = self.windows.sample_batch(self.settings.loop.batch, step)
        signal = self._whole(to_signal_tensor(self.settings.network.signal, batch.head, batch.gaze))
        stay = stay_mask(self.module, signal)
        reconstruction = self.module(signal, stay)
        moving = ~stay.repeat_interleave(self.settings.network.frames_per_code, dim=1)[..., None]
        error = (reconstruction.signal - signal) / self.module.scale * self.module.loss_scale * moving
        mean_error = error.square().sum() / (
            distributed.all_reduce_mean(moving.sum().float()).clamp(min=1) * signal.shape[-1]
        )
        network, codes = self.settings.network, reconstruction.quantised
        fitted = as_norm(mean_error, signal, network.norm)
        commitment = as_norm(codes.commitment, codes.values, network.norm)
        codebook_error = as_norm(codes.codebook_error, codes.values, network.norm)
        return {
            "total": fitted + codebook_error + network.quantiser.commitment * commitment,
            "reconstruction": fitted,
            "commitment": commitment,
        }

    def validate(self) -> dict[str, float]:
        """Error on val clips; the validation score is its negative."""
        code_usage = self.code_usage(self.val_recordings)
        return {
            "validation_score": -code_usage.error_deg,
            "reconstruction_error_deg": code_usage.error_deg,
            "perplexity": perplexity(code_usage.counts),
        }

    def finish(self) -> tuple[dict[str, float], Float[Tensor, " K"]]:
        """Metrics of the trained codebook, and code counts over the train split."""
        code_usage = self.code_usage(self.train_recordings)
        of_val = {"val_reconstruction_error_deg": self.code_usage(self.val_recordings).error_deg}
        return code_usage.figures() | of_val, code_usage.counts

    def config(self) -> dict[str, Any]:
        """The configuration that rebuilds the codebook."""
        return self.settings.network.model_dump(mode="json")

    @torch.no_grad()
    def code_usage(self, recordings: Sequence[Recording]) -> CodeUsage:
        """Code usage over whole clips of a split."""
        counts = torch.zeros(self.settings.network.quantiser.codes)
        squares, numbers, stay_fraction, patches = 0.0, 0, 0, 0
        for recording in recordings:
            signal = self._whole(
                torch.from_numpy(to_signal(self.settings.network.signal, recording.head, recording.gaze))[None]
            )
            stay = stay_mask(self.module, signal)
            quantised = self.module.quantiser(self.module.encode(signal))
            counts += torch.bincount(quantised.indices[~stay].flatten(), minlength=len(counts)).cpu()
            squares += float((self.module.render(quantised.values, stay) - signal).square().sum())
            numbers += signal.numel() // signal.shape[-1]
            stay_fraction, patches = stay_fraction + int(stay.sum()), patches + stay.numel()
        # The squares of both eyes are summed, so half of the sum is that of one eye.
        return CodeUsage(
            counts, math.degrees(math.sqrt(squares / 2 / max(numbers, 1))), stay_fraction / max(patches, 1)
        )

    def _whole(self, signal: Float[Tensor, "B T F"]) -> Float[Tensor, "B U F"]:
        """Trim to whole patches and move to the device of the network."""
        patch = self.settings.network.frames_per_code
        return signal[:, : signal.shape[1] // patch * patch].to(self.module.mean.device)
