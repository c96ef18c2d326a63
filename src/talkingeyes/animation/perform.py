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

from talkingeyes.animation.course import Course
from talkingeyes.animation.direct import Asked, blinks_of, blinks_per_min, blinks_with, directed
from talkingeyes.animation.direction import NEUTRAL_FACE, Direction
from talkingeyes.animation.events import resample
from talkingeyes.animation.face import FacePerformer, beside, with_face
from talkingeyes.animation.keys import save_keys
from talkingeyes.animation.listening import listening, turns
from talkingeyes.animation.model_file import opened
from talkingeyes.animation.oculomotor import accompanied
from talkingeyes.animation.parts import recast_events, recast_motion
from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Events, Motion
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.fitting.manner import SPEAKERS_FILE, Manner, load_speakers
from talkingeyes.models.condition.conditioner import Given
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.physiology.steps import find_saccades
from talkingeyes.training.telling import of_samples, somebody
from talkingeyes.training.trained import Generator, load_generator, needs, speakers_of

SHUT = 0.5
PERSON = 5  # beside a seed: for who moves
MODELS_OWN = Direction()


@dataclass(frozen=True)
class Performance:
    """A motion and the events it is made of."""

    motion: Motion
    events: Events

    def save(self, path: Path | str) -> None:
        """Write the motion (.npz), and its events beside it as keys for editing (NAME.events.json)."""
        path = Path(path)
        self.motion.save(path)
        save_keys(path.with_name(f"{path.stem}.events.json"), self.events, self.motion.fps)


@dataclass(frozen=True)
class Performer:
    """A trained model with the speech encoder that it was trained on."""

    encoder: SpeechEncoder
    generator: Generator
    fps: float
    # By name: of the paper, of physiology, of the corpus that the model was trained on.
    blink_profiles: Mapping[str, BlinkProfile] = field(default_factory=lambda: blinks.PROFILES)
    # By name: the habits of the speakers that it was trained on.
    speakers: Mapping[str, Manner] = field(default_factory=dict)
    face: FacePerformer | None = None

    @classmethod
    def load(cls, model: Path, face: Path | None = None) -> Performer:
        """From a folder of the train stage or a packed file. Raises InputError if it is missing or damaged.

        `face` is the folder of a model of the face; by default that which stands beside the model, if there is one.
        """
        with opened(model) as folder:
            return cls._of_folder(folder, face or beside(folder))

    @classmethod
    def _of_folder(cls, model: Path, face: Path | None) -> Performer:
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
        of_face = FacePerformer.load(face, settings, encoder) if face else None
        return cls(encoder, generator, fps, profiles, speakers, of_face)

    @property
    def persons(self) -> tuple[str, ...]:
        """Whom the model can be told to move as."""
        return speakers_of(self.generator) if "speaker" in needs(self.generator) else ()

    def perform(
        self,
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        fps: float,
        direction: Direction = MODELS_OWN,
    ) -> list[Performance]:
        """`samples` performances of 16 kHz speech; sample i of a seed is the same however many are asked for.

        Raises InputError for a profile of blinks, a person or a style that the model does not have.
        """
        self._check(direction)
        embedding = self.encoder(sound, self.fps)
        return self._all(embedding, sound, samples, seed, fps, direction)

    def perform_embedded(
        self,
        embedding: Float[ndarray, "T C"],
        samples: int,
        seed: int,
        fps: float,
        direction: Direction = MODELS_OWN,
        sound: Float[ndarray, " N"] | None = None,
    ) -> list[Performance]:
        """The same for speech that is embedded already.

        Without the sound nobody knows who speaks when: blinks do not heed phrases, and there can be no partner. There
        is no face either, where the model of the face has another encoder.
        """
        self._check(direction)
        if direction.partner is not None and sound is None:
            raise InputError("partner: should come with the sound of the speech itself, got embedded speech")
        return self._all(embedding, np.zeros(0) if sound is None else sound, samples, seed, fps, direction)

    def _check(self, direction: Direction) -> None:
        if direction.blinks not in self.blink_profiles:
            raise InputError(f"blinks: should be one of {', '.join(self.blink_profiles)}, got {direction.blinks}")
        if isinstance(direction.style, str) and direction.style not in self.speakers:
            known = ", ".join(self.speakers) or "a measured one (the model keeps no speakers)"
            raise InputError(f"style: should be one of {known}, got {direction.style}")
        if direction.person is not None and direction.person not in self.persons:
            known = ", ".join(self.persons) or "asked of a model that is told who moves"
            raise InputError(f"person: should be one of {known}, got {direction.person}")
        if self.face:
            self.face.check(direction.face)
        elif direction.face != NEUTRAL_FACE:
            raise InputError("emotion and speaker: should be asked of a model of the face (probtalk3d), got none")

    def _all(
        self,
        embedding: Float[ndarray, "T C"],
        sound: Float[ndarray, " N"],
        samples: int,
        seed: int,
        fps: float,
        direction: Direction,
    ) -> list[Performance]:
        style = direction.style
        manner = self.speakers[style] if isinstance(style, str) else style
        person = self._person(direction, seed)
        drawn = self._drawn(embedding, sound, sample_seeds(seed, samples), person)
        faces = self._faces(embedding, sound, samples, seed, direction)
        less = self._blinks_less(person)
        spoken = turns(sound, np.zeros(0)) if len(sound) else None
        performances = []
        for index in range(samples):
            heard = None if direction.partner is None else listening(sound, direction.partner, [seed, index, 3])
            one = self._one(drawn, index, seed, fps, Asked(direction, manner, less, heard, spoken))
            motion = with_face(one.motion, faces, index, direction.face) if faces else one.motion
            motion = recast_motion(motion, direction.parts)
            performances.append(Performance(motion, recast_events(one.events, motion, direction.parts)))
        return performances

    def _person(self, asked: Direction, seed: int) -> str | None:
        """Samples are takes of one person: who is asked for, by name or by style, or one whom the seed draws."""
        if not self.persons:
            return None
        for name in (asked.person, asked.style):
            if name in self.persons:
                return str(name)
        return self.persons[somebody(self.persons, [seed, PERSON])]

    def _blinks_less(self, person: str | None) -> float | None:
        """The share of the speakers who blink less often than a person, who counts half."""
        if person is None or person not in self.speakers:
            return None
        rates, own = [each.blinks_per_min for each in self.speakers.values()], self.speakers[person].blinks_per_min
        return float(np.mean([0.5 * (rate <= own) + 0.5 * (rate < own) for rate in rates]))

    def _drawn(
        self, embedding: Float[ndarray, "T C"], sound: Float[ndarray, " N"], seeds: list[int], person: str | None
    ) -> Samples:
        """Head and gaze; a model is told who moves and given the waveform, if it asks for them."""
        given, wanted = Given(), needs(self.generator)
        if person is not None:
            given = replace(given, speaker=torch.tensor([self.persons.index(person)]))
        if "sound" in wanted:
            if not len(sound):
                raise InputError("speech.wave: a model that hears the waveform needs the sound, got embedded speech")
            heard = of_samples(sound, round(len(embedding) * SAMPLE_RATE / self.fps))
            given = replace(given, sound=torch.from_numpy(heard)[None])
        return self.generator.generate(embedding, seeds, self.fps, given)

    def _faces(
        self, embedding: Float[ndarray, "T C"], sound: Float[ndarray, " N"], samples: int, seed: int, asked: Direction
    ) -> FaceSamples | None:
        """What the model of the face gives, if there is one and it is asked."""
        if self.face is None or not asked.parts.models_give("face"):
            return None
        if self.face.encoder is not self.encoder:
            if not len(sound):
                return None
            embedding = self.face.encoder(sound, self.fps)
        return self.face.perform(embedding, asked.face, seed, samples, self.fps)

    def _one(self, drawn: Samples, index: int, seed: int, fps: float, asked: Asked) -> Performance:
        head, gaze = drawn.head[index], drawn.gaze[index]
        random = np.random.default_rng([seed, index])
        space = rotation.gaze_in_space(head, gaze)
        if not asked.direction.as_drawn:
            head = accompanied(self._own(head, space)).head
        course = self._course(head, space, asked, [seed, index])
        blinked: tuple[Blink, ...] = ()
        if asked.direction.parts.models_give("blinks"):
            profile = self.blink_profiles[asked.direction.blinks]
            rate = blinks_per_min(profile, asked, random)
            brought = blinks_with(profile, course, rate, random)
            spontaneous = blinks_of(profile, asked, course.seconds, rate, brought, random)
            blinked = blinks.without_overlap(brought, spontaneous)
            course = self._course(head, held_over(spontaneous, space, self.fps), asked, [seed, index])
        return played(course, blinked, fps)

    def _course(
        self, head: Float[ndarray, "T 3"], space_rad: Float[ndarray, "T 2 2"], asked: Asked, seeds: Sequence[int]
    ) -> Course:
        return directed(self._own(head, space_rad), asked, seeds)

    def _own(self, head: Float[ndarray, "T 3"], space_rad: Float[ndarray, "T 2 2"]) -> Course:
        return Course(self.fps, head, space_rad, find_saccades(space_rad.mean(1), self.fps))


def played(course: Course, blinked: Sequence[Blink], fps: float) -> Performance:
    """A course and its blinks at a frame rate."""
    if fps == course.fps:
        head, eye = course.head, rotation.eye_in_head(course.head, course.space_rad)
    else:
        performed = resample(course.head, course.space_rad, course.saccades, course.fps, fps)
        head, eye = performed.head, performed.gaze
    closure = blinks.closure(blinked, np.arange(len(head)) / fps)
    eye = eye_head.within_range(eye)  # gaze that is held over a blink stays in space while the head turns
    motion = Motion.of(fps, head, eye, lid=np.repeat(closure[:, None], 2, axis=1))
    return Performance(motion, Events(saccades=course.saccades, blinks=tuple(blinked)))


def sample_seeds(seed: int, samples: int) -> list[int]:
    """A seed for each sample."""
    return [int(np.random.SeedSequence([seed, index]).generate_state(1)[0]) for index in range(samples)]


def held_over(blinked: Sequence[Blink], space_rad: Float[ndarray, "T 2 2"], fps: float) -> Float[ndarray, "T 2 2"]:
    """Gaze stays where it was while the lids are shut."""
    shut = blinks.closure(blinked, np.arange(len(space_rad)) / fps) >= SHUT
    shut[:1] = False
    source = np.maximum.accumulate(np.where(shut, 0, np.arange(len(space_rad))))
    return np.asarray(space_rad[source])
