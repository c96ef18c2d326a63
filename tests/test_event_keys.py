"""Keys of saccades and blinks: editing and rendering; motion at any frame rate."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import toy_motions
from command_line import call

from talkingeyes.animation.event_keys import apply_key_edits, load_keys, save_keys
from talkingeyes.animation.motion_resampling import resample_motion
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.formats.writers.event_keys import detect_events
from talkingeyes.workflows import convert


def space_deg(motion: Motion) -> np.ndarray:
    return np.degrees(rotation.cyclopean_gaze(rotation.gaze_in_space(motion.head, motion.gaze)))


@pytest.fixture
def keys(tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """A file of keys and its content."""
    save_keys(tmp_path / "a.json", toy_motions.events(), 25.0)
    return tmp_path / "a.json", json.loads((tmp_path / "a.json").read_text())


def play(motion: Motion, path: Path, content: dict[str, Any]) -> Motion:
    path.write_text(json.dumps(content))
    return apply_key_edits(motion, load_keys(path))


def test_without_an_edit_nothing_changes(keys: tuple[Path, dict[str, Any]]) -> None:
    motion = toy_motions.motion()
    played = apply_key_edits(motion, load_keys(keys[0]))
    np.testing.assert_array_equal(played.gaze, motion.gaze)
    np.testing.assert_array_equal(played.lid, motion.lid)


@pytest.mark.parametrize("fps", [25.0, 120.0])
def test_removed_saccade_is_not_rendered(keys: tuple[Path, dict[str, Any]], fps: float) -> None:
    motion, (path, content) = toy_motions.motion(fps), keys
    del content["saccades"][1]  # at 1.1 s, from 12 degrees to -6
    was, now = space_deg(motion), space_deg(play(motion, path, content))
    times = np.arange(len(motion)) / fps
    before, after = times < 1.05, times > 1.8
    np.testing.assert_allclose(now[before], was[before], atol=1e-9)
    between = (times > 1.2) & (times < 1.7)
    np.testing.assert_allclose(now[between], was[between] + [18.0, -4.0], atol=0.3)  # gaze keeps its previous location
    np.testing.assert_allclose(now[after], was[after], atol=0.3)  # and the next saccade lands at the same location
    assert (
        np.abs(np.diff(now[(times > 0.7) & (times < 1.68)], axis=0)).max() * fps < 8
    )  # degrees per second: only drift


def test_edited_saccade_follows_the_main_sequence(keys: tuple[Path, dict[str, Any]]) -> None:
    motion, (path, content) = toy_motions.motion(120.0), keys
    content["saccades"][3] = {"onset_s": 2.3, "end_rad": [float(np.radians(-15.0)), 0.0]}
    now = space_deg(play(motion, path, content))
    np.testing.assert_allclose(now[-20:].mean(axis=0), [-15.0, 0.0], atol=0.3)
    speed = np.linalg.norm(np.diff(now, axis=0), axis=1).max() * 120
    assert 380 < speed < 560  # main sequence for 19.7 degrees


def test_blinks_can_be_added_and_removed(keys: tuple[Path, dict[str, Any]]) -> None:
    motion, (path, content) = toy_motions.motion(), keys
    del content["blinks"][0]
    content["blinks"].append({"onset_s": 1.4})
    played = play(motion, path, content)
    times = np.arange(len(motion)) / 25
    np.testing.assert_allclose(played.lid[(times > 0.7) & (times < 1.3)], -0.05, atol=1e-3)
    assert played.lid[(times > 1.4) & (times < 1.7)].max() > 0.9
    np.testing.assert_array_equal(played.lid[times > 1.9], motion.lid[times > 1.9])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "talkingeyes.keys/1"}, "schema should be talkingeyes.events/2, got talkingeyes.keys/1"),
        ({"original": None}, "should hold the original keys too"),
        (
            {"vergence_movements": [{"onset_s": 1, "distance_m": 1}]},
            "saccades and blinks can be edited, got other vergence_movements",
        ),
        ({"blinks": [{"onset": 1}]}, "a key of blinks should have onset_s"),
        ({"saccades": [{"onset_s": 1}]}, "a key of saccades should have onset_s and end_rad"),
        ({"saccades": [{"onset_s": -1, "end_rad": [0, 0]}]}, "times from 0 s"),
        ({"saccades": [{"onset_s": 1, "end_rad": [0]}]}, "should be yaw and pitch"),
        ({"saccades": [{"onset_s": 1, "end_rad": [0, 0]}] * 2}, "one after another, got two at 1 s"),
        ({"blinks": None}, "not a readable file of keys"),
    ],
)
def test_a_wrong_key_is_named(keys: tuple[Path, dict[str, Any]], change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        play(toy_motions.motion(), keys[0], keys[1] | change)


def test_render_uses_edited_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    motion = toy_motions.motion(seconds=1.0)
    motion.save(tmp_path / "a.npz")
    Events(blinks=toy_motions.BLINKS[:1]).save(tmp_path / "a.events.json")  # written by `animate` with the motion
    convert.export("a.npz", "a.keys.json", format="events")
    content = json.loads((tmp_path / "a.keys.json").read_text())
    assert [key["onset_s"] for key in content["blinks"]] == [0.8]
    content["blinks"] = [{"onset_s": 0.04}]
    (tmp_path / "a.keys.json").write_text(json.dumps(content))
    words = ["render", "a.npz", "--size", "64", "--camera", "eyes", "-o"]
    for name, more in (("plain.mp4", []), ("edited.mp4", ["--keys", "a.keys.json"])):
        assert call(*words, name, *more) == 0
    plain, blinked = (pictures(tmp_path / name) for name in ("plain.mp4", "edited.mp4"))
    apart = np.abs(plain - blinked).mean(axis=(1, 2))
    between = np.median(apart[8:20])  # these frames differ only by compression artefacts
    assert apart[2:6].max() > 2 * between  # a blink at 0.04 s,
    assert apart[20:].max() > 2 * between  # and no blink at 0.8 s


def pictures(path: Path) -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="gray").astype(float) for frame in container.decode(video=0)])


@pytest.mark.parametrize("fps", [25.0, 120.0])
def test_keys_are_detected_without_stored_events(fps: float) -> None:
    found = detect_events(toy_motions.motion(fps))
    assert [round(key.onset_s, 1) for key in found.saccades] == [0.5, 1.1, 1.7, 2.4]
    for key, known in zip(found.saccades, toy_motions.events().saccades, strict=True):
        np.testing.assert_allclose(
            np.subtract(key.end_rad, key.start_rad), np.subtract(known.end_rad, known.start_rad), atol=0.02
        )
    assert len(found.blinks) == 2


def test_half_a_second_and_a_frame_have_keys_and_rates() -> None:
    short = toy_motions.motion().cut(10, 22)
    assert len(detect_events(short).saccades) == 1
    assert len(resample_motion(short, detect_events(short), 60.0)) == 28
    frame = toy_motions.motion().cut(0, 1)
    assert len(resample_motion(frame, detect_events(frame), 100.0)) == 4


@pytest.mark.parametrize("fps", [24.0, 29.97, 60.0, 120.0, 240.0])
def test_saccades_keep_the_main_sequence_at_any_rate(fps: float) -> None:
    """Upsampled from 25 frames per second they are as fast as if rendered at the new rate, unlike interpolated ones."""
    motion, law = toy_motions.motion(25.0), toy_motions.motion(fps)
    played = resample_motion(motion, detect_events(motion), fps)
    assert (played.fps, len(played)) == (fps, int(75 * fps / 25 + 1e-9))
    linear = np.stack([np.interp(np.arange(len(played)) / fps, np.arange(75) / 25, c) for c in space_deg(motion).T], 1)
    for key in toy_motions.events().saccades:
        window = slice(int((key.onset_s - 0.1) * fps), int((key.onset_s + 0.2) * fps))
        ours, true, plain = (peak(each[window], fps) for each in (space_deg(played), space_deg(law), linear))
        if fps >= 60:
            assert 0.85 < ours / true < 1.15, (fps, key)
        if fps >= 120:
            assert plain < 0.85 * true, (fps, key)
    inside = slice(0, len(played) - int(0.05 * fps) - 1)  # beyond the last frame the motion is held
    np.testing.assert_allclose(played.head[inside], law.head[: len(played)][inside], atol=2e-3)
    known = resample_motion(motion, toy_motions.events(), fps)
    np.testing.assert_allclose(known.lid[inside], law.lid[: len(played)][inside], atol=1e-6)


def peak(degrees: np.ndarray, fps: float) -> float:
    return float(np.linalg.norm(np.diff(degrees, axis=0), axis=1).max() * fps)
