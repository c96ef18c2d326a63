"""Speech becomes a performance: head and gaze, face, blinks from a profile, joined at any frame rate.

Blinks follow the paper (section IV-E): a rate drawn for the performance, or the person's in the profile, intervals from
it; gaze is held while the lids are shut, as in the paper's post-processing. The face has a model of its own (`face`);
without one it is neutral.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.control import (
    ResolvedControls,
    apply_controls,
    blinks_per_min,
    gaze_evoked_blinks,
    spontaneous_blinks,
)
from talkingeyes.animation.controls import NEUTRAL_FACE, Controls
from talkingeyes.animation.event_keys import save_keys
from talkingeyes.animation.face import FaceAnimator, find_face_model, with_face
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.listening import detect_turns, listening_behaviour
from talkingeyes.animation.model_file import open_model
from talkingeyes.animation.oculomotor import add_head_contribution
from talkingeyes.animation.part_overrides import override_events, override_motion
from talkingeyes.animation.saccade_resampling import resample
from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Events, Motion
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.fitting.motion_style import SPEAKERS_FILE, MotionStyle, load_speakers
from talkingeyes.models.condition.conditioner import ConditioningInputs
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.physiology.frame_saccades import find_saccades
from talkingeyes.training.conditioning import pad_or_trim, random_speaker
from talkingeyes.training.motion_generators import TrainedGenerator, load_generator, required_inputs, training_speakers

SHUT_CLOSURE = 0.5
SPEAKER_SEED = 5  # beside a seed: for who moves
DEFAULT_CONTROLS = Controls()


@dataclass(frozen=True)
class Animation:
    """A motion and the events it is made of."""

    motion: Motion
    events: Events

    def save(self, path: Path | str) -> None:
        """Write the motion (.npz), and its events beside it as keys for editing (NAME.events.json)."""
        path = Path(path)
        self.motion.save(path)
        save_keys(path.with_name(f"{path.stem}.events.json"), self.events, self.motion.fps)


@dataclass(frozen=True)
class Animator:
    """A trained model with the speech encoder that it was trained on."""

    encoder: SpeechEncoder
    generator: TrainedGenerator
    fps: float
    # By name: of the paper, of physiology, of the corpus that the model was trained on.
    blink_profiles: Mapping[str, BlinkProfile] = field(default_factory=lambda: blinks.PROFILES)
    # By name: the habits of the speakers that it was trained on.
    speaker_styles: Mapping[str, MotionStyle] = field(default_factory=dict)
    face: FaceAnimator | None = None

    @classmethod
    def load(cls, model: Path, face: Path | None = None) -> Animator:
        """From a folder of the train stage or a packed file. Raises InputError if it is missing or damaged.

        `face` is the folder of a model of the face; by default that which stands beside the model, if there is one.
        """
        with open_model(model) as folder:
            return cls._of_folder(folder, face or find_face_model(folder))

    @classmethod
    def _of_folder(cls, model: Path, face: Path | None) -> Animator:
        generator = load_generator(model)
        try:
            embedding = json.loads((model / "embedding.json").read_text())
            settings = EmbedSettings.model_validate(embedding["settings"])
            encoder = make_encoder(settings)
            seen = json.loads((model / "blinks.json").read_text())["speakers"]
            law = BlinkProfile("lognormal", math.exp(seen["log_normal"]["mean"]), seen["log_normal"]["sd"])
            speakers = load_speakers(model / SPEAKERS_FILE)
            # A corpus in which nobody blinks has no law of its own.
            own = {"corpus": law} if seen["count"] > seen["without_blinks"] else {}
            fps, profiles = float(embedding["fps"]), blinks.PROFILES | own
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{model}: not a trained model ({error}); `make repro` trains one") from None
        of_face = FaceAnimator.load(face, settings, encoder) if face else None
        return cls(encoder, generator, fps, profiles, speakers, of_face)

    @property
    def persons(self) -> tuple[str, ...]:
        """Whom the model can be told to move as."""
        return training_speakers(self.generator) if "speaker" in required_inputs(self.generator) else ()

    def perform(
        self,
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        fps: float,
        controls: Controls = DEFAULT_CONTROLS,
    ) -> list[Animation]:
        """`samples` performances of 16 kHz speech; sample i of a seed is the same however many are asked for.

        Raises InputError for a profile of blinks, a person or a style that the model does not have.
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
        """The same for speech that is embedded already.

        Without the sound nobody knows who speaks when: blinks do not heed phrases, and there can be no partner. There
        is no face either, where the model of the face has another encoder.
        """
        self._check(controls)
        if controls.partner is not None and sound is None:
            raise InputError("partner: should come with the sound of the speech itself, got embedded speech")
        return self._generate_all(embedding, np.zeros(0) if sound is None else sound, samples, seed, fps, controls)

    def _check(self, controls: Controls) -> None:
        if controls.blinks not in self.blink_profiles:
            raise InputError(f"blinks: should be one of {', '.join(self.blink_profiles)}, got {controls.blinks}")
        if isinstance(controls.style, str) and controls.style not in self.speaker_styles:
            known = ", ".join(self.speaker_styles) or "a measured one (the model keeps no speakers)"
            raise InputError(f"style: should be one of {known}, got {controls.style}")
        if controls.person is not None and controls.person not in self.persons:
            known = ", ".join(self.persons) or "asked of a model that is told who moves"
            raise InputError(f"person: should be one of {known}, got {controls.person}")
        if self.face:
            self.face.check(controls.face)
        elif controls.face != NEUTRAL_FACE:
            raise InputError("emotion and speaker: should be asked of a model of the face (probtalk3d), got none")

    def _generate_all(
        self,
        embedding: Float[ndarray, "T C"],
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        fps: float,
        controls: Controls,
    ) -> list[Animation]:
        style = controls.style
        motion_style = self.speaker_styles[style] if isinstance(style, str) else style
        person = self._person(controls, seed)
        sampled = self._sample_motion(embedding, sound, sample_seeds(seed, samples), person)
        faces = self._faces(embedding, sound, samples, seed, controls)
        rank = self._blink_rate_rank(person)
        own_speech = detect_turns(sound, np.zeros(0)) if len(sound) else None
        animations = []
        for index in range(samples):
            heard = None if controls.partner is None else listening_behaviour(sound, controls.partner, [seed, index, 3])
            one = self._generate_one(
                sampled, index, seed, fps, ResolvedControls(controls, motion_style, rank, heard, own_speech)
            )
            motion = with_face(one.motion, faces, index, controls.face) if faces else one.motion
            motion = override_motion(motion, controls.parts)
            animations.append(Animation(motion, override_events(one.events, motion, controls.parts)))
        return animations

    def _person(self, requested: Controls, seed: int) -> str | None:
        """Samples are takes of one person: who is asked for, by name or by style, or one whom the seed draws."""
        if not self.persons:
            return None
        for name in (requested.person, requested.style):
            if name in self.persons:
                return str(name)
        return self.persons[random_speaker(self.persons, [seed, SPEAKER_SEED])]

    def _blink_rate_rank(self, person: str | None) -> float | None:
        """The share of the speakers who blink less often than a person, who counts half."""
        if person is None or person not in self.speaker_styles:
            return None
        rates, own = (
            [each.blinks_per_min for each in self.speaker_styles.values()],
            self.speaker_styles[person].blinks_per_min,
        )
        return float(np.mean([0.5 * (rate <= own) + 0.5 * (rate < own) for rate in rates]))

    def _sample_motion(
        self, embedding: Float[ndarray, "T C"], sound: Float[ndarray, " N"], seeds: list[int], person: str | None
    ) -> Samples:
        """Head and gaze; a model is told who moves and given the waveform, if it asks for them."""
        conditioning, wanted = ConditioningInputs(), required_inputs(self.generator)
        if person is not None:
            conditioning = replace(conditioning, speaker=torch.tensor([self.persons.index(person)]))
        if "sound" in wanted:
            if not len(sound):
                raise InputError("speech.wave: a model that hears the waveform needs the sound, got embedded speech")
            heard = pad_or_trim(sound, round(len(embedding) * SAMPLE_RATE / self.fps))
            conditioning = replace(conditioning, sound=torch.from_numpy(heard)[None])
        return self.generator.generate(embedding, seeds, self.fps, conditioning)

    def _faces(
        self,
        embedding: Float[ndarray, "T C"],
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        requested: Controls,
    ) -> FaceSamples | None:
        """What the model of the face gives, if there is one and it is asked."""
        if self.face is None or not requested.parts.is_generated("face"):
            return None
        if self.face.encoder is not self.encoder:
            if not len(sound):
                return None
            embedding = self.face.encoder(sound, self.fps)
        return self.face.perform(embedding, requested.face, seed, samples, self.fps)

    def _generate_one(
        self, sampled: Samples, index: int, seed: int, fps: float, requested: ResolvedControls
    ) -> Animation:
        head, gaze = sampled.head[index], sampled.gaze[index]
        rng = np.random.default_rng([seed, index])
        space = rotation.gaze_in_space(head, gaze)
        if not requested.controls.no_postprocessing:
            head = add_head_contribution(self._model_trajectory(head, space)).head
        trajectory = self._trajectory(head, space, requested, [seed, index])
        blinked: tuple[Blink, ...] = ()
        if requested.controls.parts.is_generated("blinks"):
            profile = self.blink_profiles[requested.controls.blinks]
            rate = blinks_per_min(profile, requested, rng)
            evoked = gaze_evoked_blinks(profile, trajectory, rate, rng)
            spontaneous = spontaneous_blinks(profile, requested, trajectory.seconds, rate, evoked, rng)
            blinked = blinks.drop_overlapping(evoked, spontaneous)
            trajectory = self._trajectory(
                head, hold_over_blinks(spontaneous, space, self.fps), requested, [seed, index]
            )
        return render_trajectory(trajectory, blinked, fps)

    def _trajectory(
        self,
        head: Float[ndarray, "T 3"],
        gaze_in_space_rad: Float[ndarray, "T 2 2"],
        requested: ResolvedControls,
        seeds: Sequence[int],
    ) -> GazeTrajectory:
        return apply_controls(self._model_trajectory(head, gaze_in_space_rad), requested, seeds)

    def _model_trajectory(
        self, head: Float[ndarray, "T 3"], gaze_in_space_rad: Float[ndarray, "T 2 2"]
    ) -> GazeTrajectory:
        return GazeTrajectory(self.fps, head, gaze_in_space_rad, find_saccades(gaze_in_space_rad.mean(1), self.fps))


def render_trajectory(trajectory: GazeTrajectory, blinked: Sequence[Blink], fps: float) -> Animation:
    """A course and its blinks at a frame rate."""
    if fps == trajectory.fps:
        head, eye = trajectory.head, rotation.eye_in_head(trajectory.head, trajectory.gaze_in_space_rad)
    else:
        resampled = resample(trajectory.head, trajectory.gaze_in_space_rad, trajectory.saccades, trajectory.fps, fps)
        head, eye = resampled.head, resampled.gaze
    closure = blinks.closure(blinked, np.arange(len(head)) / fps)
    eye = eye_head.clamp_to_eye_range(eye)  # gaze that is held over a blink stays in space while the head turns
    motion = Motion.of(fps, head, eye, lid=np.repeat(closure[:, None], 2, axis=1))
    return Animation(motion, Events(saccades=trajectory.saccades, blinks=tuple(blinked)))


def sample_seeds(seed: int, samples: int) -> list[int]:
    """A seed for each sample."""
    return [int(np.random.SeedSequence([seed, index]).generate_state(1)[0]) for index in range(samples)]


def hold_over_blinks(
    blinked: Sequence[Blink], gaze_in_space_rad: Float[ndarray, "T 2 2"], fps: float
) -> Float[ndarray, "T 2 2"]:
    """Gaze stays where it was while the lids are shut."""
    shut = blinks.closure(blinked, np.arange(len(gaze_in_space_rad)) / fps) >= SHUT_CLOSURE
    shut[:1] = False
    source = np.maximum.accumulate(np.where(shut, 0, np.arange(len(gaze_in_space_rad))))
    return np.asarray(gaze_in_space_rad[source])
