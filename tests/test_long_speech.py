"""Long speech is encoded in windows without visible seams; all frame rates give the same animation."""

from __future__ import annotations

import numpy as np
import pytest
from toy_performer import motion

from talkingeyes.animation.controls import Liveliness
from talkingeyes.animation.targets import ObjectTrack, Target, TargetTrack
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, MoonshineEncoder, MoonshineSettings, package_file
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.audio.windows import window_starts


def change_at_seams(features: np.ndarray, seams_s: list[float]) -> float:
    """Rate of change of features within 0.3 s of the middle of overlaps, divided by that elsewhere."""
    speed = np.linalg.norm(np.diff(features, axis=0), axis=1)
    times = np.arange(len(speed)) / 25.0
    at = np.any([np.abs(times - seam) <= 0.3 for seam in seams_s], axis=0)
    return float(np.median(speed[at]) / np.median(speed[~at]))


def test_no_visible_seams_between_windows() -> None:
    sound = read_speech(package_file(EXAMPLE_SPEECH))
    heard = MoonshineEncoder(MoonshineSettings(kind="moonshine", window_s=6.0, overlap_s=2.0))(sound, 25.0)
    starts = window_starts(len(sound), 6 * SAMPLE_RATE, 2 * SAMPLE_RATE)[1:]
    seams = [start / SAMPLE_RATE + 1.0 for start in starts]
    assert len(seams) >= 9
    assert 0.7 < change_at_seams(heard, seams) < 1.2
    # The test detects seams: without overlap, features jump.
    cut = MoonshineEncoder(MoonshineSettings(kind="moonshine", window_s=6.0, overlap_s=0.0))(sound, 25.0)
    jumps = np.linalg.norm(np.diff(cut, axis=0), axis=1)
    edges = [round(start / SAMPLE_RATE * 25) for start in window_starts(len(sound), 6 * SAMPLE_RATE, 0)[1:]]
    assert np.median([jumps[edge - 1 : edge + 1].max() for edge in edges]) > 1.3 * np.median(jumps)


@pytest.mark.parametrize("fps", [50.0, 100.0, 200.0])
def test_controlled_motion_is_the_same_at_any_rate(fps: float) -> None:
    track = TargetTrack((Target(2.0, 4.0, "lamp"),), {"lamp": ObjectTrack.fixed(0.9, 0.3, 1.2)})
    asked = {"targets": track, "eye_contact": 0.6, "liveliness": Liveliness(1.3, 0.9, 1.5)}
    slow, fast = motion(fps=25.0, **asked), motion(fps=fps, **asked)
    step = round(fps / 25.0)
    np.testing.assert_allclose(fast.head[::step], slow.head, atol=1e-9)
    np.testing.assert_allclose(fast.gaze[::step], slow.gaze, atol=1e-7)
    np.testing.assert_array_equal(fast.lid[::step], slow.lid)
