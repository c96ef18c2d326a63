"""Training of PGFace on the fitted faces of the train split, hanging as the head is held (head/sag.py)."""

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
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.poses import PoseSettings, head_of, linearly_resampled, read_poses
from talkingeyes.corpus.store import sharded
from talkingeyes.corpus.windows import Normaliser
from talkingeyes.head.sag import FaceSurface
from talkingeyes.models.pgface import PGFace, PGFaceNetworkSettings
from talkingeyes.training.checkpoint import Checkpoint
from talkingeyes.training.loop import LoopSettings

BASIS_FRAMES = 800  # that the basis of shapes is made of
STILL = 1e-6  # a number of the pose that varies by less stays as it is


class PGFaceSettings(Settings):
    """The model and how it is trained."""

    kind: Literal["pgface"]
    parts: tuple[Literal["shape"], ...]
    prior: None
    poses: PoseSettings
    network: PGFaceNetworkSettings
    loop: LoopSettings
    # Windows that a validation looks at.
    watched: Annotated[int, Field(gt=0)]


@dataclass(frozen=True)
class ShapeRecording:
    """One clip at the frame rate of poses: speech embedding, poses as the head is held, and the face's motion."""

    speech: Float[ndarray, "T C"]
    pose: Float[ndarray, "T 6"]
    motion: Motion

    def __len__(self) -> int:
        return len(self.pose)


def read_shapes(fit: Path, embed: Path, clip: Clip, settings: PoseSettings) -> ShapeRecording:
    """A fitted clip; its face is resampled by straight lines."""
    found = read_poses(fit, embed, clip, settings)
    fitted = Motion.load(sharded(fit / "motion", clip.id, ".npz"))
    frames = len(found)
    pose = found.pose + found.centre
    expression, jaw = (
        linearly_resampled(each, fitted.fps, settings.fps)[:frames] for each in (fitted.expression, fitted.jaw)
    )
    motion = Motion.of(
        settings.fps,
        head_of(pose),
        np.zeros((frames, 2, 3)),
        jaw=jaw,
        expression=expression,
        expression_names=fitted.expression_names,
        head_model=fitted.head_model,
    )
    return ShapeRecording(found.speech, pose.astype(np.float32), motion)


class PGFaceTask:
    """Windows of 16 frames and those one frame later."""

    def __init__(
        self,
        settings: PGFaceSettings,
        seed: int,
        train: Sequence[ShapeRecording],
        val: Sequence[ShapeRecording],
        normaliser: Normaliser,
        surface: FaceSurface,
    ) -> None:
        torch.manual_seed(seed)
        self.settings, self.surface, self.train = settings, surface, train
        self.random = np.random.default_rng(seed)
        self.module = PGFace(settings.network, normaliser.channels, len(surface.vertices))
        self.module.speech.standardise_by(torch.from_numpy(normaliser.mean), torch.from_numpy(normaliser.std))
        deviation = np.concatenate([each.pose for each in train]).std(0)
        self.module.pose_scale.copy_(torch.from_numpy(np.where(deviation > STILL, deviation, 1.0)))
        self._learn_basis()
        self.places = [
            (index, start) for index, each in enumerate(train) for start in range(len(each) - settings.network.window)
        ]
        self.of_train = [self._coefficients(each) for each in train]
        self.watched = self._watched(val)

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 8 on a batch."""
        chosen = self.random.integers(len(self.places), size=self.settings.loop.batch)
        cuts = [self.places[int(each)] for each in chosen]
        window, told, device = self.settings.network.window, self.settings.network.told - 1, self.module.mean.device
        made, made_next = (
            self.module(*(each.to(device) for each in windows(self.train, cuts, window, later))) for later in (0, 1)
        )
        true, true_next = (
            torch.stack([self.of_train[index][start + told + later] for index, start in cuts]).to(device)
            for later in (0, 1)
        )
        return self.module.terms(made, true, made_next, true_next)

    def validate(self) -> dict[str, float]:
        """Mean distance of vertices from the fitted ones on val; the score is its negative."""
        speech, pose, vertices = (each.to(self.module.mean.device) for each in self.watched)
        apart = (self.module.shapes(self.module(speech, pose)) - vertices).norm(dim=-1) * 1000
        lower = torch.from_numpy(self.surface.lower)
        still = (self.module.mean - vertices).norm(dim=-1) * 1000
        return {
            "score": -float(apart.mean()),
            "mm": float(apart.mean()),
            "mm_lower_face": float(apart[:, lower].mean()),
            "mm_mean_shape": float(still.mean()),
        }

    def _learn_basis(self) -> None:
        """Principal components of training shapes, each times its deviation."""
        every = max(1, sum(map(len, self.train)) // BASIS_FRAMES)
        shapes = self.surface.shapes(np.concatenate([self._factors(each)[::every] for each in self.train]))
        mean = shapes.mean(0)
        flat = (shapes - mean).reshape(len(shapes), -1)
        count = self.settings.network.coefficients
        _, size, directions = np.linalg.svd(flat, full_matrices=False)
        basis = np.zeros((count, flat.shape[1]))
        kept = min(count, len(size))
        basis[:kept] = directions[:kept] * (size[:kept] / np.sqrt(len(flat)))[:, None]
        self.module.learn_basis(
            torch.from_numpy(mean).float(),
            torch.from_numpy(basis.reshape(count, *mean.shape)).float(),
            torch.from_numpy(self.surface.lower),
        )

    def _factors(self, recording: ShapeRecording) -> Float[ndarray, "T K"]:
        return self.surface.factors(recording.motion, recording.motion.head)

    def _coefficients(self, recording: ShapeRecording) -> Float[Tensor, "T K"]:
        """True shapes in the basis; what the basis lacks is left out. Both are linear in the factors."""
        flat = self.module.basis.flatten(1).double()
        to_coefficients = flat.T / flat.square().sum(1).clamp(min=1e-15)
        rest = torch.from_numpy(self.surface.model.template[self.surface.vertices]).double() - self.module.mean
        directions = torch.from_numpy(self.surface.directions).flatten(1) @ to_coefficients
        factors = torch.from_numpy(self._factors(recording))
        return (rest.flatten() @ to_coefficients + factors @ directions).float()

    def _watched(self, val: Sequence[ShapeRecording]) -> tuple[Tensor, ...]:
        """Windows of val, evenly spread, with the vertices of the frames that are told."""
        window, told = self.settings.network.window, self.settings.network.told - 1
        each_clip = max(1, self.settings.watched // len(val))
        cuts = [
            (index, int(start))
            for index, each in enumerate(val)
            for start in np.linspace(0, len(each) - window - 1, each_clip)
        ]
        factors = [self._factors(each) for each in val]
        vertices = self.surface.shapes(np.stack([factors[index][start + told] for index, start in cuts]))
        return (*windows(val, cuts, window, 0), torch.from_numpy(vertices).float())


def windows(
    recordings: Sequence[ShapeRecording], cuts: Sequence[tuple[int, int]], window: int, later: int
) -> tuple[Float[Tensor, "B W C"], Float[Tensor, "B W 6"]]:
    """Speech and poses of windows, `later` frames after where they are cut."""
    parts = [(recordings[index], slice(start + later, start + later + window)) for index, start in cuts]
    return (
        torch.from_numpy(np.stack([each.speech[part] for each, part in parts])),
        torch.from_numpy(np.stack([each.pose[part] for each, part in parts])),
    )


def pgface_config(settings: PGFaceSettings, normaliser: Normaliser, surface: FaceSurface) -> dict[str, Any]:
    """What the network is rebuilt from."""
    return {
        "model": settings.model_dump(mode="json"),
        "channels": list(normaliser.channels),
        "vertices": len(surface.vertices),
    }


def pgface_network(checkpoint: Checkpoint) -> PGFace:
    """The network of a checkpoint."""
    settings = PGFaceSettings.model_validate(checkpoint.config["model"])
    network = PGFace(settings.network, checkpoint.config["channels"], checkpoint.config["vertices"])
    network.load_state_dict(checkpoint.tensors)
    return network.eval()
