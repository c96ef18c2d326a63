"""Joint training of speech to head and gaze (TalkingEyes section IV-D, eq. 8 to 15), watched in free running."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import torch
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.windows import Normaliser, Recording
from talkingeyes.models.condition.conditioner import NOTHING, Given, Seen
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.equaliser import Equaliser
from talkingeyes.models.layers.pace import tell_steps
from talkingeyes.models.speech_to_motion import SpeechToMotion, SpeechToMotionSettings
from talkingeyes.training.aliveness import Aliveness, aliveness
from talkingeyes.training.checkpoint import Checkpoint
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.start import start_from
from talkingeyes.training.telling import Beside, Teller, motion_numbers
from talkingeyes.training.windows import Windows, WindowSettings, statistics

ENOUGH_TO_EQUALISE = 256  # clips


class TrainSettings(Settings):
    """What all models of the train stage share."""

    seed: int


class TranslationSettings(SpeechToMotionSettings):
    """A model and how it is trained."""

    # A trained model whose generators this one starts with; null: from random weights.
    start_from: str | None
    windows: WindowSettings
    loop: LoopSettings
    # Val clips that are generated, freely and with the model's own head, at each validation.
    watched_clips: int


class TranslationTask:
    """Teacher-forced losses on windows; validation by free running."""

    def __init__(
        self,
        settings: TranslationSettings,
        seed: int,
        train: Sequence[Recording],
        val: Sequence[Recording],
        normaliser: Normaliser,
        codebook: GazeVQVAE | None,
        beside: Beside | None = None,
        start: Checkpoint | None = None,
    ) -> None:
        """`beside`: where that lies which a model is told; `start`: the model that `start_from` names."""
        torch.manual_seed(seed)
        self.settings = settings
        # The first take of each val sound, as many as are watched.
        self.watched = [each for each in val if each.clip.take == 0][: settings.watched_clips]
        speakers = sorted({each.clip.speaker for each in train}) if settings.conditions else []
        self.module = SpeechToMotion(settings, normaliser.channels, codebook, speakers)
        needs = self.module.needs
        self.teller = Teller(needs, speakers, train, beside) if needs else None
        self.windows = Windows(train, settings.windows, seed, self.teller)
        self.random = self.windows.random
        motions = [torch.from_numpy(motion_numbers(each.head, each.gaze)) for each in train if "reference" in needs]
        self.module.learn_from(Seen(torch.from_numpy(normaliser.mean), torch.from_numpy(normaliser.std), motions))
        self._normalise(train)
        if start is not None:
            start_from(self.module, start)
        self.truth = aliveness([each.head for each in self.watched], [each.gaze for each in self.watched], self._fps)

    @property
    def _fps(self) -> float:
        return self.watched[0].clip.fps

    def losses(self, step: int) -> dict[str, Tensor]:
        """Eq. 15 on a batch."""
        tell_steps(self.module, step - 1)
        return self.module.terms(self.windows.draw(self.settings.loop.batch))

    def validate(self) -> dict[str, float]:
        """Free running on the watched clips; the score is minus the distance from the truth's aliveness."""
        alive = self._alive(float(self.module.temperature))
        figures = {f"alive/{name}": value for name, value in asdict(alive).items()}
        return {"score": -alive.distance(self.truth), **figures}

    def truth_figures(self) -> dict[str, float]:
        """The same figures of the watched clips themselves."""
        return {f"truth/{name}": value for name, value in asdict(self.truth).items()}

    def equalise(self) -> None:
        """Give heads drawn for the train split the spectrum of its own, if this head has a filter for it."""
        equaliser = getattr(self.module.head, "equaliser", None)
        if not isinstance(equaliser, Equaliser):
            return
        recordings = self.windows.recordings
        some = recordings[:: math.ceil(len(recordings) / ENOUGH_TO_EQUALISE)]
        equaliser.reset()
        drawn = [
            self.module.turn(torch.from_numpy(np.array(each.speech)), [index], self._told(each))[0].numpy()
            for index, each in enumerate(some)
        ]
        equaliser.match([each.head for each in some], drawn)

    def choose_temperature(self) -> dict[str, float]:
        """Take the temperature whose free-running motion on val is nearest to the truth's aliveness."""
        distances = {each: self._alive(each).distance(self.truth) for each in self.settings.temperatures}
        self.module.temperature.fill_(min(distances, key=lambda each: distances[each]))
        return {f"distance_at/{each:g}": distance for each, distance in distances.items()}

    def _alive(self, temperature: float) -> Aliveness:
        motions = []
        for index, each in enumerate(self.watched):
            speech = torch.from_numpy(np.array(each.speech))
            motions.append(self.module.generate(speech, [index], temperature, self._told(each)))
        return aliveness(
            [each.head[0].cpu().numpy() for each in motions],
            [each.gaze[0].cpu().numpy() for each in motions],
            self._fps,
        )

    def _told(self, recording: Recording) -> Given:
        return self.teller.whole(recording.clip, len(recording)) if self.teller else NOTHING

    def _normalise(self, train: Sequence[Recording]) -> None:
        head = statistics(np.concatenate([each.head for each in train]))
        self.module.head.normal.set(torch.from_numpy(head.mean), head.scale)
        gaze = statistics(np.concatenate([each.gaze.reshape(-1, 6) for each in train]))
        self.module.gaze.normalise_by(torch.from_numpy(gaze.mean), gaze.scale)
