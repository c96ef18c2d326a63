"""Video with sound, read back; the trace plot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from talkingeyes.audio.waveform import frame_count, read_speech
from talkingeyes.core.motion import Motion
from talkingeyes.rendering.traces import plot_traces
from talkingeyes.rendering.video import write_video


def flashes(frames: int, every: int, height: int = 64, width: int = 64) -> Iterator[np.ndarray]:
    """Black pictures, every n-th one white."""
    for frame in range(frames):
        yield np.full((height, width, 3), 255 if frame % every == 0 else 0, np.uint8)


def beeps(seconds: float, every_s: float) -> np.ndarray:
    times_s = np.arange(round(seconds * 16_000)) / 16_000
    return (0.5 * np.sin(2 * np.pi * 1000 * times_s) * (times_s % every_s < 0.1)).astype(np.float32)


@pytest.mark.parametrize("fps", [24.0, 25.0, 29.97, 60.0, 240.0])
@pytest.mark.parametrize("seconds", [0.3, 2.213])
def test_picture_and_sound_are_synchronous_and_end_together(tmp_path: Path, fps: float, seconds: float) -> None:
    frames = frame_count(round(seconds * 16_000), fps)
    path = tmp_path / "a video.mp4"
    write_video(path, flashes(frames, round(fps)), fps, beeps(seconds, round(fps) / fps))
    with av.open(str(path)) as container:
        video, audio = container.streams.video[0], container.streams.audio[0]
        assert (video.codec_context.name, video.codec_context.pix_fmt, audio.codec_context.name) == (
            "h264",
            "yuv420p",
            "aac",
        )
        assert abs(float(video.average_rate) - fps) < 0.001
        assert abs(float(audio.duration * audio.time_base) - frames / fps) < 0.07  # a packet of 1,024 samples
        shown = [(frame.time, frame.to_ndarray(format="gray").mean() > 128) for frame in container.decode(video=0)]
    np.testing.assert_allclose([time_s for time_s, _ in shown], np.arange(frames) / fps, atol=1e-3)
    white_s = [time_s for time_s, white in shown if white]
    sound = read_speech(path)
    assert abs(len(sound) / 16_000 - frames / fps) < 0.07
    loud = np.abs(sound) > 0.1
    for time_s in white_s:
        first = round(time_s * 16_000)
        assert loud[first : first + 480].mean() > 0.5
        assert not loud[max(first - 1600, 0) : max(first - 200, 0)].any()


def test_odd_sizes_lose_a_line(tmp_path: Path) -> None:
    write_video(tmp_path / "odd.mp4", flashes(5, 2, 65, 33), 25.0, None)
    with av.open(str(tmp_path / "odd.mp4")) as container:
        assert not container.streams.audio
        assert (container.streams.video[0].height, container.streams.video[0].width) == (64, 32)


def test_a_video_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> Iterator[np.ndarray]:
        yield from flashes(10, 5)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        write_video(tmp_path / "a.mp4", fail(), 25.0, beeps(1.0, 0.5))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("count", [1, 3])
def test_traces_are_a_picture(tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(0)
    motions = [Motion.of(25.0, rng.normal(0, 0.1, (50, 3)), rng.normal(0, 0.1, (50, 2, 3))) for _ in range(count)]
    plot_traces(motions, beeps(2.0, 0.5), tmp_path / "traces.png")
    with Image.open(tmp_path / "traces.png") as image:
        assert image.size[0] > 900
        assert np.asarray(image.convert("L")).std() > 10
