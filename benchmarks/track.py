"""Tracking, end to end: frames per second of CPU, and memory by duration of the video.

A rendered talking head is written as videos of several durations, then tracked as `talkingeyes track` does: decoding,
FaceMesh, resampling, filtering, files. Memory is the peak of a separate process for each duration. With a folder of
videos as argument, their speed is measured too, each at its own size.

Run     python -m benchmarks.track [VIDEOS]     (make bench)
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.sources import find_videos
from talkingeyes.tracking.video import probe_video
from talkingeyes.workflows.track import track_video

LENGTHS_S = (30, 90)
SIDE = 224


def write_test_video(path: Path, seconds: float) -> Path:
    """Write a video of a turning, talking head: 224 x 224, 25 fps, with sound."""
    from talkingeyes.core.motion import Motion
    from talkingeyes.head.anny import anny_head
    from talkingeyes.rendering.render import HeadRenderer
    from talkingeyes.rendering.video import write_video
    from talkingeyes.rendering.view import FRAMINGS

    times_s = np.arange(50) / 25
    head = np.stack([0.06 * np.sin(2 * times_s), 0.25 * np.sin(1.5 * times_s), 0.03 * np.cos(times_s)], axis=1)
    motion = Motion.of(25.0, head, np.zeros((50, 2, 3)))
    pictures = list(HeadRenderer(anny_head(), FRAMINGS["head"].view(SIDE, SIDE)).draw(motion))
    pictures += pictures[::-1]
    sound = np.random.default_rng(0).normal(0, 0.1, round(seconds * 16_000)).astype(np.float32)
    write_video(path, (pictures[index % 100] for index in range(round(seconds * 25))), 25.0, sound)
    return path


def child(video: Path) -> None:
    """Track one video and print frames, CPU seconds without the start of the networks, and peak megabytes."""
    settings = TrackSettings.model_validate(compose(["track.clip_filter.require_voice=false"])["track"])
    source = find_videos([video], None)[0]
    with tempfile.TemporaryDirectory() as folder:
        begun = time.process_time()
        start(settings)
        warm = time.process_time()
        video_journal = track_video(Path(folder), settings, source)
        spent_s = time.process_time() - warm
    about = probe_video(video)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{about.width} {about.height} {video_journal.seconds * about.fps:.0f} {spent_s} {warm - begun} {peak_mb}")


def start(settings: TrackSettings) -> None:
    """Load the networks, once per process."""
    from talkingeyes.workflows.track import get_face_mesh

    get_face_mesh(settings.face).detect(np.zeros((64, 64, 3), np.uint8), 0.0)


def measured(video: Path) -> list[float]:
    """Results of a separate process."""
    called = subprocess.run(
        [sys.executable, __file__, "--child", str(video)], capture_output=True, text=True, check=True
    )
    return [float(word) for word in called.stdout.split()]


def line(name: str, found: list[float]) -> str:
    """A row of the table."""
    width, height, count, spent_s, start_s, peak_mb = found
    speed = count / spent_s if spent_s else 0.0
    return f"{name:<28}{width:6.0f} x{height:5.0f}{count:8.0f}{speed:12.0f}{start_s:10.1f}{peak_mb:10.0f}"


def main() -> None:
    """Print the table."""
    print(f"{'video':<28}{'size':>13}{'frames':>8}{'frames/s':>12}{'start s':>10}{'peak MB':>10}")
    with tempfile.TemporaryDirectory() as folder:
        for seconds in LENGTHS_S:
            print(line(f"rendered, {seconds} s", measured(write_test_video(Path(folder) / "drawn.mp4", seconds))))
    for source in find_videos([Path(sys.argv[1])], None) if sys.argv[1:] else []:
        print(line(source.name, measured(source.path)))


if __name__ == "__main__":
    run_command(lambda: child(Path(sys.argv[2])) if sys.argv[1:2] == ["--child"] else main())
