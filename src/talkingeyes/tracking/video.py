"""Frames of a video by their time stamps: any container, codec, rate, size and rotation flag (PyAV).

Nothing is kept: a frame is decoded, given out and forgotten, so memory does not grow with the length of the video. Bad
packets, as at the end of a truncated file, are skipped and counted.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from talkingeyes.core.errors import InputError

SUFFIXES = (".mp4", ".mkv", ".webm", ".mov", ".avi", ".m4v", ".mpg", ".mpeg", ".ts", ".flv", ".wmv", ".ogv", ".3gp")


@dataclass(frozen=True)
class Frame:
    """A picture as it should be looked at (turned as the file says), and when: seconds on the file's own clock."""

    time_s: float
    image: UInt8[ndarray, "H W 3"]


@dataclass(frozen=True)
class VideoInfo:
    """What a container says of itself; `seconds` is 0 where it does not know."""

    seconds: float
    fps: float
    width: int
    height: int
    has_sound: bool


def probe_video(path: Path) -> VideoInfo:
    """What the container says. Raises InputError if it is no video."""
    with open_video(path) as container:
        stream = container.streams.video[0]
        seconds = float(container.duration / 1e6) if container.duration else 0.0
        size = stream.codec_context
        return VideoInfo(
            seconds, float(stream.average_rate or 0), size.width, size.height, bool(container.streams.audio)
        )


def frames(path: Path, max_fps: float, start_s: float = -np.inf) -> Iterator[Frame]:
    """Frames from a time on, at most `max_fps` a second, in the order of their time stamps.

    A stamp that does not grow, as in damaged streams, takes its frame out. Raises InputError if it is no video, or if
    not one frame can be decoded.
    """
    decoded, last_s = 0, -np.inf
    with open_video(path) as container:
        for frame in _decoded(container):
            decoded += 1
            if frame.time is None or frame.time < start_s or frame.time < last_s + 0.98 / max_fps:
                continue
            last_s = float(frame.time)
            yield Frame(last_s, upright(frame.to_ndarray(format="rgb24"), frame.rotation))
    if not decoded:
        raise InputError(f"{path.name}: should hold frames that can be decoded, got none")


def upright(image: UInt8[ndarray, "H W 3"], rotation_deg: int) -> UInt8[ndarray, "h w 3"]:
    """The picture turned counter-clockwise by a display rotation, of which quarter turns are known."""
    return np.ascontiguousarray(np.rot90(image, k=round(rotation_deg / 90) % 4))


@contextlib.contextmanager
def open_video(path: Path) -> Iterator[Any]:
    """The container of a file with a video stream; nothing outside the file is ever read."""
    import av

    try:
        container = av.open(str(path), options={"protocol_whitelist": "file"})
    except (av.FFmpegError, OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or type(error).__name__
        raise InputError(f"{path.name}: should be a whole video file, got one that cannot be opened ({what})") from None
    with container:
        if not container.streams.video:
            raise InputError(f"{path.name}: should be a video, got a file without pictures")
        yield container


def _decoded(container: Any) -> Iterator[Any]:
    import av

    stream = container.streams.video[0]
    stream.thread_count = 1  # work is parallel over files
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except StopIteration:
            return
        except av.FFmpegError:  # the file ends in the middle of a packet
            return
        with contextlib.suppress(av.FFmpegError):
            yield from packet.decode()
