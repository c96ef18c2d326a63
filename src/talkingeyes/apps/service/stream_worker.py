"""Worker for live streams: many streams of one model in one process, from sound to rows of poses.

Messages: ("open", key, request), ("push", key, sound), ("finish", key), ("close", key). Sound is 16-bit little-endian
PCM of 16 kHz. Rows are those of apps/viewer/pose_encoding.py, preceded by the index of the first frame (4 bytes).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.animation.streaming import LiveControls, LiveModel, LiveStream, StreamFrames
from talkingeyes.apps.service.animation_request import AnimationRequest, PoseChunk
from talkingeyes.apps.viewer.pose_encoding import pose_rows
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head

FIRST_FRAME = struct.Struct("<I")
FULL_SCALE = 32768.0


def stream_worker(model: str) -> Callable[[Any], Any]:
    """The message handler for streams of a model."""
    import torch

    torch.set_num_threads(1)
    live, head = LiveModel.load(Path(model)), anny_head()
    streams: dict[str, LiveStream] = {}

    def pose_chunk(frames: StreamFrames) -> PoseChunk:
        if not len(frames):
            return PoseChunk(0, b"")
        motion = to_forward_axes(Motion.of(live.fps, frames.head, frames.gaze, lid=frames.lid))
        return PoseChunk(len(frames), FIRST_FRAME.pack(frames.first) + pose_rows(head, motion).tobytes())

    def open_stream(key: str, animation_request: AnimationRequest) -> dict[str, float]:
        streams[key] = live.stream(
            animation_request.seed, LiveControls(animation_request.blinks, animation_request.liveliness)
        )
        still = Motion.of(live.fps, np.zeros((1, 3)), np.zeros((1, 2, 3)))
        return {"fps": live.fps, "latency_s": round(live.latency_s, 4), "columns": pose_rows(head, still).shape[1]}

    handlers: dict[str, Callable[..., Any]] = {
        "open": open_stream,
        "push": lambda key, sound: pose_chunk(streams[key].push(np.frombuffer(sound, "<i2") / np.float32(FULL_SCALE))),
        "finish": lambda key: pose_chunk(streams[key].finish()),
        "close": lambda key: streams.pop(key, None) and None,
    }
    return lambda message: handlers[message[0]](*message[1:])
