"""Channels of the boundaries of speech."""

from __future__ import annotations

import numpy as np

from talkingeyes.audio.annotation import Span
from talkingeyes.audio.speech_boundaries import FARTHEST_S, RESOLUTION_S, boundary_channels

SPEAKING = (Span(1.0, 2.0), Span(3.0, 4.2))


def seconds(channels: np.ndarray) -> np.ndarray:
    """Undo the compression."""
    return np.expm1(channels[:, 1:]) * RESOLUTION_S


def test_times_since_and_until_the_nearest_onset_and_offset() -> None:
    found = boundary_channels(SPEAKING, np.array([0.5, 1.0, 1.5, 2.0, 3.5, 5.5]))
    assert found[:, 0].tolist() == [0, 1, 1, 0, 1, 0]
    expected = [
        [FARTHEST_S, FARTHEST_S, 0.5, 1.5],
        [0.0, FARTHEST_S, 2.0, 1.0],
        [0.5, FARTHEST_S, 1.5, 0.5],
        [1.0, 0.0, 1.0, 2.2],
        [0.5, 1.5, FARTHEST_S, 0.7],
        [2.5, 1.3, FARTHEST_S, FARTHEST_S],
    ]
    np.testing.assert_allclose(seconds(found), expected, atol=1e-12)


def test_silence_has_no_boundaries() -> None:
    found = boundary_channels((), np.arange(3.0))
    assert not found[:, 0].any()
    np.testing.assert_allclose(seconds(found), FARTHEST_S)


def test_times_reversed_swap_since_and_until() -> None:
    times = np.array([0.3, 1.7, 2.6, 4.4])
    mirrored = tuple(Span(-span.end_s, -span.start_s) for span in reversed(SPEAKING))
    one, other = seconds(boundary_channels(SPEAKING, times)), seconds(boundary_channels(mirrored, -times))
    np.testing.assert_allclose(one[:, [0, 1, 2, 3]], other[:, [3, 2, 1, 0]])
