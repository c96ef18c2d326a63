"""Stage 1 of ProbTalk3D: self-supervised training of a motion autoencoder of the face (section 3.3.1, eq. 4; 3.4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.faces import FaceRecording
from talkingeyes.models.face.autoencoder import FACE_AUTOENCODERS, FaceAutoencoder, FaceAutoencoderComponentSettings
from talkingeyes.models.face.basis import JAW_DIM, FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.face.vqvae import FaceVQVAE
from talkingeyes.models.layers.quantiser import code_figures
from talkingeyes.training.checkpoint import load
from talkingeyes.training.face_windows import FaceStatistics, face_batch
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.windows import WindowDataset, WindowSettings

STATISTICS_WINDOWS = 64  # training windows, or whole clips, for the statistics of latents


class FaceTokenizerSettings(Settings):
    """Settings of a motion autoencoder and of its training. Weights are keyed by term of eq. 4."""

    kind: Literal["face"]
    seed: int
    network: FaceAutoencoderComponentSettings
    weights: dict[str, Annotated[float, Field(ge=0)]]
    windows: WindowSettings
    loop: LoopSettings


@dataclass(frozen=True)
class FaceReconstructionError:
    """Reconstruction error (root mean squares of expression weights and of the jaw in degrees) and code counts."""

    expression: float
    jaw_deg: float
    normalised_l1: float
    counts: Float[Tensor, " K"]

    def figures(self) -> dict[str, float]:
        """Metrics to report, with code usage for codebooks."""
        errors = {"expression_rmse": self.expression, "jaw_rmse_deg": self.jaw_deg}
        return errors | (code_figures(self.counts) if len(self.counts) else {})


class FaceTokenizerTask:
    """Self-reconstruction of fitted faces."""

    def __init__(
        self,
        settings: FaceTokenizerSettings,
        train: Sequence[FaceRecording],
        val: Sequence[FaceRecording],
        basis: FaceBasis,
    ) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.basis, self.train_faces, self.val_faces = settings, basis, train, val
        self.module: Any = FACE_AUTOENCODERS.build(settings.network, basis.numbers)
        vocabulary = StyleVocabulary.of(each.clip for each in train)
        self.windows = WindowDataset(train, settings.windows, settings.seed, partial(face_batch, basis, vocabulary))
        self.rng = self.windows.rng
        face_statistics = FaceStatistics.of(train)
        self.module.normalise_by(face_statistics.mean, face_statistics.scale)

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 4 on a batch."""
        face = self.windows.sample_batch(self.settings.loop.batch, step).face.to(self._device)
        loss_terms = self.module.loss_terms(face)
        return {"total": sum(weight * loss_terms[name] for name, weight in self.settings.weights.items()), **loss_terms}

    def validate(self) -> dict[str, float]:
        """Error on val clips without sampling; the validation score is its negative."""
        error = self.error(self.val_faces)
        return {"validation_score": -error.normalised_l1, **error.figures()}

    def finish(self) -> tuple[dict[str, float], Float[Tensor, " K"]]:
        """Fit the statistics of the latents. Returns metrics, and code counts over the train split."""
        self.fit_latent_statistics()
        error = self.error(self.train_faces)
        return error.figures(), error.counts

    def config(self) -> dict[str, Any]:
        """The configuration that rebuilds the autoencoder."""
        return face_tokenizer_config(self.settings.network, self.basis)

    @torch.no_grad()
    def fit_latent_statistics(self) -> None:
        """Fit the statistics of the latents to training faces, after the loop."""
        size = STATISTICS_WINDOWS if self.settings.windows.frames else 1  # whole clips differ in length
        self.module.fit_latent_statistics(
            [
                self.windows.sample_batch(size, step).face.to(self._device)
                for step in range(1, STATISTICS_WINDOWS // size + 1)
            ]
        )

    @torch.no_grad()
    def error(self, recordings: Sequence[FaceRecording]) -> FaceReconstructionError:
        """Reconstruction error over whole clips of a split."""
        sums, frames = np.zeros(3), 0
        codes = self.settings.network.quantiser.codes if isinstance(self.module, FaceVQVAE) else 0  # type: ignore[attr-defined]
        counts = torch.zeros(codes)
        for each in recordings:
            face = torch.from_numpy(self.basis.to_vector(each.expression, each.jaw))[None].to(self._device)
            latents = self.module.latents(face)
            unused_noise = self.module.noise([0], face.shape[1], 1)
            reconstructed = self.module.decode(self.module.sample_decoder_inputs(latents, unused_noise, 0.0))
            off, normal = (reconstructed - face).square(), self.module.normal(reconstructed) - self.module.normal(face)
            sums += [
                float(off[..., :-JAW_DIM].mean(-1).sum()),
                float(off[..., -JAW_DIM:].sum()),
                float(normal.abs().mean(-1).sum()),
            ]
            frames += face.shape[1]
            if codes:
                counts += torch.bincount(self.module.codes(latents, unused_noise, 0.0).flatten(), minlength=codes).cpu()
        expression, jaw, normal_error = sums / max(frames, 1)
        return FaceReconstructionError(math.sqrt(expression), math.degrees(math.sqrt(jaw)), float(normal_error), counts)

    @property
    def _device(self) -> torch.device:
        device: torch.device = self.module.encoder_decoder.normal.mean.device
        return device


@dataclass(frozen=True)
class FaceTokenizer:
    """A trained, frozen autoencoder and the head model of its faces."""

    settings: FaceAutoencoderComponentSettings
    network: FaceAutoencoder
    basis: FaceBasis

    def to_dict(self) -> dict[str, Any]:
        """The configuration that rebuilds it, without weights."""
        return face_tokenizer_config(self.settings, self.basis)


def face_tokenizer_config(settings: FaceAutoencoderComponentSettings, basis: FaceBasis) -> dict[str, Any]:
    """The configuration that rebuilds an autoencoder."""
    return {"network": settings.model_dump(mode="json"), "basis": basis.to_dict()}


def build_face_tokenizer(content: Any) -> FaceTokenizer:
    """Build a frozen autoencoder from its configuration, without weights. Raises KeyError, TypeError or ValueError."""
    settings, basis = FACE_AUTOENCODERS.parse(content["network"]), FaceBasis.of(content["basis"])
    autoencoder = FACE_AUTOENCODERS.build(settings, basis.numbers)  # type: ignore[arg-type]
    autoencoder.freeze()
    return FaceTokenizer(settings, autoencoder, basis)  # type: ignore[arg-type]


def load_face_tokenizer(folder: Path) -> FaceTokenizer:
    """Load an autoencoder from a folder of the pretrain stage. Raises InputError if it is missing or damaged."""
    checkpoint = load(folder)
    try:
        tokenizer = build_face_tokenizer(checkpoint.config)
        tokenizer.network.load_state_dict(checkpoint.tensors)
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise InputError(
            f"{folder}: not a motion autoencoder of the face ({error}); `make report` trains one"
        ) from None
    return tokenizer
