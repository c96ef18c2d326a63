"""Worker for live streams: many streams of one model in one process, from sound to rows of poses.

A message is a list of requests of different streams, which take one step together: (kind, key, content) with the kinds
"push" (sound), "open" (a request), "set" (changes), "finish" and "close". Sound is 16-bit little-endian PCM of 16 kHz,
of two channels the samples in turn. Rows are those of apps/viewer/pose_encoding.py, preceded by the index of the first
frame (4 bytes); or frames are JSON (frame_encoding.py). A request that fails ends its own stream alone.
"""

from __future__ import annotations

import logging
import struct
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.animation.live_stream import LiveStream, StreamFrames, StreamSound, alone, push_together, together
from talkingeyes.animation.streaming import LiveControls, LiveModel
from talkingeyes.apps.service.animation_request import PoseChunk, StepReply, StreamChanges, StreamRequest
from talkingeyes.apps.service.frame_encoding import json_frames
from talkingeyes.apps.service.worker_pool import WorkerFailedError
from talkingeyes.apps.viewer.pose_encoding import pose_rows
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.looks import dressed_head
from talkingeyes.head.model import HeadModel

FIRST_FRAME = struct.Struct("<I")
FULL_SCALE = 32768.0
LOG = logging.getLogger(__name__)


@dataclass
class OpenStream:
    """A stream, and its request with all changes so far."""

    stream: LiveStream
    request: StreamRequest


class StreamWorker:
    """The streams of a model in this process, shown by a head."""

    def __init__(self, live: LiveModel, head: HeadModel) -> None:
        self._live, self._head = live, head
        self._streams: dict[str, OpenStream] = {}

    def step(self, requests: Sequence[tuple[str, str, Any]]) -> StepReply:
        """Answer requests of different streams."""
        begun = time.monotonic()
        failed: dict[int, Exception] = {}
        pushed = {row: content[1:] for row, content in enumerate(requests) if content[0] == "push"}
        sounds = alone(lambda each: self._sound(*each), pushed, failed)
        frames: dict[int, StreamFrames] = {}
        for row, found in zip(sounds, push_together([*sounds.values()]), strict=True):
            if isinstance(found, Exception):
                failed[row] = found
            else:
                frames[row] = found
        frames |= alone(
            self._finish, {row: key for row, (kind, key, _) in enumerate(requests) if kind == "finish"}, failed
        )
        answers: dict[int, Any] = {row: PoseChunk(0, b"") for row, found in frames.items() if not len(found)}
        shown = {row: (self._format(requests[row][1]), found) for row, found in frames.items() if len(found)}
        answers |= together(self._pose_chunks, shown, failed)
        changed = {row: each[1:] for row, each in enumerate(requests) if each[0] == "set"}
        answers |= alone(lambda each: self._change(*each), changed, failed)
        step_s = time.monotonic() - begun  # an opening costs once, a stream as long as it runs
        opened = {row: each[1:] for row, each in enumerate(requests) if each[0] == "open"}
        answers |= alone(lambda each: self._open(*each), opened, failed)
        ended = {key for row, (kind, key, _) in enumerate(requests) if kind == "close" or row in failed}
        for key in ended:
            self._streams.pop(key, None)
        answers |= {row: _reported(error) for row, error in failed.items()}
        return StepReply(step_s, [answers.get(row) for row in range(len(requests))])

    def _format(self, key: str) -> str:
        return self._streams[key].request.format

    def _open(self, key: str, request: StreamRequest) -> dict[str, Any]:
        controls = LiveControls(request.blinks, request.liveliness, request.gaze, request.face)
        self._streams[key] = OpenStream(self._live.stream(request.seed, controls), request)
        live = self._live
        begun = {"fps": live.fps, "latency_s": round(live.latency_s, 4), "format": request.format}
        if request.format == "json":
            return begun
        still = Motion.of(live.fps, np.zeros((1, 3)), np.zeros((1, 2, 3)))
        return {**begun, "columns": pose_rows(self._head, still).shape[1]}

    def _sound(self, key: str, sound: bytes) -> StreamSound:
        each = self._streams[key]
        samples = np.frombuffer(sound, "<i2") / np.float32(FULL_SCALE)
        return StreamSound(each.stream, *samples.reshape(-1, each.request.channels).T)

    def _finish(self, key: str) -> StreamFrames:
        return self._streams[key].stream.finish()

    def _change(self, key: str, changes: StreamChanges) -> int:
        """Returns the number of the first frame that is changed."""
        each = self._streams[key]
        each.request = changes.applied_to(each.request)
        return each.stream.change(each.request.liveliness, each.request.gaze, each.request.face)

    def _pose_chunks(self, shown: list[tuple[str, StreamFrames]]) -> list[PoseChunk]:
        """The frames of all streams, whose rows are computed together."""
        motion = to_forward_axes(self._live.motion_of(StreamFrames.concat([each for _, each in shown])))
        rows = pose_rows(self._head, motion)
        stops = np.cumsum([len(each) for _, each in shown]).tolist()
        chunks = []
        for (format, each), stop in zip(shown, stops, strict=True):
            start = stop - len(each)
            if format == "json":
                chunks.append(PoseChunk(len(each), json_frames(motion.cut(start, stop), each.first)))
            else:
                chunks.append(PoseChunk(len(each), FIRST_FRAME.pack(each.first) + rows[start:stop].tobytes()))
        return chunks


def _reported(error: Exception) -> InputError | WorkerFailedError:
    """The error for a client; the log has where an internal one arose, without what the client sent."""
    if isinstance(error, InputError):
        return error
    if isinstance(error, KeyError):
        return WorkerFailedError("the stream has ended, as its worker process did")
    place = traceback.extract_tb(error.__traceback__)[-1]
    LOG.error("a stream ended by %s at %s:%d", type(error).__name__, Path(place.filename).name, place.lineno or 0)
    return WorkerFailedError("an internal error ended this stream")


def stream_worker(model: str, look: str) -> Callable[[Any], StepReply]:
    """The message handler for streams of a model, for the open head with a look."""
    import torch

    torch.set_num_threads(1)
    return StreamWorker(LiveModel.load(Path(model)), dressed_head(look)).step
