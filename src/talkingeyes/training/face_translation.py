"""Stage 2: speech and style to the face, for ProbTalk3D and all that it is compared with; watched on val."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from talkingeyes.corpus.faces import FaceRecording
from talkingeyes.corpus.windows import Normaliser
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.speech_to_face import SpeechToFace, SpeechToFaceSettings
from talkingeyes.training.face_priors import FacePrior
from talkingeyes.training.face_score import energy_score, speed_ratio
from talkingeyes.training.face_windows import FaceStatistics, FaceWindows
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.windows import WindowSettings

WATCHED_SAMPLES = 4


class FaceTranslationSettings(SpeechToFaceSettings):
    """A model and how it is trained."""

    windows: WindowSettings
    loop: LoopSettings
    # Val clips whose faces are generated at each validation.
    watched_clips: int


@dataclass(frozen=True)
class FaceData:
    """What a face is learned from: fitted faces of one head, their speech and its statistics."""

    train: Sequence[FaceRecording]
    val: Sequence[FaceRecording]
    basis: FaceBasis
    vocabulary: StyleVocabulary
    normaliser: Normaliser


class FaceTask:
    """Losses on windows; validation by free generation."""

    def __init__(self, settings: FaceTranslationSettings, seed: int, data: FaceData, prior: FacePrior | None) -> None:
        torch.manual_seed(seed)
        self.settings, self.data = settings, data
        self.windows = FaceWindows(data.train, data.basis, data.vocabulary, settings.windows, seed)
        self.random = self.windows.random
        # The first take of each val sound, as many as are watched.
        self.watched = [each for each in data.val if each.clip.take == 0][: settings.watched_clips]
        network = prior.network if prior else None
        channels, numbers = data.normaliser.channels, data.basis.numbers
        self.module = SpeechToFace(settings, channels, data.vocabulary, numbers, network)
        self.module.speech.standardise_by(torch.from_numpy(data.normaliser.mean), torch.from_numpy(data.normaliser.std))
        self._measured = FaceStatistics.of(data.train)
        self.module.face.normalise_by(self._measured.mean, self._measured.scale)
        self.module.bound_by(self._measured.lowest, self._measured.highest)

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 5 on a batch."""
        return self.module.terms(self.windows.draw(self.settings.loop.batch))

    def validate(self) -> dict[str, float]:
        """The energy score of faces of the watched clips; the score is its negative."""
        return self._figures(float(self.module.temperature))

    def choose_temperature(self) -> dict[str, float]:
        """Take the temperature of the least energy score on val."""
        found = {each: -self._figures(each)["score"] for each in self.settings.temperatures}
        self.module.temperature.fill_(min(found, key=lambda each: found[each]))
        return {f"energy_score_at/{each:g}": score for each, score in found.items()}

    def _figures(self, temperature: float) -> dict[str, float]:
        mean, scale = self._measured.mean.numpy(), self._measured.scale.numpy()
        scores, ratios = [], []
        for index, each in enumerate(self.watched):
            seeds = [index * WATCHED_SAMPLES + sample for sample in range(WATCHED_SAMPLES)]
            style = self.data.vocabulary.vector(self.data.vocabulary.style_of(each.clip))
            speech = torch.from_numpy(np.array(each.speech))
            drawn = self.module.generate(speech, torch.from_numpy(style[None]), seeds, temperature).cpu().numpy()
            true = (self.data.basis.joined(each.expression, each.jaw) - mean) / scale
            scores.append(energy_score((drawn - mean) / scale, true))
            ratios.append(speed_ratio((drawn - mean) / scale, true))
        return {"score": -float(np.mean(scores)), "alive/face_speed_ratio": float(np.mean(ratios))}
