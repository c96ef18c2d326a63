"""`talkingeyes render` and `talkingeyes head`: films and pictures of heads, and one-line errors."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
import soundfile
from command_line import call
from flame_file import arrays, write

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.workflows.render import parse_camera, render, retarget_to_head


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with a motion and a sound."""
    monkeypatch.chdir(tmp_path)
    Motion.of(30.0, np.zeros((12, 3)), np.zeros((12, 2, 3)), jaw=np.full((12, 3), [0.1, 0, 0])).save(tmp_path / "a.npz")
    soundfile.write(tmp_path / "a.wav", np.random.default_rng(0).normal(0, 0.1, 8000), 16_000)
    return tmp_path


def test_a_film_has_the_frames_the_sound_and_the_size(place: Path) -> None:
    words = ["render", "a.npz", "-o", "a.mp4", "--camera", "face,yaw=20", "--sound", "a.wav", "--size", "64"]
    assert call(*words) == 0
    with av.open("a.mp4") as container:
        assert len(container.streams.audio) == 1
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert (len(frames), frames[0].shape) == (12, (64, 64, 3))
    assert call(*words) == 2  # the file exists
    assert call(*words, "--force") == 0


def test_the_head_is_a_picture(place: Path) -> None:
    assert call("head", "-o", "head.png", "--size", "300") == 0
    assert (place / "head.png").stat().st_size > 10_000


def test_the_same_motion_plays_on_flame(place: Path) -> None:
    write(place / "flame.pkl", arrays())
    played = render("a.npz", "b.mp4", head="flame", model="flame.pkl", size=32)
    assert len(played) == 12


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.npz", "-o", "b.mp4"], "none.npz: not a readable motion"),
        (["nan.npz", "-o", "b.mp4"], "head should be finite, got NaN"),
        (["strange.npz", "-o", "b.mp4"], "expression should be of the head anny, got wing (of bird)"),
        (["a.npz", "-o", "b.avi"], "should be a name that ends in .mp4"),
        (["a.npz", "-o", "no/b.mp4"], "should be a file in a folder that exists"),
        (["a.npz", "-o", "b.mp4", "--camera", "distance=0.05"], "at least 0.2 m from the middle of the head"),
        (["a.npz", "-o", "b.mp4", "--camera", "above"], "camera: should be head, face"),
        (["a.npz", "-o", "b.mp4", "--camera", "yaw=x"], "yaw should be a number, got 'x'"),
        (["a.npz", "-o", "b.mp4", "--head", "flame"], "should be the FLAME file"),
        (["a.npz", "-o", "b.mp4", "--head", "duck"], "should be one of anny, flame"),
        (["a.npz", "-o", "b.mp4", "--size", "5"], "size: should be 16 to 4096"),
        (["a.npz", "-o", "b.mp4", "--sound", "none.wav"], "none.wav: cannot be opened"),
    ],
)
def test_bad_input_is_one_line_error_and_changes_nothing(
    place: Path, capfd: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    good = dict(np.load("a.npz"))
    np.savez("nan.npz", **{**good, "head": np.full((12, 3), np.nan)})
    other = {"expression": np.zeros((12, 1)), "expression_names": '["wing"]', "head_model": "bird"}
    np.savez("strange.npz", **{**good, **other})
    before = sorted(place.rglob("*"))
    assert call("render", *words) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert sorted(place.rglob("*")) == before


def test_cameras_are_names_numbers_or_both() -> None:
    assert parse_camera("face").height_m == parse_camera("face,yaw=20").height_m
    assert parse_camera("face,yaw=20").yaw_deg == 20
    assert parse_camera("distance=0.5, height=0.2").distance_m == 0.5
    with pytest.raises(InputError, match="height should be"):
        parse_camera("height=0")


def test_expression_of_the_same_head_is_left_alone() -> None:
    head = anny_head()
    smile = Motion.of(
        25.0,
        np.zeros((2, 3)),
        np.zeros((2, 2, 3)),
        expression=np.ones((2, 1)),
        expression_names=("mouthSmileLeft",),
    )
    assert retarget_to_head(smile, head, None) is smile
