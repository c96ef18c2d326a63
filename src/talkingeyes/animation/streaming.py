"""Streaming: head, gaze, blinks and face while speech is spoken; sound in, frames out after a fixed latency.

The frame at time t is given as soon as the sound up to t + `latency_s` has come (0.237 s with `talkingeyes_live`: 37 ms
for prosody, 160 ms lookahead of its speech layers, 40 ms for the rest of a bin of gaze). The frames do not depend on
how the sound is cut into chunks; they equal `LiveModel.generate_offline` (docs/live.md). Only the steps of
`pipeline.CAUSAL_STEPS` apply, then nods (`live_nods.py`), and a state, eye contact and a target (`live_gaze.py`).
Controls can be changed while the stream runs, and many streams take one step (`live_stream.py`). The face has a model
of its own (`live_face.py`), within the same lookahead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.blink_sampling import SHUT_CLOSURE
from talkingeyes.animation.context import AnimationContext, MotionCentre, sample_seeds
from talkingeyes.animation.controls import NEUTRAL_FACE, Controls, Liveliness
from talkingeyes.animation.face import with_face
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, hold_frames
from talkingeyes.animation.listening_behaviour import FACE_TO_FACE, check_population
from talkingeyes.animation.live_face import LiveFace
from talkingeyes.animation.live_gaze import GazeDirection, LiveGaze
from talkingeyes.animation.live_listening import LiveListening
from talkingeyes.animation.live_nods import LiveNods
from talkingeyes.animation.live_stream import LiveStream, StreamFrames
from talkingeyes.animation.model_file import LIVE_FACE_FOLDER, PACKAGED_LIVE_FACE, open_with_face
from talkingeyes.animation.pipeline import CAUSAL_STEPS
from talkingeyes.audio.encoder import PROSODY_CHANNELS, EmbedSettings
from talkingeyes.audio.streaming_prosody import StreamingProsody
from talkingeyes.audio.waveform import LONGEST_S, SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Motion
from talkingeyes.core.settings import validate_section
from talkingeyes.models.face.style import FaceStyle, StyleKey
from talkingeyes.models.motion_stream import MotionStreams, StreamingModules
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.training.motion_generators import NetworkGenerator, load_generator

MAX_LATENCY_S = 0.4
STRAIGHT_AHEAD_RAD = np.zeros(2)
GAZE_STREAM, NOD_STREAM, LISTENING_STREAM = 1, 2, 3  # of the seeds


@dataclass(frozen=True)
class LiveControls:
    """Controls of a stream: blink profile, liveliness (`animation/controls.py`), eye contact, target and state, style.

    `face`: emotion and intensity of the face (head, gaze and blinks do not follow them, as they do in files).
    `population`: whose gaze while a partner speaks (face_to_face, remote_call). Raises InputError for another.
    """

    blinks: str = "physiological"
    liveliness: Liveliness = field(default_factory=Liveliness)
    gaze: GazeDirection = field(default_factory=GazeDirection)
    face: FaceStyle = NEUTRAL_FACE[0].style
    population: str = FACE_TO_FACE

    def __post_init__(self) -> None:
        check_population(self.population)

    @property
    def state_liveliness(self) -> Liveliness:
        """Liveliness with that of the head in the state."""
        return replace(self.liveliness, head=self.gaze.head_gain * self.liveliness.head)

    @property
    def nods(self) -> bool:
        """Whether nods answer the partner, where there is one."""
        return self.gaze.state in (None, "listening")


DEFAULT_LIVE_CONTROLS = LiveControls()


@dataclass(frozen=True)
class LiveModel:
    """A trained model without long lookahead, which can be streamed."""

    network: SpeechToMotion
    fps: float
    blink_profiles: Mapping[str, BlinkProfile]
    face: LiveFace

    @classmethod
    def load(cls, model: Path) -> LiveModel:
        """Load a folder of the train stage or a packed file, with its face (`live_face.py`).

        Raises InputError if it cannot be streamed.
        """
        opened = open_with_face(model, LIVE_FACE_FOLDER, PACKAGED_LIVE_FACE)
        with opened as (folder, face_folder), reading(model, "trained model; `make report` trains one"):
            generator = load_generator(folder)
            content = read_json(folder / "embedding.json", "JSON file")
            settings = validate_section("embed", EmbedSettings, content["settings"])
            seen = read_json(folder / "blinks.json", "JSON file")["speakers"]["log_normal"]
            corpus = BlinkProfile("lognormal", math.exp(seen["mean"]), seen["sd"])
            face = LiveFace.load(face_folder)
        if not isinstance(generator, NetworkGenerator):
            raise InputError(
                f"{model}: should be a model for streams, such as data/train/talkingeyes_live, got a baseline"
            )
        found = cls(generator.network, float(content["fps"]), blinks.PROFILES | {"corpus": corpus}, face)
        found.check(model, settings)
        return found

    def check(self, model: Path, settings: EmbedSettings) -> None:
        """Raises InputError for a model with too much lookahead, or with features that a stream does not have;
        `settings` are those of its embedding."""
        channels, face = self.network.speech.channels, self.face
        if not channels or set(channels) - set(PROSODY_CHANNELS):
            raise InputError(f"{model}: a model for streams should use {', '.join(PROSODY_CHANNELS)} alone")
        if self.latency_s > MAX_LATENCY_S:
            raise InputError(f"{model}: should look at most {MAX_LATENCY_S:g} s ahead, got {self.latency_s:.3f} s")
        own, others = ((each.prosody, each.level_dbfs) for each in (settings, face.embedding))
        if own != others or self.fps != face.fps:
            raise InputError(f"{model}: should have the frame rate, level and prosody of its face, got others")
        if face.lookahead_frames > (most := StreamingModules.of(self.network).speech_lookahead):
            raise InputError(f"{model}: its face should look at most {most} frames ahead, got {face.lookahead_frames}")

    @cached_property
    def latency_s(self) -> float:
        """Seconds of sound after a frame that must have come before the frame is given."""
        lookahead_s = StreamingModules.of(self.network).lookahead_frames / self.fps
        return lookahead_s + self.features.lookahead_samples / SAMPLE_RATE

    @cached_property
    def features(self) -> StreamingProsody:
        """What computes the speech features of whole sounds."""
        return StreamingProsody(self.face.embedding, self.fps)

    def stream(self, seed: int, controls: LiveControls = DEFAULT_LIVE_CONTROLS) -> LiveStream:
        """A new stream; the same seed and sound give the same frames. Raises InputError for unknown blinks."""
        return LiveStream(self, seed, controls)

    def generate_offline(
        self,
        sound: Float[ndarray, " N"],
        seed: int,
        controls: LiveControls = DEFAULT_LIVE_CONTROLS,
        partner: Float[ndarray, " N"] | None = None,
    ) -> Motion:
        """The frames of a stream, computed from the whole sound (and the partner's) at once."""
        features, names = self.features.process_offline(sound), self.features.channels
        (own_seed,) = sample_seeds(seed, 1)
        generated = self.network.generate(self.network.speech.embedding_of(features, names), [own_seed])
        heard = self.face.generator.network.speech.embedding_of(features, names).numpy()
        style = (StyleKey(0.0, controls.face),)
        face = self.face.generator.generate(heard, style, [own_seed], self.fps)
        head, gaze = (part[0].numpy().astype(np.float64) for part in (generated.head, generated.gaze))
        trajectory = GazeTrajectory(self.fps, head, rotation.gaze_in_space(head, gaze), ())
        trajectory = self.apply_steps(trajectory, controls.state_liveliness)
        if partner is not None:
            nods = self.live_nods(seed)
            nods.push(partner)
            turns = controls.state_liveliness.head * nods.rotation(trajectory.times_s, controls.nods)
            trajectory = replace(trajectory, head=trajectory.head + turns)
        contact: list[float | None] = []
        if partner is not None:
            listening = self.live_listening(seed, controls)
            listening.push(sound, partner)
            contact = listening.contact(len(trajectory.head))
        trajectory = self.live_gaze(seed).direct(trajectory, controls.gaze, controls.liveliness.gaze, contact)
        sampled_blinks = tuple(self.hour_of_blinks(seed, controls))
        closure = blinks.blink_closure(sampled_blinks, trajectory.times_s)
        space = hold_frames(trajectory.gaze_in_space_rad, closure >= SHUT_CLOSURE)
        eye = eye_head.clamp_to_eye_range(rotation.eye_in_head(trajectory.head, space))
        motion = Motion.of(self.fps, trajectory.head, eye, lid=np.repeat(closure[:, None], 2, axis=1))
        return with_face(motion, face, 0, style)

    def motion_of(self, frames: StreamFrames) -> Motion:
        """Frames of a stream as a motion."""
        basis = self.face.generator.basis
        return Motion.of(
            self.fps,
            frames.head,
            frames.gaze,
            lid=frames.lid,
            jaw=frames.jaw,
            expression=frames.expression,
            expression_names=basis.expression_names,
            head_model=basis.head_model,
        )

    @cached_property
    def motion_streams(self) -> MotionStreams:
        """The network for streams; its weights are there once for all."""
        return MotionStreams(self.network)

    @property
    def step_frames(self) -> int:
        """Frames that a stream gives at once."""
        return StreamingModules.of(self.network).gaze.step_frames

    def live_gaze(self, seed: int) -> LiveGaze:
        """What directs the gaze of a stream."""
        return LiveGaze(self.fps, self.mean_head, [seed, GAZE_STREAM])

    def live_nods(self, seed: int) -> LiveNods:
        """What answers the partner of a stream."""
        return LiveNods(self.latency_s, [seed, NOD_STREAM])

    def live_listening(self, seed: int, controls: LiveControls) -> LiveListening:
        """Gaze of a stream while its partner speaks; the last frame of a bin of gaze comes with the first."""
        known_s = self.latency_s - (self.step_frames - 1) / self.fps
        return LiveListening(self.fps, known_s, controls.population, [seed, LISTENING_STREAM])

    @cached_property
    def mean_head(self) -> Float[ndarray, " 3"]:
        """The model's mean head pose."""
        return np.asarray(StreamingModules.of(self.network).head.normal.mean.numpy(), np.float64)

    def apply_steps(self, trajectory: GazeTrajectory, liveliness: Liveliness) -> GazeTrajectory:
        """Apply the causal steps to generated frames; they scale about the model's mean pose and straight ahead."""
        context = AnimationContext(
            Controls(liveliness=liveliness), centre=MotionCentre(self.mean_head, STRAIGHT_AHEAD_RAD)
        )
        for step in CAUSAL_STEPS:
            trajectory = step(trajectory, context)
        return trajectory

    def hour_of_blinks(self, seed: int, controls: LiveControls) -> Iterator[Blink]:
        """The blinks of an hour, so that they do not depend on how long the speech turns out to be."""
        if controls.blinks not in self.blink_profiles:
            raise InputError(f"blinks: should be one of {', '.join(self.blink_profiles)}, got {controls.blinks}")
        profile, rng = self.blink_profiles[controls.blinks], np.random.default_rng([seed, 0])
        rate = blinks.sample_blink_rate(profile, rng) * controls.liveliness.blinks
        return blinks.sample_blinks(profile, LONGEST_S, rng, rate_per_min=rate) if rate else iter(())
