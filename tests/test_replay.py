"""Lookups: the nearest clip in loudness, and pieces around onsets under the head of another clip."""

import numpy as np
import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import gaze_in_space
from talkingeyes.models.replay import ReplayBank, ReplaySettings, find_onsets, sample_replay

FPS, NAMES = 25.0, ("pitch", "energy_dbfs", "voice_activity")


def speech(onsets: list[int], frames: int = 200, level_db: float = -20.0) -> np.ndarray:
    """An embedding that speaks for a second from each onset."""
    speaking = np.zeros(frames, bool)
    for onset in onsets:
        speaking[onset : onset + 25] = True
    return np.stack([np.zeros(frames), np.where(speaking, level_db, -60.0), speaking], axis=1).astype(np.float32)


def motion(yaw: float, onsets: list[int], frames: int = 200) -> np.ndarray:
    """A head at rest at `yaw`, and eyes that look 0.2 rad to the side of space for half a second from each onset."""
    space = np.zeros(frames)
    for onset in onsets:
        space[onset : onset + 12] = 0.2
    out = np.zeros((frames, 9), np.float32)
    out[:, 1] = yaw
    out[:, 4] = out[:, 7] = space - yaw
    return out


ONSETS = [[20, 90, 150], [40, 100, 160], [60, 120, 170]]
YAWS = [0.1, -0.1, 0.05]


@pytest.fixture(scope="module")
def bank() -> ReplayBank:
    return ReplayBank.of([*map(speech, ONSETS)], [*map(motion, YAWS, ONSETS)], NAMES, FPS)


def replay(kind: str, neighbours: int = 1) -> ReplaySettings:
    return ReplaySettings(kind=kind, parts=("head", "gaze"), tokenizer=None, neighbours=neighbours)


@pytest.mark.parametrize("clip", range(3))
def test_a_training_sound_finds_its_own_motion(bank: ReplayBank, clip: int) -> None:
    for kind in ("aligned_replay", "pieced_replay"):
        (found,) = sample_replay(replay(kind), bank, speech(ONSETS[clip]), [0])
        np.testing.assert_allclose(found, motion(YAWS[clip], ONSETS[clip]), atol=1e-5)


def test_pieces_put_gaze_in_space_at_the_onsets_of_the_sound(bank: ReplayBank) -> None:
    onsets = [30, 110, 165]
    (found,) = sample_replay(replay("pieced_replay"), bank, speech(onsets), [0])
    space = gaze_in_space(found[:, :3], found[:, 3:].reshape(-1, 2, 3))[:, 0, 0]
    assert (np.abs(np.diff(space, prepend=0)) > 0.1).nonzero()[0].tolist() == [30, 42, 110, 122, 165, 177]
    assert np.isin(np.round(found[:, 1], 3), np.round(YAWS, 3).astype(np.float32)).all()  # the head of one clip


def test_samples_differ_among_the_nearest_and_repeat_by_seed(bank: ReplayBank) -> None:
    sound = speech(ONSETS[0])
    first, again = (sample_replay(replay("aligned_replay", 3), bank, sound, range(8)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first[:, 0, 1])) > 1


def test_a_sound_longer_than_any_clip_holds_the_last_pose(bank: ReplayBank) -> None:
    (found,) = sample_replay(replay("aligned_replay"), bank, speech(ONSETS[0], 260), [0])
    np.testing.assert_array_equal(found[200:], np.repeat(found[199:200], 60, axis=0))


def test_onsets_and_missing_channels() -> None:
    assert find_onsets(np.array([1.0, 0.0, 0.0, 1.0, 1.0])).tolist() == [0, 3]
    with pytest.raises(InputError, match=r"^embed: should have the channel voice_activity for a replay, got none$"):
        ReplayBank.of([], [], NAMES[:2], FPS)
