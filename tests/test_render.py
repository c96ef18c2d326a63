"""Pictures of the open head: directions of eyes and head, left and right, antialiasing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.rendering.contact_sheet import contact_sheet, static_motion
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.video import write_video
from talkingeyes.rendering.view import FRAMINGS, Framing


def eyes(gaze_deg: tuple[float, float] = (0, 0), lid: float = 0.0) -> np.ndarray:
    renderer = HeadRenderer(anny_head(), FRAMINGS["eyes"].view(160, 72))
    return next(renderer.draw(static_motion(gaze_deg=np.array([gaze_deg], float), lid=np.array([lid]))))


def blue(image: np.ndarray) -> np.ndarray:
    """(row, column) of pixels of the irises."""
    return np.argwhere(image[..., 2].astype(int) > image[..., 0].astype(int) + 30)


@pytest.mark.parametrize(
    ("gaze_deg", "axis", "sign"), [((20, 0), 1, 1), ((-20, 0), 1, -1), ((0, 12), 0, -1), ((0, -15), 0, 1)]
)
def test_irises_go_where_the_eyes_look(gaze_deg: tuple[float, float], axis: int, sign: int) -> None:
    assert sign * (blue(eyes(gaze_deg)).mean(axis=0) - blue(eyes()).mean(axis=0))[axis] > 1.2


def test_lids_hide_the_irises() -> None:
    open_ = len(blue(eyes()))
    assert open_ > 80
    assert len(blue(eyes(lid=0.6))) < 0.7 * open_
    assert len(blue(eyes(lid=1.0))) == 0


def test_the_subjects_left_is_at_the_right_of_the_picture() -> None:
    winking = Motion.of(25.0, np.zeros((1, 3)), np.zeros((1, 2, 3)), lid=np.array([[1.0, 0.0]]))
    picture = next(HeadRenderer(anny_head(), FRAMINGS["eyes"].view(160, 72)).draw(winking))
    assert blue(picture)[:, 1].max() < 80


def test_a_picture_is_the_same_again_and_edges_are_smooth() -> None:
    renderer = HeadRenderer(anny_head(), FRAMINGS["head"].view(96, 96))
    first, again = next(renderer.draw(static_motion())), next(renderer.draw(static_motion()))
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 500


def test_a_head_out_of_the_picture_leaves_the_background() -> None:
    away = Motion.of(25.0, np.zeros((1, 3)), np.zeros((1, 2, 3)), translation=np.array([[5.0, 0.0, 0.0]]))
    picture = next(HeadRenderer(anny_head(), FRAMINGS["head"].view(32, 32)).draw(away))
    assert (picture == picture[0, 0]).all()


def test_a_sheet_has_a_row_a_motion_and_a_column_a_time() -> None:
    two = static_motion(gaze_deg=np.zeros((2, 2)))
    assert contact_sheet(anny_head(), [two, two], [0.0, 0.04, 9.0], 24).shape == (48, 72, 3)


def test_a_camera_inside_the_head_is_refused() -> None:
    with pytest.raises(InputError, match=r"camera: should be at least 0.2 m"):
        Framing(0.2, (0.0, 0.0, 0.0), distance_m=0.1).view(64, 64)


def test_equal_frames_give_equal_films(tmp_path: Path) -> None:
    """Of moving gradients: without the option of the encoder, each of them is another film."""
    y, x = np.mgrid[:160, :160]
    frames = []
    for time in range(75):
        waves = np.sin((x + 3 * time) / 17) * np.cos((y - 2 * time) / 23)
        rings = np.cos(np.hypot(x - 80 - 20 * np.sin(time / 5), y - 80) / 9)
        frames.append((127 + 100 * np.stack([waves, rings, (waves + rings) / 2], axis=-1)).astype(np.uint8))
    sound = np.sin(np.arange(3 * SAMPLE_RATE, dtype=np.float32) / 20)
    contents = set()
    for number in range(4):
        write_video(tmp_path / f"{number}.mp4", frames, 25.0, sound)
        contents.add((tmp_path / f"{number}.mp4").read_bytes())
    assert len(contents) == 1
