"""The plain drawing: it shows where eyes and head point, what lids and mouth do, at any size."""

from __future__ import annotations

import numpy as np
import pytest

from talkingeyes.head.sketch import HAIR, IRIS, MOUTH, SKIN, contact_sheet, draw
from talkingeyes.motion import Motion
from talkingeyes.rotation import gaze_of_angles


def motion(
    frames: int = 1,
    head_deg: tuple[float, float, float] = (0, 0, 0),
    eye_deg: tuple[float, float] = (0, 0),
    lid: float = 0,
    jaw_deg: float = 0,
) -> Motion:
    gaze = gaze_of_angles(np.radians(np.full((frames, 2, 2), eye_deg, float)))
    return Motion.of(
        25.0,
        np.radians(np.full((frames, 3), head_deg, float)),
        gaze,
        lid=np.full((frames, 2), lid, float),
        jaw=np.radians(np.full((frames, 3), (jaw_deg, 0, 0), float)),
    )


def picture(size: int = 256, **shown: float | tuple[float, ...]) -> np.ndarray:
    return next(draw(motion(**shown), size))  # type: ignore[arg-type]


def where(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """(row, column) of the pixels of a colour."""
    return np.argwhere(np.abs(image.astype(int) - colour).max(axis=-1) < 16)


@pytest.mark.parametrize("size", [16, 65, 256])
def test_one_picture_a_frame(size: int) -> None:
    pictures = list(draw(motion(300), size))
    assert len(pictures) == 300
    assert {(image.shape, image.dtype) for image in pictures} == {((size, size, 3), np.dtype(np.uint8))}


def test_a_neutral_face_is_symmetric_but_for_the_shade_of_the_nose() -> None:
    image = picture().astype(int)
    assert (np.abs(image - image[:, ::-1]).max(axis=-1) > 40).mean() < 0.03
    assert len(where(image, SKIN)) > 0.1 * 256**2


@pytest.mark.parametrize(
    ("eye_deg", "axis", "sign"), [((15, 0), 1, 1), ((-15, 0), 1, -1), ((0, 10), 0, -1), ((0, -8), 0, 1)]
)
def test_irises_go_where_the_eyes_look(eye_deg: tuple[float, float], axis: int, sign: int) -> None:
    """The subject's left is on the right of the picture; up is up."""
    straight, turned = where(picture(512), IRIS).mean(axis=0), where(picture(512, eye_deg=eye_deg), IRIS).mean(axis=0)
    assert sign * (turned - straight)[axis] > 0.7
    assert abs(turned - straight)[1 - axis] < 1.5


@pytest.mark.parametrize(("head_deg", "axis", "sign"), [((0, 20, 0), 1, 1), ((0, -20, 0), 1, -1), ((15, 0, 0), 0, 1)])
def test_the_face_goes_where_the_head_turns(head_deg: tuple[float, float, float], axis: int, sign: int) -> None:
    straight, turned = (where(image, IRIS).mean(axis=0) for image in (picture(), picture(head_deg=head_deg)))
    assert sign * (turned - straight)[axis] > 5


def test_roll_tilts_to_the_subjects_right_shoulder() -> None:
    left_of_picture, right_of_picture = (
        where(picture(head_deg=(0, 0, 15))[:, half], IRIS).mean(axis=0)[0] for half in (slice(0, 120), slice(136, 256))
    )
    assert left_of_picture > right_of_picture + 5


def test_shut_lids_hide_the_irises_and_an_open_jaw_shows_the_mouth() -> None:
    open_eyes = len(where(picture(), IRIS))
    assert open_eyes > 40
    assert len(where(picture(lid=0.6), IRIS)) < 0.8 * open_eyes
    assert len(where(picture(lid=1.0), IRIS)) < 0.05 * open_eyes
    assert len(where(picture(jaw_deg=10), MOUTH)) > 50 + len(where(picture(), MOUTH))


def test_extreme_poses_are_drawn() -> None:
    random = np.random.default_rng(0)
    wild = Motion.of(
        25.0, random.normal(0, 1.5, (50, 3)), random.normal(0, 1, (50, 2, 3)), lid=random.normal(0, 1, (50, 2))
    )
    assert all(len(where(image, HAIR)) > 0 for image in draw(wild, 64))


def test_contact_sheet_has_a_row_a_motion_and_a_column_a_time() -> None:
    sheet = contact_sheet([motion(10), motion(10, head_deg=(0, 20, 0))], [0.0, 0.2, 9.0], 64)
    assert sheet.shape == (128, 192, 3)
    np.testing.assert_array_equal(sheet[64:, :64], picture(64, head_deg=(0, 20, 0)))
