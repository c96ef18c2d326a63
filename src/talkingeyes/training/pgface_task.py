"""Training of PGFace on the fitted faces of the train split, with head-dependent sag (head/sag.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor

from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.poses import PoseSettings, head_rotations, read_poses, resample_linear
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.corpus.store import shard_path
from talkingeyes.head.sag import FaceSurface
from talkingeyes.models.pgface import PGFace, PGFaceNetworkSettings
from talkingeyes.training.checkpoint import Checkpoint, build_network
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.pose_windows import PoseWindowSampler, cut_windows, pose_scale

BASIS_FRAMES = 800  # approximate number of frames for the shape basis


class PGFaceTaskSettings(Settings):
    """Settings of the model and of its training."""

    kind: Literal["pgface"]
    parts: tuple[Literal["shape"], ...]
    tokenizer: None
    poses: PoseSettings
    network: PGFaceNetworkSettings
    loop: LoopSettings
    # Number of windows of a validation.
    validation_windows: Annotated[int, Field(gt=0)]


@dataclass(frozen=True)
class ShapeRecording:
    """One clip at the frame rate of poses: speech embedding, absolute poses, and the motion of the face."""

    speech: Float[ndarray, "T C"]
    pose: Float[ndarray, "T 6"]
    motion: Motion

    def __len__(self) -> int:
        return len(self.pose)


def read_shape_recording(fit: Path, embed: Path, clip: Clip, settings: PoseSettings) -> ShapeRecording:
    """Read a fitted clip; its face is linearly resampled."""
    found = read_poses(fit, embed, clip, settings)
    fitted = Motion.load(shard_path(fit / "motion", clip.id, ".npz"))
    frames = len(found)
    pose = found.pose + found.centre
    expression, jaw = (
        resample_linear(each, fitted.fps, settings.fps)[:frames] for each in (fitted.expression, fitted.jaw)
    )
    motion = Motion.of(
        settings.fps,
        head_rotations(pose),
        np.zeros((frames, 2, 3)),
        jaw=jaw,
        expression=expression,
        expression_names=fitted.expression_names,
        head_model=fitted.head_model,
    )
    return ShapeRecording(found.speech, pose.astype(np.float32), motion)


class PGFaceTask:
    """Windows of 16 frames and the same windows one frame later."""

    def __init__(
        self,
        settings: PGFaceTaskSettings,
        seed: int,
        train: Sequence[ShapeRecording],
        val: Sequence[ShapeRecording],
        normaliser: Normaliser,
        surface: FaceSurface,
    ) -> None:
        torch.manual_seed(seed)
        self.settings, self.surface, self.train = settings, surface, train
        self.module = PGFace(settings.network, normaliser.channels, len(surface.vertices))
        self.module.speech.standardise_by(torch.from_numpy(normaliser.mean), torch.from_numpy(normaliser.std))
        self.module.pose_scale.copy_(torch.from_numpy(pose_scale(train)))
        self._learn_basis()
        self.windows = PoseWindowSampler(train, settings.network.window + 1, hop=1, seed=seed)
        self.rng = self.windows.rng
        self.of_train = [self._coefficients(each) for each in train]
        self.validation_windows = self._validation_windows(val)

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 8 on a batch."""
        cuts = self.windows.sample(self.settings.loop.batch)
        window, output_frame, device = (
            self.settings.network.window,
            self.settings.network.output_frame - 1,
            self.module.mean.device,
        )
        generated, generated_next = (
            self.module(*(each.to(device) for each in cut_windows(self.train, cuts, window, shift))) for shift in (0, 1)
        )
        true, true_next = (
            torch.stack([self.of_train[index][start + output_frame + shift] for index, start in cuts]).to(device)
            for shift in (0, 1)
        )
        return self.module.loss_terms(generated, true, generated_next, true_next)

    def validate(self) -> dict[str, float]:
        """Mean vertex distance from the fitted faces on val; the score is its negative."""
        speech, pose, vertices = (each.to(self.module.mean.device) for each in self.validation_windows)
        distance_mm = (self.module.shapes(self.module(speech, pose)) - vertices).norm(dim=-1) * 1000
        lower = torch.from_numpy(self.surface.lower)
        still = (self.module.mean - vertices).norm(dim=-1) * 1000
        return {
            "validation_score": -float(distance_mm.mean()),
            "vertex_error_mm": float(distance_mm.mean()),
            "lower_face_error_mm": float(distance_mm[:, lower].mean()),
            "mean_shape_error_mm": float(still.mean()),
        }

    def _learn_basis(self) -> None:
        """Set the basis to the principal components of training shapes, each scaled by its standard deviation."""
        every = max(1, sum(map(len, self.train)) // BASIS_FRAMES)
        shapes = self.surface.shapes(np.concatenate([self._factors(each)[::every] for each in self.train]))
        mean = shapes.mean(0)
        flat = (shapes - mean).reshape(len(shapes), -1)
        count = self.settings.network.coefficients
        _, size, directions = np.linalg.svd(flat, full_matrices=False)
        basis = np.zeros((count, flat.shape[1]))
        kept = min(count, len(size))
        basis[:kept] = directions[:kept] * (size[:kept] / np.sqrt(len(flat)))[:, None]
        self.module.set_basis(
            torch.from_numpy(mean).float(),
            torch.from_numpy(basis.reshape(count, *mean.shape)).float(),
            torch.from_numpy(self.surface.lower),
        )

    def _factors(self, recording: ShapeRecording) -> Float[ndarray, "T K"]:
        return self.surface.factors(recording.motion, recording.motion.head)

    def _coefficients(self, recording: ShapeRecording) -> Float[Tensor, "T K"]:
        """True shapes projected onto the basis. Shapes and coefficients are linear in the factors."""
        flat = self.module.basis.flatten(1).double()
        to_coefficients = flat.T / flat.square().sum(1).clamp(min=1e-15)
        rest = torch.from_numpy(self.surface.model.template[self.surface.vertices]).double() - self.module.mean
        directions = torch.from_numpy(self.surface.directions).flatten(1) @ to_coefficients
        factors = torch.from_numpy(self._factors(recording))
        return (rest.flatten() @ to_coefficients + factors @ directions).float()

    def _validation_windows(self, val: Sequence[ShapeRecording]) -> tuple[Tensor, ...]:
        """Evenly spread windows of val, with the true vertices of the output frames."""
        window, output_frame = self.settings.network.window, self.settings.network.output_frame - 1
        each_clip = max(1, self.settings.validation_windows // len(val))
        cuts = [
            (index, int(start))
            for index, each in enumerate(val)
            for start in np.linspace(0, len(each) - window - 1, each_clip)
        ]
        factors = [self._factors(each) for each in val]
        vertices = self.surface.shapes(np.stack([factors[index][start + output_frame] for index, start in cuts]))
        return (*cut_windows(val, cuts, window), torch.from_numpy(vertices).float())


def pgface_config(settings: PGFaceTaskSettings, normaliser: Normaliser, surface: FaceSurface) -> dict[str, Any]:
    """The configuration that rebuilds the network."""
    return {
        "model": settings.model_dump(mode="json"),
        "channels": list(normaliser.channels),
        "vertices": len(surface.vertices),
    }


def pgface_network(checkpoint: Checkpoint) -> PGFace:
    """Load the network of a checkpoint."""
    settings = validate_section("model", PGFaceTaskSettings, checkpoint.config["model"])
    return build_network(
        lambda: PGFace(settings.network, checkpoint.config["channels"], checkpoint.config["vertices"]),
        checkpoint.tensors,
    )
