"""Writes frames and sound as a widely compatible mp4 (h264, yuv420p, aac), at any frame rate."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from pydantic import Field

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.settings import Settings

AAC_FRAME = 1024


class ReportSettings(Settings):
    """Settings of the films of the report."""

    film_s: float = Field(gt=0, le=600)  # length; a film is not longer than its sound


def write_video(
    path: Path, frames: Iterable[UInt8[ndarray, "H W 3"]], fps: float, sound: Float[ndarray, " N"] | None
) -> None:
    """Write frames with 16 kHz sound, atomically; the sound ends with the last frame.

    An odd height or width loses its last row or column, because yuv420p needs even sizes.
    """
    import av

    rate = Fraction(fps).limit_denominator(1001)
    with (
        atomic_write(path) as partial,
        av.open(str(partial), "w", format="mp4", options={"movflags": "+faststart"}) as container,
    ):
        # Without cpu-independent, the same frames give other bytes now and then.
        options = {"preset": "veryfast", "crf": "20", "x264-params": "cpu-independent=1"}
        video: Any = container.add_stream("libx264", rate=rate, options=options)
        video.pix_fmt = "yuv420p"
        video.thread_count = 1
        audio: Any = None if sound is None else container.add_stream("aac", rate=SAMPLE_RATE, layout="mono")
        heard = 0
        for count, image in enumerate(frames, start=1):
            even = np.ascontiguousarray(image[: len(image) // 2 * 2, : image.shape[1] // 2 * 2])
            if count == 1:
                video.height, video.width = even.shape[:2]
            container.mux(video.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))
            if sound is not None:  # interleaved with the frames, so that neither stream has to be buffered
                until = min(round(count / rate * SAMPLE_RATE), len(sound))
                for start in range(heard, until - AAC_FRAME + 1, AAC_FRAME):
                    container.mux(audio.encode(_sound_frame(sound, start, start + AAC_FRAME)))
                    heard = start + AAC_FRAME
        container.mux(video.encode(None))
        if sound is not None:
            if until > heard:
                container.mux(audio.encode(_sound_frame(sound, heard, until)))
            container.mux(audio.encode(None))


def _sound_frame(sound: Float[ndarray, " N"], start: int, stop: int) -> Any:
    import av

    samples = np.clip(sound[None, start:stop], -1, 1).astype(np.float32)
    frame = av.AudioFrame.from_ndarray(samples, format="fltp", layout="mono")
    frame.sample_rate, frame.pts, frame.time_base = SAMPLE_RATE, start, Fraction(1, SAMPLE_RATE)
    return frame
