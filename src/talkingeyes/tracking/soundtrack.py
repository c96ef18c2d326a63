"""The sound of a video on the clock of its frames: 16 kHz mono, on disk while shots are extracted.

It is decoded block by block into a temporary file; twice, where its channels cancel each other. Memory therefore does
not grow, and any segment can be read without relying on the container's index. Gaps in time stamps become silence, so
lips and voice stay synchronous.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE, ChannelLevels
from talkingeyes.tracking.video import open_video

MAX_JITTER_S = 0.1  # larger deviations of time stamps are gaps


@dataclass(frozen=True)
class Soundtrack:
    """Samples from `start_s` on; empty if the video has no sound."""

    samples: Float[ndarray, " N"]
    start_s: float

    def cut(self, start_s: float, count: int) -> Float[ndarray, " C"]:
        """`count` samples from a time on; silence outside the track."""
        first = round((start_s - self.start_s) * SAMPLE_RATE)
        piece = np.zeros(count, np.float32)
        begin, end = max(first, 0), min(first + count, len(self.samples))
        if end > begin:
            piece[begin - first : end - first] = self.samples[begin:end]
        return piece


@contextlib.contextmanager
def open_soundtrack(path: Path) -> Iterator[Soundtrack]:
    """The first sound stream of a video; its temporary file is deleted with the context."""
    with tempfile.TemporaryFile() as file:
        levels = ChannelLevels()
        start_s = _decode(path, file, levels, mix=True)
        if levels.cancelled:
            file.seek(0)
            file.truncate()
            start_s = _decode(path, file, levels, mix=False)
        size = file.tell() // 4
        yield Soundtrack(np.memmap(file, np.float32, "r", shape=(size,)) if size else np.zeros(0, np.float32), start_s)


def _decode(path: Path, file: IO[bytes], levels: ChannelLevels, *, mix: bool) -> float:
    """Write all samples, mixed or of the loudest channel; return the time of the first."""
    import av

    resampler = av.AudioResampler(format="fltp", layout="mono" if mix else None, rate=SAMPLE_RATE)
    as_floats = av.AudioResampler(format="fltp")
    start_s: float | None = None
    heard_s = 0.0  # duration received so far

    def write(frame: Any) -> None:
        for part in resampler.resample(frame):
            samples = np.nan_to_num(part.to_ndarray())
            file.write((samples[0] if mix else levels.loudest(samples.T)).astype(np.float32).tobytes())

    with open_video(path) as container:
        for frame in _frames(container) if container.streams.audio else ():
            start_s = frame.time if start_s is None else start_s
            missing_s = frame.time - start_s - heard_s
            if missing_s > MAX_JITTER_S:
                file.write(np.zeros(round(missing_s * SAMPLE_RATE), np.float32).tobytes())
                heard_s += missing_s
            heard_s += frame.samples / frame.sample_rate
            frame.pts = None  # otherwise the resampler would stretch the sound between time stamps
            for part in as_floats.resample(frame) if mix else ():
                levels.mixed(np.nan_to_num(part.to_ndarray()).T)
            write(frame)
        if start_s is not None:
            write(None)
    file.flush()
    return start_s or 0.0


def _frames(container: Any) -> Iterator[Any]:
    import av

    packets = container.demux(container.streams.audio[0])
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av.FFmpegError):
            return
        with contextlib.suppress(av.FFmpegError):
            yield from (frame for frame in packet.decode() if frame.time is not None)
