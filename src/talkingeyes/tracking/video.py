"""Frames of a video by time stamp, for any container, codec, rate, size and rotation flag (PyAV).

Frames are decoded and emitted one by one, so memory does not grow with the length of the video. Bad packets, as at the
end of a truncated file, are skipped.
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
    """An upright image (rotated as the file specifies) and its time: seconds on the file's clock."""

    time_s: float
    image: UInt8[ndarray, "H W 3"]


@dataclass(frozen=True)
class VideoInfo:
    """Metadata of a container; `seconds` is 0 if unknown."""

    seconds: float
    fps: float
    width: int
    height: int
    has_sound: bool


def probe_video(path: Path) -> VideoInfo:
    """Read the metadata of a container. Raises InputError if it is not a video."""
    with open_video(path) as container:
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise InputError(f"{path}: should hold a video in a known coding")
        seconds = float(container.duration / 1e6) if container.duration else 0.0
        size = stream.codec_context
        return VideoInfo(
            seconds, float(stream.average_rate or 0), size.width, size.height, bool(container.streams.audio)
        )


def read_frames(path: Path, max_fps: float, start_s: float = -np.inf) -> Iterator[Frame]:
    """Frames from a time on, at most `max_fps` per second, in the order of their time stamps.

    Frames whose time stamp does not increase, as in damaged streams, are dropped. Raises InputError if the file is not
    a video, or if no frame can be decoded.
    """
    decoded, last_s = 0, -np.inf
    with open_video(path) as container:
        for frame in _decoded(container):
            decoded += 1
            if frame.time is None or frame.time < start_s or frame.time < last_s + 0.98 / max_fps:
                continue
            last_s = float(frame.time)
            yield Frame(last_s, rotate_upright(frame.to_ndarray(format="rgb24"), frame.rotation))
    if not decoded:
        raise InputError(f"{path.name}: should hold frames that can be decoded, got none")


def rotate_upright(image: UInt8[ndarray, "H W 3"], rotation_deg: int) -> UInt8[ndarray, "h w 3"]:
    """The image rotated counter-clockwise by a display rotation, in quarter turns."""
    return np.ascontiguousarray(np.rot90(image, k=round(rotation_deg / 90) % 4))


@contextlib.contextmanager
def open_video(path: Path) -> Iterator[Any]:
    """Open a file with a video stream, without access to anything outside the file. Raises InputError."""
    import av

    try:
        container = av.open(str(path), options={"protocol_whitelist": "file"})
    except (av.FFmpegError, OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or type(error).__name__
        raise InputError(
            f"{path.name}: should be an intact video file, got one that cannot be opened ({what})"
        ) from None
    with container:
        if not container.streams.video:
            raise InputError(f"{path.name}: should be a video, got a file without pictures")
        yield container


def _decoded(container: Any) -> Iterator[Any]:
    import av

    stream = container.streams.video[0]
    stream.thread_count = 1  # parallel over files instead
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except StopIteration:
            return
        except av.FFmpegError:  # truncated file
            return
        with contextlib.suppress(av.FFmpegError):
            yield from packet.decode()
