"""Reads speech from files of any rate, channels and format, detected by content, as 16 kHz mono float32.

Channels are mixed; where that cancels them (opposite phase), the loudest is taken. WAV whose header was never completed
(a stream, a crash) is read to its end; odd chunks may lack their pad byte. Supports the formats of libsndfile (wav,
flac, ogg, mp3) and of PyAV (m4a, video with sound, raw g722 by suffix). Files are read, mixed and resampled block by
block, so a sound that is too long is rejected before it fills memory.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import soundfile
import soxr
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.containers import reading
from talkingeyes.core.errors import InputError

SAMPLE_RATE = 16_000
SHORTEST_S = 0.3
LONGEST_S = 3600.0
SILENT_DBFS = -60.0  # a sound is silent if none of its 50 ms blocks is louder (RMS around its mean)
BLOCK_S = 0.05
READ_FRAMES = 1 << 18
CANCELLED = 0.2  # of the energy that a mix of unrelated channels has
LONG_WAVS = (b"RF64", b"BW64")  # WAV with a chunk of sizes in 64 bits, the first
MAX_START_BYTES = 1 << 24  # of a WAV, before its sound
SOUND_CHUNKS, CHUNK_NAME = (b"fmt ", b"data"), re.compile(rb"[A-Za-z][\w ]{3}")
FORMAT_OF_SUFFIX = {".g722": "g722"}  # raw streams, which content does not identify


@dataclass(frozen=True)
class AudioStream:
    """An open sound: its rate, and its blocks as (frames, channels)."""

    rate: int
    blocks: Iterator[Float[ndarray, "N C"]]


def frame_count(samples: int, fps: float) -> int:
    """Number of motion frames of a 16 kHz sound: frame t is the state at t / fps."""
    return int(samples * fps / SAMPLE_RATE + 1e-6)


def read_speech(path: Path | str) -> Float[ndarray, " N"]:
    """Read a file as 16 kHz mono float32, 0.3 s to an hour.

    Raises InputError (one line) if the file is missing, empty, undecodable, damaged, silent, too short, too long, or
    contains NaN.
    """
    path, levels = Path(path), ChannelLevels()
    sound = _read(path, levels.mixed)
    return _checked(path, _read(path, levels.loudest) if levels.cancelled else sound)


def read_dialogue(path: Path | str) -> tuple[Float[ndarray, " N"], Float[ndarray, " N"]]:
    """Read the two channels of a file, one per person, as `read_speech` does.

    Raises InputError as it does, and if there are not two channels.
    """
    path = Path(path)
    first, second = (_checked(path, _read(path, partial(_person, path, channel))) for channel in (0, 1))
    return first, second


class ChannelLevels:
    """The energy of each channel, and of their mix, over the blocks that are mixed."""

    def __init__(self) -> None:
        self._channels, self._mix = np.zeros(1), 0.0

    def mixed(self, block: Float[ndarray, "N C"]) -> Float[ndarray, " N"]:
        """The mean of the channels."""
        mix = block.mean(axis=1, dtype=np.float32)
        self._channels = self._channels + len(block) * block.var(axis=0, dtype=np.float64)
        self._mix += len(block) * float(mix.var(dtype=np.float64))
        return np.asarray(mix)

    @property
    def cancelled(self) -> bool:
        """Whether the channels cancel each other, as in opposite phase."""
        return bool(self._mix < CANCELLED * self._channels.sum() / len(self._channels) ** 2)

    def loudest(self, block: Float[ndarray, "N C"]) -> Float[ndarray, " N"]:
        """The channel with the most energy."""
        return block[:, self._channels.argmax()]


def _person(path: Path, channel: int, block: Float[ndarray, "N C"]) -> Float[ndarray, " N"]:
    if block.shape[1] != 2:
        raise InputError(f"{path}: a dialogue should have two channels, a person each, got {block.shape[1]}")
    return block[:, channel]


def _checked(path: Path, sound: Float[ndarray, " N"]) -> Float[ndarray, " N"]:
    """Check that the sound is long and loud enough."""
    if len(sound) < SHORTEST_S * SAMPLE_RATE:
        raise InputError(f"{path}: speech should last at least {SHORTEST_S} s, got {len(sound) / SAMPLE_RATE:.3f} s")
    loudest = loudest_dbfs(sound)
    if loudest < SILENT_DBFS:
        raise InputError(
            f"{path}: silent; some part should be louder than {SILENT_DBFS:.0f} dBFS, got {loudest:.0f} dBFS at most"
        )
    return sound


def block_levels_dbfs(sound: Float[ndarray, " N"]) -> Float[ndarray, " M"]:
    """RMS around the mean of each whole 50 ms block (a shorter sound is one block), in dBFS, at least -200."""
    size = min(len(sound), round(BLOCK_S * SAMPLE_RATE))
    blocks = np.reshape(sound[: len(sound) // size * size], (-1, size))
    parts = [blocks[first : first + 1000].std(axis=1, dtype=np.float64) for first in range(0, len(blocks), 1000)]
    return np.asarray(20 * np.log10(np.maximum(np.concatenate(parts), 1e-10)))


def loudest_dbfs(sound: Float[ndarray, " N"]) -> float:
    """Level of the loudest 50 ms block, without the first and last if there are others (resampling rings there)."""
    levels = block_levels_dbfs(sound)
    return float(levels[1:-1].max() if len(levels) > 2 else levels.max())


def _opened(path: Path) -> IO[bytes]:
    if path.is_dir():
        raise InputError(f"{path}: is a folder; speech should be a sound file (wav, flac, ogg, mp3, m4a)")
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(f"{path}: cannot be opened ({error.strerror}); speech should be a sound file") from None
    except ValueError as error:  # a name with a NUL character
        raise InputError(f"{str(path)!r}: not a file name ({error})") from None
    if not file.read(1):
        file.close()
        raise InputError(f"{path}: empty; speech should be a sound file (wav, flac, ogg, mp3, m4a)")
    return file


@contextlib.contextmanager
def _open_stream(path: Path, file: IO[bytes]) -> Iterator[AudioStream]:
    file.seek(0)
    start = _mended_start(file)
    try:
        with soundfile.SoundFile(_AnonymousFile(file, *start)) as sound:
            if sound.frames:  # or the header of a WAV counts none, and FFmpeg reads to its end
                yield AudioStream(sound.samplerate, _libsndfile_blocks(path, sound))
                return
    except soundfile.LibsndfileError:
        pass
    import av

    try:
        container = av.open(
            _AnonymousFile(file, *start),
            format=FORMAT_OF_SUFFIX.get(path.suffix.lower()),
            options={"protocol_whitelist": "none"},
        )
    except (av.FFmpegError, ValueError):
        raise InputError(f"{path}: not a sound that can be decoded; should be wav, flac, ogg, mp3 or m4a") from None
    with container:
        if not container.streams.audio:
            raise InputError(f"{path}: holds no sound; should be wav, flac, ogg, mp3, m4a or a video with sound")
        rate = int(container.streams.audio[0].codec_context.sample_rate)
        yield AudioStream(rate, _av_blocks(path, container, rate))


class _AnonymousFile:
    """A file without its name, so that readers detect the format from content alone; `start` is read for its first
    `replaced` bytes."""

    def __init__(self, file: IO[bytes], start: bytes = b"", replaced: int = 0) -> None:
        self._file, self._start, self._position = file, start, 0
        self._longer = len(start) - replaced

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        size = os.fstat(self._file.fileno()).st_size + self._longer
        self._position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: size}[whence]
        return self._position

    def read(self, size: int = -1) -> bytes:
        rest = max(self._position, len(self._start))
        first = self._start[self._position :] if size < 0 else self._start[self._position : self._position + size]
        self._file.seek(rest - self._longer)
        content = first + self._file.read(-1 if size < 0 else size - len(first))
        self._position += len(content)
        return content

    def readinto(self, buffer: Any) -> int:
        content = self.read(len(buffer))
        buffer[: len(content)] = content
        return len(content)


def _mended_start(file: IO[bytes]) -> tuple[bytes, int]:
    """What decoders should read for the first bytes of a file, and for how many.

    A long WAV without its sizes starts as a WAV that ends with the file; odd chunks before the sound get the pad byte
    that some programs leave out.
    """
    start = file.read(12)
    if start[:4] not in (b"RIFF", *LONG_WAVS) or start[8:12] != b"WAVE":
        return b"", 0
    parts, chunk = [start], file.read(8)
    while len(chunk) == 8 and chunk[:4] != b"data":
        (size,) = struct.unpack_from("<I", chunk, 4)
        if file.tell() + size > MAX_START_BYTES:
            break
        body, following = file.read(size), file.read(8)
        if size % 2 and (following[1:5] in SOUND_CHUNKS or not CHUNK_NAME.match(following)):  # padded
            body, following = body + following[:1], following[1:] + file.read(1)
        parts += [chunk, body.ljust(size + size % 2, b"\0")]
        chunk = following
    end = file.tell()
    if start[:4] in LONG_WAVS and len(parts) > 2:
        known = 0 < struct.unpack_from("<Q", parts[2].ljust(16, b"\0"), 8)[0] <= os.fstat(file.fileno()).st_size
        parts[0] = start if known else b"RIFF" + start[4:]
    return b"".join([*parts, chunk]), end


def _libsndfile_blocks(path: Path, sound: soundfile.SoundFile) -> Iterator[Float[ndarray, "N C"]]:
    while True:
        try:
            block = sound.read(READ_FRAMES, dtype="float32", always_2d=True)
        except soundfile.LibsndfileError as error:
            raise InputError(f"{path}: damaged, should be a whole {sound.format} file, got: {error}") from None
        if not len(block):
            return
        yield block


def _av_blocks(path: Path, container: Any, rate: int) -> Iterator[Float[ndarray, "N C"]]:
    """Decoded frames. Single bad packets are skipped, as in truncated streams; raises InputError if most are bad."""
    import av

    resampler = av.AudioResampler(format="fltp", rate=rate)
    good = bad = 0
    for packet in container.demux(audio=0):
        try:
            frames = packet.decode()
        except av.FFmpegError:
            bad += 1
            continue
        for frame in frames:
            good += 1
            for part in resampler.resample(frame):
                yield part.to_ndarray().T
    if bad and bad >= good:
        raise InputError(f"{path}: not a sound that can be decoded; should be wav, flac, ogg, mp3 or m4a")


def _read(path: Path, as_mono: Callable[[Float[ndarray, "N C"]], Float[ndarray, " N"]]) -> Float[ndarray, " N"]:
    """The whole file at 16 kHz; `as_mono` makes one channel of a block."""
    what = "sound; should be wav, flac, ogg, mp3 or m4a"
    with _opened(path) as file, reading(path, what), _open_stream(path, file) as source:
        return _resampled(path, source, as_mono)


def _resampled(
    path: Path, source: AudioStream, as_mono: Callable[[Float[ndarray, "N C"]], Float[ndarray, " N"]]
) -> Float[ndarray, " N"]:
    if source.rate <= 0:
        raise InputError(f"{path}: the sampling rate should be above 0, got {source.rate}")
    stream = soxr.ResampleStream(source.rate, SAMPLE_RATE, 1, dtype="float32", quality="HQ")
    parts, read = [], 0
    for block in source.blocks:
        read += len(block)
        if read > LONGEST_S * source.rate:
            raise InputError(f"{path}: speech should last at most {LONGEST_S:.0f} s (an hour); cut it into parts")
        if not np.isfinite(block).all():
            raise InputError(f"{path}: holds NaN or infinite samples; samples should be finite numbers")
        parts.append(stream.resample_chunk(np.ascontiguousarray(as_mono(block))))
    parts.append(stream.resample_chunk(np.zeros(0, np.float32), last=True))
    return np.concatenate(parts)
