"""The state of a live stream, and the step that takes the sound of many streams of a model at once.

A step is a chain of stages: sound, speech features, networks, controls, lids and face. Stages that cost more in calls
than in arithmetic treat all streams together: the analysis of sound, the networks, rotations. Those change nothing
before they succeed, so if one fails, it is tried for each stream alone, and only the stream that fails ends.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import accumulate, islice
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.animation.blink_sampling import SHUT_CLOSURE
from talkingeyes.animation.context import sample_seeds
from talkingeyes.animation.controls import Liveliness
from talkingeyes.animation.face import emotion_lid_closure, fade_around_eyes, with_emotion
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, hold_frames
from talkingeyes.animation.live_gaze import GazeDirection, listener_offsets
from talkingeyes.animation.live_nods import LiveNods
from talkingeyes.audio.streaming_prosody import StreamingProsody
from talkingeyes.audio.waveform import LONGEST_S, SAMPLE_RATE
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.models.face.basis import JAW_DIM
from talkingeyes.models.face.style import STYLE_FADE_S, FaceStyle, StyleKey, blend_over_time
from talkingeyes.models.motion_stream import concat_motions
from talkingeyes.models.speech_to_motion import GeneratedMotion
from talkingeyes.physiology import blinks, eye_head

if TYPE_CHECKING:
    from talkingeyes.animation.streaming import LiveControls, LiveModel

RAMP_S = 0.2  # in which a changed liveliness takes effect


@dataclass(frozen=True)
class StreamFrames:
    """Consecutive frames of a stream from frame number `first` on, as in Motion: head, eye-in-head, lids, face."""

    first: int
    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]
    lid: Float[ndarray, "T 2"]
    jaw: Float[ndarray, "T 3"]
    expression: Float[ndarray, "T C"]

    def __len__(self) -> int:
        return len(self.head)

    @classmethod
    def concat(cls, parts: Sequence[StreamFrames]) -> StreamFrames:
        """The frames of one part or more as one, from the first number of the first part on."""
        names = [each.name for each in fields(cls)[1:]]
        return cls(parts[0].first, *(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class StreamSound:
    """The next samples of a stream (16 kHz), and of a partner the same time."""

    stream: LiveStream
    chunk: Float[ndarray, " N"]
    partner: Float[ndarray, " M"] | None = None


@dataclass(frozen=True)
class GeneratedFrames:
    """What the networks generate: motion of one stream, and faces (expression, then jaw) of the same frames."""

    motion: GeneratedMotion
    face: Float[ndarray, "T F"]

    def __len__(self) -> int:
        return len(self.face)

    @classmethod
    def concat(cls, parts: Sequence[GeneratedFrames], face_dim: int) -> GeneratedFrames:
        """Parts as one, perhaps none."""
        face = np.concatenate([np.zeros((0, face_dim), np.float32), *(each.face for each in parts)])
        return cls(concat_motions([each.motion for each in parts]), face)


@dataclass(frozen=True)
class DirectedFrames:
    """Frames from number `first` on: head, directions of both optical axes in space, and lid closure by blinks and by
    the emotion."""

    first: int
    head: Float[ndarray, "T 3"]
    gaze_in_space_rad: Float[ndarray, "T 2 2"]
    closure: Float[ndarray, " T"]
    emotion_closure: Float[ndarray, " T"]


class LiveStream:
    """The state of one stream; sound that no later frame needs is dropped, so memory does not grow."""

    def __init__(self, model: LiveModel, seed: int, controls: LiveControls) -> None:
        self.model, self._seed = model, seed
        self._controls, self._before = controls, controls.state_liveliness
        self._changed_frame = -math.inf  # when liveliness was changed
        self._gaze = model.live_gaze(seed)
        self._later_blinks = model.hour_of_blinks(seed, controls)
        self._blinks = deque([*islice(self._later_blinks, 1)])  # up to the first that has not begun
        self.motion = model.motion_streams.begin(sample_seeds(seed, 1)[0])
        self.face = model.face.streams.begin()
        self.generated = 0  # frames
        self._styles = [StyleKey(0.0, controls.face)]  # those that still count
        self.prosody = StreamingProsody(model.face.embedding, model.fps, block_frames=model.step_frames)
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
        (found,) = push_together([StreamSound(self, chunk, partner)])
        if isinstance(found, Exception):
            raise found
        return found

    def change(
        self, liveliness: Liveliness | None = None, gaze: GazeDirection | None = None, face: FaceStyle | None = None
    ) -> int:
        """Change controls for the frames that have not been given yet; returns the number of the first of them.

        The liveliness of head and gaze takes effect over 0.2 s, the style of the face over 0.5 s. Blinks stay as they
        were sampled. Raises InputError for a speaker whom the face model does not know.
        """
        if face not in (None, self._styles[-1].style):
            self._change_style(face)
        before, old = self._liveliness(self._frames - 1), self._controls
        self._controls = replace(old, liveliness=liveliness or old.liveliness, gaze=gaze or old.gaze)
        if self._controls.state_liveliness != old.state_liveliness:
            self._before, self._changed_frame = before, self._frames
        return self._frames

    def _change_style(self, face: FaceStyle) -> None:
        """Begin a style with the next frame; styles that are faded out are dropped."""
        self.model.face.generator.vocabulary.style_vector(face)
        now_s = self._frames / self.model.fps
        first = max(row for row, key in enumerate(self._styles) if not row or key.onset_s + STYLE_FADE_S <= now_s)
        kept = [key for key in self._styles[first:] if key.onset_s < now_s]
        self._styles = [*kept, StyleKey(now_s, face)]

    def style_vectors(self, first: int, frames: int) -> Float[ndarray, "T D"]:
        """Style vectors of frames from number `first` on."""
        vector = self.model.face.generator.vocabulary.style_vector
        return blend_over_time(self._styles, np.arange(first, first + frames) / self.model.fps, vector)

    def finish(self) -> StreamFrames:
        """End the stream and return its remaining frames."""
        self._ended = True
        streams, faces = self.model.motion_streams, self.model.face.streams
        embeddings = _embeddings(self.model, self.prosody.finish()[None])
        (rest,) = streams.step([self.motion], embeddings[0])
        motion = concat_motions([rest.motion, streams.finish(rest.state).motion])
        (heard,) = faces.listen([self.face], embeddings[1])
        (step,) = faces.step([faces.finish(heard)], [self.style_vectors(self.generated, motion.head.shape[1])])
        failed: dict[int, Exception] = {}
        found = _complete({0: (self, GeneratedFrames(motion, step.face))}, failed)
        for error in failed.values():
            raise error
        return found.get(0, self.no_frames())

    def receive(self, chunk: Float[ndarray, " N"], partner: Float[ndarray, " M"] | None) -> None:
        """Check and keep the next samples."""
        if self._ended:
            raise InputError("sound: the stream has ended; a new one should be begun, got more sound")
        for name, sound in (("sound", chunk), ("partner", partner)):
            if sound is not None and not np.isfinite(sound).all():
                raise InputError(f"{name}: samples should be finite numbers, got NaN or infinite ones")
        if self._samples + len(chunk) > LONGEST_S * SAMPLE_RATE:
            raise InputError(f"sound: a stream should last at most {LONGEST_S:.0f} s, got more")
        self._receive_partner(chunk, partner)
        self._samples += len(chunk)
        self.prosody.receive(chunk)

    def _receive_partner(self, chunk: Float[ndarray, " N"], partner: Float[ndarray, " M"] | None) -> None:
        """Take the partner's sound for a chunk."""
        count = len(chunk)
        given = 0 if partner is None else len(partner)
        if partner is not None and given != count:
            raise InputError(f"partner: should have as many samples as the sound, {count}, got {given}")
        if (self._samples or self._nods) and (partner is None) != (self._nods is None):
            raise InputError(f"partner: should come with every chunk of a stream or with none, got {given} samples")
        if partner is not None:
            self._nods = self._nods or self.model.live_nods(self._seed)
            self._nods.push(partner)
            self._listening.push(chunk, partner)

    def add_steps(self, trajectory: GazeTrajectory) -> GazeTrajectory:
        """Apply the causal steps, frame by frame while a changed liveliness takes effect, and add nods."""
        if self._frames - self._changed_frame > RAMP_S * self.model.fps:
            return self._add_nods(self.model.apply_steps(trajectory, self._controls.state_liveliness))
        parts = [
            self.model.apply_steps(
                GazeTrajectory(self.model.fps, trajectory.head[[frame]], trajectory.gaze_in_space_rad[[frame]], ()),
                self._liveliness(self._frames + frame),
            )
            for frame in range(len(trajectory.head))
        ]
        head, space = (
            np.concatenate([getattr(each, name) for each in parts]) for name in ("head", "gaze_in_space_rad")
        )
        return self._add_nods(GazeTrajectory(self.model.fps, head, space, ()))

    def _add_nods(self, trajectory: GazeTrajectory) -> GazeTrajectory:
        """Turn the head; gaze in space stays."""
        if self._nods is None:
            return trajectory
        frames = np.arange(self._frames, self._frames + len(trajectory.head))
        gain = np.array([[self._liveliness(frame).head] for frame in frames.tolist()])
        nods = self._nods.rotation(frames / self.model.fps, self._controls.nods)
        return replace(trajectory, head=trajectory.head + gain * nods)

    def direct(self, trajectory: GazeTrajectory, offsets_rad: Float[ndarray, "T 2"]) -> DirectedFrames:
        """Direct gaze, add blinks, and hold gaze while the lids are shut."""
        contact = self._listening.contact(len(trajectory.head)) if self._nods else []
        gain = self._controls.liveliness.gaze
        trajectory = self._gaze.direct(trajectory, self._controls.gaze, gain, contact, offsets_rad)
        first = self._frames
        self._frames += len(trajectory.head)
        times_s = np.arange(first, self._frames) / self.model.fps
        closure = self._closure(times_s)
        space = hold_frames(trajectory.gaze_in_space_rad, closure >= SHUT_CLOSURE, self._held_gaze)
        self._held_gaze = space[-1].copy()
        return DirectedFrames(first, trajectory.head, space, closure, emotion_lid_closure(self._styles, times_s))

    def _liveliness(self, frame: int) -> Liveliness:
        """Liveliness at a frame: the last change takes effect with minimum jerk."""
        done = float(eye_head.minimum_jerk(np.array((frame - self._changed_frame + 1) / (RAMP_S * self.model.fps))))
        before, after = self._before, self._controls.state_liveliness
        head, gaze = (
            (1.0 - done) * old + done * new for old, new in ((before.head, after.head), (before.gaze, after.gaze))
        )
        return replace(after, head=head, gaze=gaze)

    def _closure(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """Lid closure at each time; blinks that are over are dropped."""
        while self._blinks and self._blinks[-1].onset_s <= times_s[-1] and (later := [*islice(self._later_blinks, 1)]):
            self._blinks += later
        while self._blinks and blinks.end_s(self._blinks[0]) < times_s[0]:
            self._blinks.popleft()
        return blinks.blink_closure([blink for blink in self._blinks if blink.onset_s <= times_s[-1]], times_s)

    def no_frames(self) -> StreamFrames:
        """An empty part of the stream."""
        shapes = len(self.model.face.generator.basis.expression_names)
        parts = [np.zeros((0, *shape)) for shape in ((3,), (2, 3), (2,), (3,), (shapes,))]
        return StreamFrames(self._frames, *parts)


def push_together(given: Sequence[StreamSound]) -> list[StreamFrames | Exception]:
    """`LiveStream.push` for several streams of one model in one step.

    A stream gives what it gives alone, to rounding (1e-5). One that fails has the error as its result, and has ended.
    """
    failed: dict[int, Exception] = {}
    alone(lambda each: each.stream.receive(each.chunk, each.partner), dict(enumerate(given)), failed)
    parts: dict[int, list[GeneratedFrames]] = {row: [] for row in range(len(given)) if row not in failed}
    while due := {row: given[row].stream for row in parts if row not in failed and given[row].stream.prosody.has_block}:
        features = together(lambda each: StreamingProsody.next_blocks([one.prosody for one in each]), due, failed)
        moved = together(_move, {row: (due[row], found) for row, found in features.items()}, failed)
        for row, found in moved.items():
            parts[row].append(found)
    generated = {
        row: (given[row].stream, GeneratedFrames.concat(found, given[row].stream.model.face.generator.basis.numbers))
        for row, found in parts.items()
        if row not in failed
    }
    frames = _complete(generated, failed)
    nothing = {row: each.stream.no_frames() for row, each in enumerate(given)}
    return [*(nothing | frames | failed).values()]


def alone(stage: Callable[[Any], Any], values: Mapping[int, Any], failed: dict[int, Exception]) -> dict[int, Any]:
    """What a stage makes of each value; rows that fail are noted."""
    found = {}
    for row, value in values.items():
        try:
            found[row] = stage(value)
        except Exception as error:
            failed[row] = error
    return found


def together(
    stage: Callable[[list[Any]], list[Any]], values: Mapping[int, Any], failed: dict[int, Exception]
) -> dict[int, Any]:
    """What a stage makes of all values at once or, if that fails, of each alone."""
    try:
        return dict(zip(values, stage([*values.values()]), strict=True)) if values else {}
    except Exception:
        return alone(lambda value: stage([value])[0], values, failed)


def _move(given: list[tuple[LiveStream, Float[ndarray, "T C"]]]) -> list[GeneratedFrames]:
    """Head, gaze and face for the next features of each stream."""
    streams, features = zip(*given, strict=True)
    model = streams[0].model
    embedding, face_embedding = _embeddings(model, np.stack(features))
    steps = model.motion_streams.step([each.motion for each in streams], embedding)
    heard = model.face.streams.listen([each.face for each in streams], face_embedding)
    styles = [
        stream.style_vectors(stream.generated, step.motion.head.shape[1])
        for stream, step in zip(streams, steps, strict=True)
    ]
    faces = model.face.streams.step(heard, styles)
    for stream, step, face in zip(streams, steps, faces, strict=True):
        stream.motion, stream.face = step.state, face.state
        stream.generated += len(face.face)
    return [GeneratedFrames(step.motion, face.face) for step, face in zip(steps, faces, strict=True)]


def _embeddings(model: LiveModel, features: Float[ndarray, "B T D"]) -> list[Float[Tensor, "B T _C"]]:
    """What the networks of motion and of the face take of speech features."""
    networks = (model.network, model.face.generator.network)
    return [each.speech.embedding_of(features, model.features.channels) for each in networks]


def _complete(
    generated: Mapping[int, tuple[LiveStream, GeneratedFrames]], failed: dict[int, Exception]
) -> dict[int, StreamFrames]:
    """Frames of what was generated, if anything, with all that follows: steps, nods, direction of gaze, lids."""
    streams = {row: stream for row, (stream, found) in generated.items() if len(found)}
    moved = {row: (streams[row], generated[row][1].motion) for row in streams}
    plain = together(_trajectories, moved, failed)
    pairs = {row: (streams[row], each) for row, each in plain.items()}
    made = alone(lambda pair: pair[0].add_steps(pair[1]), pairs, failed)
    offsets = together(_offsets, made, failed)
    aimed = {row: (streams[row], made[row], offset) for row, offset in offsets.items()}
    directed = alone(lambda each: each[0].direct(*each[1:]), aimed, failed)
    return together(_frames, {row: (*generated[row], each) for row, each in directed.items()}, failed)


def _trajectories(generated: list[tuple[LiveStream, GeneratedMotion]]) -> list[GazeTrajectory]:
    """Generated motion as gaze in space."""
    head = np.concatenate([motion.head[0].numpy() for _, motion in generated]).astype(np.float64)
    gaze = np.concatenate([motion.gaze[0].numpy() for _, motion in generated]).astype(np.float64)
    space, starts = rotation.gaze_in_space(head, gaze), _starts([motion.head.shape[1] for _, motion in generated])
    pairs = zip(np.split(head, starts), np.split(space, starts), strict=True)
    return [GazeTrajectory(generated[0][0].model.fps, *pair, ()) for pair in pairs]


def _offsets(trajectories: list[GazeTrajectory]) -> list[Float[ndarray, "T 2"]]:
    """`listener_offsets` of each."""
    head, space = (
        np.concatenate([getattr(each, name) for each in trajectories]) for name in ("head", "gaze_in_space_rad")
    )
    return np.split(listener_offsets(head, space), _starts([len(each.head) for each in trajectories]))


def _frames(shown: list[tuple[LiveStream, GeneratedFrames, DirectedFrames]]) -> list[StreamFrames]:
    """Frames with eye-in-head, within the range of the eyes, and with lids and face."""
    directed = [each for _, _, each in shown]
    head, space = (np.concatenate([getattr(each, name) for each in directed]) for name in ("head", "gaze_in_space_rad"))
    eye = eye_head.clamp_to_eye_range(rotation.eye_in_head(head, space))
    closure, raised = (
        np.concatenate([getattr(each, name) for each in directed]) for name in ("closure", "emotion_closure")
    )
    blinks_alone = np.repeat(closure[:, None], 2, axis=1)
    face = np.concatenate([each.face for _, each, _ in shown]).astype(np.float64)
    names = shown[0][0].model.face.generator.basis.expression_names
    expression = fade_around_eyes(face[:, :-JAW_DIM], names, blinks_alone)
    columns = (head, eye, with_emotion(blinks_alone, raised), face[:, -JAW_DIM:], expression)
    starts = _starts([len(each.head) for each in directed])
    parts = zip(*(np.split(each, starts) for each in columns), strict=True)
    return [StreamFrames(each.first, *part) for each, part in zip(directed, parts, strict=True)]


def _starts(lengths: Sequence[int]) -> list[int]:
    """Where the parts of these lengths begin, without the first."""
    return [*accumulate(lengths)][:-1]
