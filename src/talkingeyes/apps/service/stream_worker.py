"""Worker for live streams: many streams of one model in one process, from sound to rows of poses.

Messages: ("open", key, request), ("push", key, sound), ("set", key, changes), ("finish", key), ("close", key). Sound is
16-bit little-endian PCM of 16 kHz, of two channels the samples in turn. Rows are those of apps/viewer/pose_encoding.py,
preceded by the index of the first frame (4 bytes); or frames are JSON (frame_encoding.py).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.animation.streaming import LiveControls, LiveModel, LiveStream, StreamFrames
from talkingeyes.apps.service.animation_request import PoseChunk, StreamChanges, StreamRequest
from talkingeyes.apps.service.frame_encoding import json_frames
from talkingeyes.apps.viewer.pose_encoding import pose_rows
from talkingeyes.core.motion import Motion
from talkingeyes.head.looks import dressed_head

FIRST_FRAME = struct.Struct("<I")
FULL_SCALE = 32768.0


@dataclass
class OpenStream:
    """A stream, and its request with all changes so far."""

    stream: LiveStream
    request: StreamRequest


def stream_worker(model: str, look: str) -> Callable[[Any], Any]:
    """The message handler for streams of a model, for the open head with a look."""
    import torch

    torch.set_num_threads(1)
    live, head = LiveModel.load(Path(model)), dressed_head(look)
    streams: dict[str, OpenStream] = {}

    def pose_chunk(frames: StreamFrames, format: str) -> PoseChunk:
        if not len(frames):
            return PoseChunk(0, b"")
        motion = to_forward_axes(Motion.of(live.fps, frames.head, frames.gaze, lid=frames.lid))
        if format == "json":
            return PoseChunk(len(frames), json_frames(motion, frames.first))
        return PoseChunk(len(frames), FIRST_FRAME.pack(frames.first) + pose_rows(head, motion).tobytes())

    def open_stream(key: str, request: StreamRequest) -> dict[str, Any]:
        controls = LiveControls(request.blinks, request.liveliness, request.gaze)
        streams[key] = OpenStream(live.stream(request.seed, controls), request)
        begun = {"fps": live.fps, "latency_s": round(live.latency_s, 4), "format": request.format}
        if request.format == "json":
            return begun
        still = Motion.of(live.fps, np.zeros((1, 3)), np.zeros((1, 2, 3)))
        return {**begun, "columns": pose_rows(head, still).shape[1]}

    def push(key: str, sound: bytes) -> PoseChunk:
        each = streams[key]
        samples = np.frombuffer(sound, "<i2") / np.float32(FULL_SCALE)
        return pose_chunk(each.stream.push(*samples.reshape(-1, each.request.channels).T), each.request.format)

    def change(key: str, changes: StreamChanges) -> int:
        """Returns the number of the first frame that is changed."""
        each = streams[key]
        each.request = changes.applied_to(each.request)
        return each.stream.change(each.request.liveliness, each.request.gaze)

    handlers: dict[str, Callable[..., Any]] = {
        "open": open_stream,
        "push": push,
        "set": change,
        "finish": lambda key: pose_chunk(streams[key].stream.finish(), streams[key].request.format),
        "close": lambda key: streams.pop(key, None) and None,
    }
    return lambda message: handlers[message[0]](*message[1:])
