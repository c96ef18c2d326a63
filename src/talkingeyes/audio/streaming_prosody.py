"""Streaming prosody: chunks of sound to log-energy, F0 and voicing of motion frames, and to log-mel energies.

These are channels of an embedding, available for a frame 37 ms after its time: the prosody of every one, preceded by
the log-mel energies of one whose encoder they are. An embedding normalises the level of a sound by all of its loud
syllables. Here the level is estimated from the sound so far (the last 30 s), combined with a default level at the
start. `process_offline` does the same for a complete sound.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.encoder import F0_REFERENCE_HZ, LOUD_PERCENTILE, PROSODY_CHANNELS, EmbedSettings
from talkingeyes.audio.encoder_logmel import LogmelEncoder, LogmelSettings, log_energies
from talkingeyes.audio.prosody import MEDIAN_STEPS, STEP_S, prosody
from talkingeyes.audio.waveform import BLOCK_S, SAMPLE_RATE, SILENT_DBFS, block_levels_dbfs, frame_count
from talkingeyes.core.errors import InputError

STEP_SAMPLES = round(STEP_S * SAMPLE_RATE)
BLOCK_SAMPLES = round(BLOCK_S * SAMPLE_RATE)
WINDOW_BLOCKS = 600  # 30 s
DEFAULT_LEVEL_DBFS = -18.0  # the initial estimate of the level of speech (the median of the default corpus),
DEFAULT_LEVEL_BLOCKS = 40  # and its weight: 2 s of speech


class RunningLevel:
    """Running level of the loud syllables of a sound, in blocks of 50 ms. Silent blocks are ignored."""

    def __init__(self) -> None:
        self._rest = np.zeros(0, np.float32)
        self._blocks_dbfs: deque[float] = deque()  # in the window
        self._audible_dbfs: list[float] = []  # those that are not silent, sorted
        self.levels_dbfs = [DEFAULT_LEVEL_DBFS]  # after 0, 1, 2, ... blocks

    def push(self, chunk: Float[ndarray, " N"]) -> None:
        """Add a chunk."""
        sound = np.concatenate([self._rest, chunk])
        whole = len(sound) // BLOCK_SAMPLES * BLOCK_SAMPLES
        self._rest = sound[whole:]
        for block in sound[:whole].reshape(-1, BLOCK_SAMPLES):
            level = float(block_levels_dbfs(block)[0])
            self._remember(level)
            self.levels_dbfs.append(self._now())

    def _remember(self, level: float) -> None:
        self._blocks_dbfs.append(level)
        if level > SILENT_DBFS:
            insort(self._audible_dbfs, level)
        if len(self._blocks_dbfs) > WINDOW_BLOCKS and (old := self._blocks_dbfs.popleft()) > SILENT_DBFS:
            del self._audible_dbfs[bisect_left(self._audible_dbfs, old)]

    def _now(self) -> float:
        count = len(self._audible_dbfs)
        if not count:
            return DEFAULT_LEVEL_DBFS
        place = LOUD_PERCENTILE / 100 * (count - 1)
        low, share = int(place), place % 1
        high = self._audible_dbfs[min(low + 1, count - 1)]
        loud = self._audible_dbfs[low] * (1 - share) + high * share
        return (DEFAULT_LEVEL_BLOCKS * DEFAULT_LEVEL_DBFS + count * loud) / (DEFAULT_LEVEL_BLOCKS + count)


class StreamingProsody:
    """The state of one stream."""

    def __init__(self, settings: EmbedSettings, fps: float, block_frames: int = 1) -> None:
        """Emit `block_frames` frames at a time: larger blocks cost less, and results do not depend on chunk sizes.

        Raises InputError unless a frame is a whole number of steps of 10 ms (as at 25 or 50 fps).
        """
        self.block_frames, self._settings, self._fps = block_frames, settings, fps
        self._size = round(SAMPLE_RATE / fps)
        if self._size * fps != SAMPLE_RATE or self._size % STEP_SAMPLES:
            raise InputError(f"fps: should be 20, 25, 50 or 100 for live speech, got {fps:g}")
        self._logmel = LogmelEncoder(settings.encoder) if isinstance(settings.encoder, LogmelSettings) else None
        self.channels = (*(self._logmel.channels if self._logmel else ()), *PROSODY_CHANNELS)
        max_lag = int(SAMPLE_RATE / settings.prosody.f0_min_hz) + 2
        energy = round(settings.prosody.energy_window_s * SAMPLE_RATE / 2)
        mel = self._logmel.lookahead_samples(fps) if self._logmel else 0
        # Samples after (and before) the time of a frame that affect its features, and the same in frames.
        self.lookahead_samples = max(max_lag + MEDIAN_STEPS // 2 * STEP_SAMPLES, energy, mel)
        self._lookahead_frames = -(-self.lookahead_samples // self._size)
        self._sound, self._first = np.zeros(0, np.float32), 0  # the buffered sound, and its first frame
        self._frame = 0
        self._level = RunningLevel()

    def push(self, chunk: Float[ndarray, " N"]) -> Float[ndarray, "T C"]:
        """Features of the frames that are complete with this chunk."""
        self.receive(chunk)
        parts = [np.zeros((0, len(self.channels)), np.float32)]
        while self.has_block:
            parts += self.next_blocks([self])
        return np.concatenate(parts)

    def receive(self, chunk: Float[ndarray, " N"]) -> None:
        """Keep a chunk for `next_blocks`."""
        self._sound = np.concatenate([self._sound, chunk.astype(np.float32, copy=False)])
        self._level.push(chunk)

    @property
    def has_block(self) -> bool:
        """Whether the sound of the next block of frames has come."""
        return self._next_stop <= (self._samples_received() - self.lookahead_samples) // self._size + 1

    @property
    def _next_stop(self) -> int:
        """The frame after the next block."""
        return self._frame + self.block_frames

    @staticmethod
    def next_blocks(streams: Sequence[StreamingProsody]) -> list[Float[ndarray, "T C"]]:
        """Features of the next block of each stream, all with the same settings and a block that `has_block`.

        Windows are analysed as one long sound, for features of a frame need nothing beyond its window; but for those at
        the start of a sound, which are alone.
        """
        windows = [each._window() for each in streams]
        inner = [row for row, each in enumerate(streams) if each._first]
        analysed = {row: each._analyse(windows[row]) for row, each in enumerate(streams) if not each._first}
        if inner:
            together = streams[inner[0]]._analyse(np.concatenate([windows[row] for row in inner]))
            analysed |= dict(zip(inner, np.split(together, len(inner)), strict=True))
        found = [each._features(each._next_stop, analysed[row]) for row, each in enumerate(streams)]
        for each in streams:  # only now, so that a step that fails can be taken again
            each._drop_before(each._next_stop)
        return found

    def finish(self) -> Float[ndarray, "T C"]:
        """Features of the remaining frames; ends the stream."""
        return self._features(frame_count(self._samples_received(), self._fps), self._analyse(self._sound))

    def process_offline(self, sound: Float[ndarray, " N"]) -> Float[ndarray, "T C"]:
        """Features of a complete sound, equal to those of a stream."""
        level = RunningLevel()
        level.push(sound)
        return self._normalise(self._analyse(sound), 0, level)

    def _samples_received(self) -> int:
        return self._first * self._size + len(self._sound)

    def _window(self) -> Float[ndarray, " N"]:
        """The sound of the next block; always of the same length, so that results are bit-identical."""
        span = (self._next_stop - 1 + self._lookahead_frames - self._first) * self._size
        known = self._sound[:span]
        return np.pad(known, (0, span - len(known)))

    def _features(self, stop: int, analysed: Float[ndarray, "F C"]) -> Float[ndarray, "T C"]:
        """Features of the frames up to `stop` from the analysis of the buffer."""
        wanted = analysed[self._frame - self._first : stop - self._first]
        return self._normalise(wanted, self._frame, self._level)

    def _drop_before(self, stop: int) -> None:
        """Drop the samples that frames from `stop` on do not need."""
        kept = max(stop - self._lookahead_frames, self._first)
        self._sound = self._sound[(kept - self._first) * self._size :]
        self._first, self._frame = kept, stop

    def _analyse(self, sound: Float[ndarray, " N"]) -> Float[ndarray, "T C"]:
        """Mel energies, if any, energy (dBFS), F0 (Hz) and voicing of each frame."""
        spoken = prosody(sound, self._fps, self._settings.prosody)
        mel = [self._logmel.energies(sound, self._fps)] if self._logmel else []
        return np.column_stack([*mel, spoken.energy_dbfs, spoken.f0_hz, spoken.voicing])

    def _normalise(self, analysed: Float[ndarray, "T C"], first: int, level: RunningLevel) -> Float[ndarray, "T C"]:
        """Features of frames from `first` on, each normalised by the level known at its time."""
        blocks = (first + np.arange(len(analysed))) * self._size // BLOCK_SAMPLES
        last = len(level.levels_dbfs) - 1
        known = [level.levels_dbfs[block] for block in np.minimum(blocks, last).tolist()]  # not all of an hour's levels
        gain_db = self._settings.level_dbfs - np.array(known)
        mel, (energy, f0_hz, voicing) = analysed[:, : -len(PROSODY_CHANNELS)], analysed[:, -len(PROSODY_CHANNELS) :].T
        mel = log_energies(mel * 10 ** (gain_db[:, None] / 10))
        energy = np.maximum(energy + gain_db, self._settings.prosody.energy_floor_dbfs)
        octaves = np.nan_to_num(np.log2(f0_hz / F0_REFERENCE_HZ))
        return np.column_stack([mel, energy, octaves, voicing]).astype(np.float32)
