"""Animate speech with a trained model: sample head, gaze and face, then run the animation pipeline on each sample.

The sequence of steps is in `animation/pipeline.py`. The face has a model of its own (`animation/face.py`).
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.animation import Animation
from talkingeyes.animation.context import AnimationContext, sample_seeds
from talkingeyes.animation.controls import NEUTRAL_FACE, Controls
from talkingeyes.animation.conversation_states import resolve_states, with_states
from talkingeyes.animation.face import FaceAnimator
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.inference.loading import load_motion_generator
from talkingeyes.animation.inference.motion import NumpyMotionGenerator
from talkingeyes.animation.model_file import open_with_face
from talkingeyes.animation.pipeline import animate_sample
from talkingeyes.audio.annotation import Span
from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.audio.turn_taking import detect_turns
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.fitting.motion_style import SPEAKERS_FILE, MotionStyle, load_speakers
from talkingeyes.models.condition.emotion_strength import emotion_strengths
from talkingeyes.models.condition.random_speaker import random_speaker
from talkingeyes.models.face.style import blend_over_time
from talkingeyes.physiology import blinks
from talkingeyes.physiology.blinks import BlinkProfile

if TYPE_CHECKING:
    from talkingeyes.training.motion_generators import TrainedGenerator

SPEAKER_SEED = 5  # stream of the random training speaker
DEFAULT_CONTROLS = Controls()


@dataclass(frozen=True)
class Animator:
    """A trained model with its speech encoder, and a face model. Without one (never of `load`) the face is at rest."""

    encoder: SpeechEncoder
    generator: NumpyMotionGenerator | TrainedGenerator
    fps: float
    # By name: physiological, paper, and corpus (of the corpus that the model was trained on).
    blink_profiles: Mapping[str, BlinkProfile] = field(default_factory=lambda: blinks.PROFILES)
    # By name: the motion statistics of the training speakers.
    speaker_styles: Mapping[str, MotionStyle] = field(default_factory=dict)
    face: FaceAnimator | None = None

    @classmethod
    def load(cls, model: Path) -> Animator:
        """Load a folder of the train stage or a packed file, with its face (`model_file.face_source`).

        Raises InputError if it is missing or damaged.
        """
        with open_with_face(model) as (folder, face):
            return cls._of_folders(folder, face)

    @classmethod
    def _of_folders(cls, model: Path, face: Path) -> Animator:
        with reading(model, "trained model; `make repro` trains one"):
            generator = load_motion_generator(model)
            embedding = read_json(model / "embedding.json", "JSON file")
            settings = validate_section("embed", EmbedSettings, embedding["settings"])
            encoder = make_encoder(settings)
            seen = read_json(model / "blinks.json", "JSON file")["speakers"]
            profile = BlinkProfile("lognormal", math.exp(seen["log_normal"]["mean"]), seen["log_normal"]["sd"])
            speakers = load_speakers(model / SPEAKERS_FILE)
            # A corpus without any blink has no profile.
            own = {"corpus": profile} if seen["count"] > seen["without_blinks"] else {}
            fps, profiles = float(embedding["fps"]), blinks.PROFILES | own
        return cls(encoder, generator, fps, profiles, speakers, FaceAnimator.load(face, settings, encoder))

    @property
    def persons(self) -> tuple[str, ...]:
        """The speakers that the model can be conditioned on; none if it is unconditional."""
        if isinstance(self.generator, NumpyMotionGenerator):
            return self.generator.speakers
        from talkingeyes.training.motion_generators import training_speakers

        return training_speakers(self.generator)

    def perform(
        self,
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        fps: float,
        controls: Controls = DEFAULT_CONTROLS,
    ) -> list[Animation]:
        """Animate 16 kHz speech `samples` times; sample i of a seed does not depend on the number of samples.

        Raises InputError for a blink profile, a person or a style that the model does not have.
        """
        self._check(controls)
        embedding = self.encoder(sound, self.fps)
        return self._generate_all(embedding, sound, samples, seed, fps, controls)

    def generate_from_embedding(
        self,
        embedding: Float[ndarray, "T C"],
        samples: int,
        seed: int,
        fps: float,
        controls: Controls = DEFAULT_CONTROLS,
        sound: Float[ndarray, " N"] | None = None,
    ) -> list[Animation]:
        """Animate speech that is already embedded.

        Without the sound, the times of speech are unknown: blinks do not depend on phrases, and a partner, states and a
        face model with another encoder are refused.
        """
        self._check(controls)
        for name, control in (("partner", controls.partner), ("states", controls.states)):
            if control is not None and sound is None:
                raise InputError(f"{name}: should come with the sound of the speech itself, got embedded speech")
        return self._generate_all(embedding, np.zeros(0) if sound is None else sound, samples, seed, fps, controls)

    def _check(self, controls: Controls) -> None:
        if controls.blinks not in self.blink_profiles:
            raise InputError(f"blinks: should be one of {', '.join(self.blink_profiles)}, got {controls.blinks}")
        if isinstance(controls.style, str) and controls.style not in self.speaker_styles:
            known = _listed(self.speaker_styles) or "a measured one (the model keeps no speakers)"
            raise InputError(f"style: should be one of {known}, got {controls.style}")
        if controls.person is not None and self._person(controls, 0) is None:
            known = "left out: the model is not conditioned on the speaker"
            if self.persons:
                known = f"{_listed(self.persons)} or a number"
            raise InputError(f"person: should be one of {known}, got {controls.person}")
        if self.face:
            self.face.check(controls.face)
        elif controls.face != NEUTRAL_FACE:
            raise InputError(
                "emotion and speaker: should be left out without a face model (probtalk3d), got one of them"
            )

    def _generate_all(
        self,
        embedding: Float[ndarray, "T C"],
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        fps: float,
        controls: Controls,
    ) -> list[Animation]:
        person = self._person(controls, seed)
        context = self._context(sound, controls, person, seed)
        sampled = self._sample_motion(embedding, sound, sample_seeds(seed, samples), person, controls)
        faces = self._faces(embedding, sound, samples, seed, controls)
        trajectories = [
            GazeTrajectory.from_frames(self.fps, head, rotation.gaze_in_space(head, gaze))
            for head, gaze in zip(sampled.head, sampled.gaze, strict=True)
        ]
        return [
            animate_sample(trajectory, faces, index, fps, context.for_sample(index))
            for index, trajectory in enumerate(trajectories)
        ]

    def _context(
        self, sound: Float[ndarray, " N"], controls: Controls, person: str | None, seed: int
    ) -> AnimationContext:
        """The context of all samples; `sound` is empty if it is not known."""
        style = controls.style
        partner = np.zeros(0) if controls.partner is None else controls.partner
        turns = detect_turns(sound, partner) if len(sound) else None
        states: tuple[Span, ...] = ()
        if turns is not None and controls.states is not None:
            states = resolve_states(controls.states, turns, len(sound) / SAMPLE_RATE)
            turns = with_states(turns, states)
        return AnimationContext(
            controls,
            seeds=(seed,),
            blink_profile=self.blink_profiles[controls.blinks],
            motion_style=self.speaker_styles[style] if isinstance(style, str) else style,
            blink_rate_rank=self._blink_rate_rank(person),
            turns=turns,
            states=states,
        )

    def _person(self, controls: Controls, seed: int) -> str | None:
        """The speaker of all samples: of the controls (person, else style), else a random training speaker.

        A number as person is a seed of its own, so that the person stays over sounds and seeds. None if the model has
        no speakers, or not this one.
        """
        if not self.persons:
            return None
        name = controls.style if controls.person is None else controls.person
        if name in self.persons:
            return str(name)
        if controls.person is not None:
            if not controls.person.isdecimal():
                return None
            seed = int(controls.person)
        return self.persons[random_speaker(self.persons, [seed, SPEAKER_SEED])]

    def _blink_rate_rank(self, person: str | None) -> float | None:
        """The fraction of training speakers who blink less often than a person, who counts half."""
        if person is None or person not in self.speaker_styles:
            return None
        rates, own = (
            [each.blinks_per_min for each in self.speaker_styles.values()],
            self.speaker_styles[person].blinks_per_min,
        )
        return float(np.mean([0.5 * (rate <= own) + 0.5 * (rate < own) for rate in rates]))

    def _sample_motion(
        self,
        embedding: Float[ndarray, "T C"],
        sound: Float[ndarray, " N"],
        seeds: list[int],
        person: str | None,
        controls: Controls,
    ) -> Samples:
        """Sample head and gaze, conditioned on speaker, emotion and waveform where the model requires them."""
        index = None if person is None else self.persons.index(person)
        emotion = blend_over_time(controls.face, np.arange(len(embedding)) / self.fps, emotion_strengths)
        if isinstance(self.generator, NumpyMotionGenerator):
            return self.generator.generate(embedding, seeds, self.fps, index, emotion)
        from talkingeyes.animation.torch_generation import sample_motion

        return sample_motion(self.generator, embedding, sound, seeds, self.fps, index, emotion)

    def _faces(
        self,
        embedding: Float[ndarray, "T C"],
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        controls: Controls,
    ) -> FaceSamples | None:
        """Samples of the face; None where the controls replace the face or switch it off (or without a face model)."""
        if self.face is None or not controls.parts.is_generated("face"):
            return None
        if self.face.encoder is not self.encoder or self.face.fps != self.fps:
            if not len(sound):
                raise InputError("face: should come with the sound of the speech itself, got embedded speech")
            embedding = self.face.encoder(sound, self.face.fps)
        return self.face.perform(embedding, controls.face, seed, samples)


def _listed(names: Iterable[str]) -> str:
    """Names for one line of an error, where a model may have hundreds of speakers."""
    return textwrap.shorten(", ".join(names), 100, placeholder=" ...")
