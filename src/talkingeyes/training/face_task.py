"""Stage 2: from speech and style to the face, for ProbTalk3D and the models it is compared with; monitored on val."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.core.energy_score import energy_score
from talkingeyes.corpus.faces import FaceRecording
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.speech_to_face import SpeechToFace, SpeechToFaceSettings
from talkingeyes.training.face_tokenizer import FaceTokenizer
from talkingeyes.training.face_windows import FaceStatistics, face_batch
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.windows import WindowDataset, WindowSettings

VALIDATION_SAMPLES = 4


class FaceTaskSettings(SpeechToFaceSettings):
    """Settings of a model and of its training."""

    windows: WindowSettings
    loop: LoopSettings
    # Number of val clips for which faces are generated at each validation.
    validation_clips: int


@dataclass(frozen=True)
class FaceData:
    """Training data: fitted faces of one head model, with speech features and their statistics."""

    train: Sequence[FaceRecording]
    val: Sequence[FaceRecording]
    basis: FaceBasis
    vocabulary: StyleVocabulary
    normaliser: Normaliser


class FaceTask:
    """Losses on windows; validation on generated faces."""

    def __init__(self, settings: FaceTaskSettings, seed: int, data: FaceData, tokenizer: FaceTokenizer | None) -> None:
        torch.manual_seed(seed)
        self.settings, self.data = settings, data
        self.windows = WindowDataset(
            data.train, settings.windows, seed, partial(face_batch, data.basis, data.vocabulary)
        )
        self.rng = self.windows.rng
        # The first take of each val sound, up to the number of validation clips.
        self.validation_recordings = [each for each in data.val if each.clip.take == 0][: settings.validation_clips]
        network = tokenizer.network if tokenizer else None
        channels, numbers = data.normaliser.channels, data.basis.numbers
        self.module = SpeechToFace(settings, channels, data.vocabulary, numbers, network)
        self.module.speech.standardise_by(torch.from_numpy(data.normaliser.mean), torch.from_numpy(data.normaliser.std))
        self._face_statistics = FaceStatistics.of(data.train)
        self.module.face.normalise_by(self._face_statistics.mean, self._face_statistics.scale)
        self.module.set_range(self._face_statistics.min_face, self._face_statistics.max_face)

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 5 on a batch."""
        return self.module.loss_terms(self.windows.sample_batch(self.settings.loop.batch, step))

    def validate(self) -> dict[str, float]:
        """Energy score of faces of the validation clips; the validation score is its negative."""
        mean, scale = self._face_statistics.mean.numpy(), self._face_statistics.scale.numpy()
        scores, ratios = [], []
        for index, each in enumerate(self.validation_recordings):
            seeds = [index * VALIDATION_SAMPLES + sample for sample in range(VALIDATION_SAMPLES)]
            style = self.data.vocabulary.style_vector(self.data.vocabulary.style_of(each.clip))
            speech = torch.from_numpy(np.array(each.speech))
            generated = self.module.generate(speech, torch.from_numpy(style[None]), seeds).cpu().numpy()
            true = (self.data.basis.to_vector(each.expression, each.jaw) - mean) / scale
            scores.append(float(energy_score((generated - mean) / scale, true).mean()))
            ratios.append(speed_ratio((generated - mean) / scale, true))
        return {"validation_score": -float(np.mean(scores)), "free_running/face_speed_ratio": float(np.mean(ratios))}


def speed_ratio(samples: Float[ndarray, "S T F"], true: Float[ndarray, "T F"]) -> float:
    """Mean change per frame of samples relative to the truth: 0 is frozen, above 1 jitters."""
    change = np.linalg.norm(np.diff(true, axis=0), axis=-1).mean()
    return float(np.linalg.norm(np.diff(samples, axis=1), axis=-1).mean() / max(change, 1e-9))
