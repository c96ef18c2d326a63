"""Streaming: head, gaze and blinks while speech is spoken; chunks of sound in, frames out after a fixed latency.

The frame at time t is given as soon as the sound up to t + `latency_s` has come (0.237 s with `talkingeyes_live`: 37 ms
for prosody, 160 ms lookahead of its speech layers, 40 ms for the rest of a bin of gaze). The frames do not depend on
how the sound is cut into chunks; they equal `LiveModel.generate_offline` (docs/live.md). Only the steps of
`pipeline.CAUSAL_STEPS` apply, then nods (`live_nods.py`), and a state, eye contact and a target (`live_gaze.py`).
Controls can be changed while the stream runs. Jaw and expression are neutral: no face model can be streamed yet.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.animation.blink_sampling import SHUT_CLOSURE
from talkingeyes.animation.context import AnimationContext, MotionCentre, sample_seeds
from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, hold_frames
from talkingeyes.animation.listening_behaviour import FACE_TO_FACE, check_population
from talkingeyes.animation.live_gaze import GazeDirection, LiveGaze
from talkingeyes.animation.live_listening import LiveListening
from talkingeyes.animation.live_nods import LiveNods
from talkingeyes.animation.model_file import open_model
from talkingeyes.animation.pipeline import CAUSAL_STEPS
from talkingeyes.audio.encoder import EmbedSettings
from talkingeyes.audio.streaming_prosody import StreamingProsody
from talkingeyes.audio.waveform import LONGEST_S, SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Motion
from talkingeyes.core.settings import validate_section
from talkingeyes.models.motion_stream import MotionStream, StreamingModules, concat_motions
from talkingeyes.models.speech_to_motion import GeneratedMotion, SpeechToMotion
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.training.motion_generators import NetworkGenerator, load_generator

MAX_LATENCY_S = 0.4
STRAIGHT_AHEAD_RAD = np.zeros(2)
RAMP_S = 0.2  # in which a changed liveliness takes effect
GAZE_STREAM, NOD_STREAM, LISTENING_STREAM = 1, 2, 3  # of the seeds


@dataclass(frozen=True)
class StreamFrames:
    """Consecutive frames of a stream from frame number `first` on: head, eye-in-head and lids as in Motion."""

    first: int
    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]
    lid: Float[ndarray, "T 2"]

    def __len__(self) -> int:
        return len(self.head)


@dataclass(frozen=True)
class LiveControls:
    """Controls of a stream: blink profile, liveliness (`animation/controls.py`), eye contact, target and state.

    `population`: whose gaze while a partner speaks (face_to_face, remote_call). Raises InputError for another.
    """

    blinks: str = "physiological"
    liveliness: Liveliness = field(default_factory=Liveliness)
    gaze: GazeDirection = field(default_factory=GazeDirection)
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
    embedding: EmbedSettings
    fps: float
    blink_profiles: Mapping[str, BlinkProfile]

    @classmethod
    def load(cls, model: Path) -> LiveModel:
        """Load a folder of the train stage or a packed file. Raises InputError if it cannot be streamed."""
        with open_model(model) as folder, reading(model, "trained model; `make report` trains one"):
            generator = load_generator(folder)
            content = read_json(folder / "embedding.json", "JSON file")
            settings = validate_section("embed", EmbedSettings, content["settings"])
            seen = read_json(folder / "blinks.json", "JSON file")["speakers"]["log_normal"]
            corpus = BlinkProfile("lognormal", math.exp(seen["mean"]), seen["sd"])
        if not isinstance(generator, NetworkGenerator):
            raise InputError(
                f"{model}: should be a model for streams, such as data/train/talkingeyes_live, got a baseline"
            )
        found = cls(generator.network, settings, float(content["fps"]), blinks.PROFILES | {"corpus": corpus})
        found.check(model)
        return found

    def check(self, model: Path) -> None:
        """Raises InputError for a model with too much lookahead, or with features that a stream does not have."""
        if not self.speech_channels or set(self.speech_channels) - set(StreamingProsody.channels):
            raise InputError(f"{model}: a model for streams should use {', '.join(StreamingProsody.channels)} alone")
        if self.latency_s > MAX_LATENCY_S:
            raise InputError(f"{model}: should look at most {MAX_LATENCY_S:g} s ahead, got {self.latency_s:.3f} s")

    @property
    def latency_s(self) -> float:
        """Seconds of sound after a frame that must have come before the frame is given."""
        return (
            StreamingModules.of(self.network).lookahead_frames / self.fps
            + StreamingProsody(self.embedding, self.fps).lookahead_samples / SAMPLE_RATE
        )

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
        features = StreamingProsody(self.embedding, self.fps).process_offline(sound)
        (own_seed,) = sample_seeds(seed, 1)
        trajectory = self.apply_steps(
            self.network.generate(self.embed(features), [own_seed]), controls.state_liveliness
        )
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
        sampled_blinks = self.sample_hour_of_blinks(seed, controls)
        closure = blinks.blink_closure(sampled_blinks, trajectory.times_s)
        space = hold_frames(trajectory.gaze_in_space_rad, closure >= SHUT_CLOSURE)
        eye = eye_head.clamp_to_eye_range(rotation.eye_in_head(trajectory.head, space))
        return Motion.of(self.fps, trajectory.head, eye, lid=np.repeat(closure[:, None], 2, axis=1))

    def embed(self, features: Float[ndarray, "T 3"]) -> Float[Tensor, "T C"]:
        """The embedding that the network expects; channels that it does not use are zero."""
        speech = self.network.speech
        embedding = torch.zeros(len(features), len(speech.mean))
        embedding[:, speech.channel_indices] = torch.from_numpy(
            features[:, [StreamingProsody.channels.index(n) for n in self.speech_channels]]
        )
        return embedding

    @property
    def speech_channels(self) -> tuple[str, ...]:
        """Names of the speech channels that the network uses."""
        return self.network.settings.speech.channels or ()

    def live_gaze(self, seed: int) -> LiveGaze:
        """What directs the gaze of a stream."""
        return LiveGaze(self.fps, self.mean_head, [seed, GAZE_STREAM])

    def live_nods(self, seed: int) -> LiveNods:
        """What answers the partner of a stream."""
        return LiveNods(self.latency_s, [seed, NOD_STREAM])

    def live_listening(self, seed: int, controls: LiveControls) -> LiveListening:
        """Gaze of a stream while its partner speaks; the last frame of a bin of gaze comes with the first."""
        known_s = self.latency_s - (StreamingModules.of(self.network).gaze.step_frames - 1) / self.fps
        return LiveListening(self.fps, known_s, controls.population, [seed, LISTENING_STREAM])

    @property
    def mean_head(self) -> Float[ndarray, " 3"]:
        """The model's mean head pose."""
        return np.asarray(StreamingModules.of(self.network).head.normal.mean.numpy(), np.float64)

    def apply_steps(self, generated: GeneratedMotion, liveliness: Liveliness) -> GazeTrajectory:
        """Apply the causal steps to generated frames; they scale about the model's mean pose and straight ahead."""
        head, gaze = (part[0].numpy().astype(np.float64) for part in (generated.head, generated.gaze))
        trajectory = GazeTrajectory(self.fps, head, rotation.gaze_in_space(head, gaze), ())
        context = AnimationContext(
            Controls(liveliness=liveliness), centre=MotionCentre(self.mean_head, STRAIGHT_AHEAD_RAD)
        )
        for step in CAUSAL_STEPS:
            trajectory = step(trajectory, context)
        return trajectory

    def sample_hour_of_blinks(self, seed: int, controls: LiveControls) -> tuple[Blink, ...]:
        """The blinks of an hour, so that they do not depend on how long the speech turns out to be."""
        if controls.blinks not in self.blink_profiles:
            raise InputError(f"blinks: should be one of {', '.join(self.blink_profiles)}, got {controls.blinks}")
        profile, rng = self.blink_profiles[controls.blinks], np.random.default_rng([seed, 0])
        rate = blinks.sample_blink_rate(profile, rng) * controls.liveliness.blinks
        return blinks.sample_blinks(profile, LONGEST_S, rng, rate_per_min=rate) if rate else ()


class LiveStream:
    """The state of one stream; sound that no later frame needs is dropped, so memory does not grow."""

    def __init__(self, model: LiveModel, seed: int, controls: LiveControls) -> None:
        self._model, self._seed = model, seed
        self._controls, self._before = controls, controls.state_liveliness
        self._changed_frame = -math.inf  # when liveliness was changed
        self._gaze = model.live_gaze(seed)
        self._blinks = deque(model.sample_hour_of_blinks(seed, controls))
        self._motion = MotionStream(model.network, sample_seeds(seed, 1)[0])
        self._prosody = StreamingProsody(
            model.embedding, model.fps, block_frames=StreamingModules.of(model.network).gaze.step_frames
        )
        self._nods: LiveNods | None = None  # with a partner
        self._listening = model.live_listening(seed, controls)
        self._samples, self._frames = 0, 0
        self._held_gaze: Float[ndarray, "2 2"] | None = None  # of the last frame
        self._ended = False

    def push(self, chunk: Float[ndarray, " N"], partner: Float[ndarray, " M"] | None = None) -> StreamFrames:
        """Take the next 16 kHz samples and return the frames that are complete now, perhaps none.

        `partner`: the same time of the partner's sound, which nods and gaze answer; with every chunk or with none.
        Raises InputError for NaN, for more than an hour, after the end, and for a partner that does not fit.
        """
        if self._ended:
            raise InputError("sound: the stream has ended; a new one should be begun, got more sound")
        for name, sound in (("sound", chunk), ("partner", partner)):
            if sound is not None and not np.isfinite(sound).all():
                raise InputError(f"{name}: samples should be finite numbers, got NaN or infinite ones")
        if self._samples + len(chunk) > LONGEST_S * SAMPLE_RATE:
            raise InputError(f"sound: a stream should last at most {LONGEST_S:.0f} s, got more")
        self._push_partner(chunk, partner)
        self._samples += len(chunk)
        patch = self._prosody.block_frames
        features = self._prosody.push(chunk)
        parts = [self._push_features(features[first : first + patch]) for first in range(0, len(features), patch)]
        return self._add_blinks(parts)

    def _push_partner(self, chunk: Float[ndarray, " N"], partner: Float[ndarray, " M"] | None) -> None:
        """Take the partner's sound for a chunk."""
        count = len(chunk)
        given = 0 if partner is None else len(partner)
        if partner is not None and given != count:
            raise InputError(f"partner: should have as many samples as the sound, {count}, got {given}")
        if (self._samples or self._nods) and (partner is None) != (self._nods is None):
            raise InputError(f"partner: should come with every chunk of a stream or with none, got {given} samples")
        if partner is not None:
            self._nods = self._nods or self._model.live_nods(self._seed)
            self._nods.push(partner)
            self._listening.push(chunk, partner)

    def change(self, liveliness: Liveliness | None = None, gaze: GazeDirection | None = None) -> int:
        """Change controls for the frames that have not been given yet; returns the number of the first of them.

        The liveliness of head and gaze takes effect over 0.2 s. Blinks stay as they were sampled.
        """
        before, old = self._liveliness(self._frames - 1), self._controls
        self._controls = replace(old, liveliness=liveliness or old.liveliness, gaze=gaze or old.gaze)
        if self._controls.state_liveliness != old.state_liveliness:
            self._before, self._changed_frame = before, self._frames
        return self._frames

    def finish(self) -> StreamFrames:
        """End the stream and return its remaining frames."""
        self._ended = True
        features = self._prosody.finish()
        return self._add_blinks([self._push_features(features), self._motion.finish()])

    def _push_features(self, features: Float[ndarray, "T 3"]) -> GeneratedMotion:
        return self._motion.push(self._model.embed(features))

    def _add_blinks(self, parts: list[GeneratedMotion]) -> StreamFrames:
        """Apply the causal steps, add blinks, and hold gaze while the lids are shut."""
        parts = [part for part in parts if part.head.shape[1]]
        if not parts:
            return StreamFrames(self._frames, np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 2)))
        trajectory = self._add_nods(self._apply_steps(concat_motions(parts)))
        contact = self._listening.contact(len(trajectory.head)) if self._nods else []
        trajectory = self._gaze.direct(trajectory, self._controls.gaze, self._controls.liveliness.gaze, contact)
        first = self._frames
        self._frames += len(trajectory.head)
        closure = self._closure(np.arange(first, self._frames) / self._model.fps)
        space = hold_frames(trajectory.gaze_in_space_rad, closure >= SHUT_CLOSURE, self._held_gaze)
        self._held_gaze = space[-1].copy()
        eye = eye_head.clamp_to_eye_range(rotation.eye_in_head(trajectory.head, space))
        return StreamFrames(first, trajectory.head, eye, np.repeat(closure[:, None], 2, axis=1))

    def _apply_steps(self, generated: GeneratedMotion) -> GazeTrajectory:
        """Apply the causal steps; frame by frame while a changed liveliness takes effect."""
        frames = generated.head.shape[1]
        if self._frames - self._changed_frame > RAMP_S * self._model.fps:
            return self._model.apply_steps(generated, self._controls.state_liveliness)
        parts = [
            self._model.apply_steps(
                GeneratedMotion(generated.head[:, frame : frame + 1], generated.gaze[:, frame : frame + 1]),
                self._liveliness(self._frames + frame),
            )
            for frame in range(frames)
        ]
        head, space = (
            np.concatenate([getattr(each, name) for each in parts]) for name in ("head", "gaze_in_space_rad")
        )
        return GazeTrajectory(self._model.fps, head, space, ())

    def _add_nods(self, trajectory: GazeTrajectory) -> GazeTrajectory:
        """Turn the head; gaze in space stays."""
        if self._nods is None:
            return trajectory
        frames = np.arange(self._frames, self._frames + len(trajectory.head))
        gain = np.array([[self._liveliness(frame).head] for frame in frames.tolist()])
        nods = self._nods.rotation(frames / self._model.fps, self._controls.nods)
        return replace(trajectory, head=trajectory.head + gain * nods)

    def _liveliness(self, frame: int) -> Liveliness:
        """Liveliness at a frame: the last change takes effect with minimum jerk."""
        done = float(eye_head.minimum_jerk(np.array((frame - self._changed_frame + 1) / (RAMP_S * self._model.fps))))
        before, after = self._before, self._controls.state_liveliness
        head, gaze = (
            (1.0 - done) * old + done * new for old, new in ((before.head, after.head), (before.gaze, after.gaze))
        )
        return replace(after, head=head, gaze=gaze)

    def _closure(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """Lid closure at each time; blinks that are over are dropped."""
        if not len(times_s):
            return np.zeros(0)
        while self._blinks and blinks.end_s(self._blinks[0]) < times_s[0]:
            self._blinks.popleft()
        return blinks.blink_closure([*takewhile(lambda blink: blink.onset_s <= times_s[-1], self._blinks)], times_s)
