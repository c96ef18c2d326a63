"""A trained model of the head alone, from a folder of the train stage; its generator keeps the eyes straight ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.poses import head_rotations, resample_cubic, resample_linear
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.corpus.samples import Samples
from talkingeyes.models.condition.conditioner import NO_CONDITIONING, ConditioningInputs
from talkingeyes.models.speech_to_pose import SpeechToPose
from talkingeyes.training.checkpoint import Checkpoint, build_network
from talkingeyes.training.pose_task import PoseTaskSettings


@dataclass(frozen=True)
class PoseModelGenerator:
    """From speech embedding to S head motions around the mean pose of the train split."""

    network: SpeechToPose

    def generate(
        self,
        embedding: Float[ndarray, "T C"],
        seeds: list[int],
        fps: float,
        conditioning: ConditioningInputs = NO_CONDITIONING,
    ) -> Samples:
        """Sample heads of one speaker, at the frame rate of the embedding; the eyes look straight ahead."""
        own, style = self.network.settings.poses.fps, self.network.conditioning_style(conditioning)
        speech = resample_linear(embedding, fps, own).astype(np.float32)
        pose = self.network.sample(speech, seeds, style) + self.network.mean_pose.numpy()
        rows = [_pad_or_trim(resample_cubic(each.astype(np.float64), own, fps), len(embedding)) for each in pose]
        head = head_rotations(np.stack(rows))
        return Samples(fps, head, np.zeros((*head.shape[:2], 2, 3)))


def pose_config(settings: PoseTaskSettings, normaliser: Normaliser, network: SpeechToPose) -> dict[str, Any]:
    """The configuration that rebuilds a model of the head alone."""
    return {
        "model": settings.model_dump(mode="json"),
        "channels": list(normaliser.channels),
        "speakers": list(network.speakers),
    }


def pose_network(checkpoint: Checkpoint) -> SpeechToPose:
    """Load the network of a checkpoint."""
    config = checkpoint.config
    settings = validate_section("model", PoseTaskSettings, config["model"])
    return build_network(lambda: SpeechToPose(settings, config["channels"], config["speakers"]), checkpoint.tensors)


def _pad_or_trim(rows: Float[ndarray, "T C"], frames: int) -> Float[ndarray, "U C"]:
    """The first frames; the last row is repeated for frames lost in resampling."""
    return np.pad(rows[:frames], ((0, max(frames - len(rows), 0)), (0, 0)), mode="edge")
