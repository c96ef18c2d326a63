"""Types and shapes are checked in the first calls of a function in each test, and not after."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from checked_calls import CALLS, check_again

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles

VECTORS = np.zeros((4, 3))
MOTION = Motion.of(25.0, VECTORS, np.zeros((4, 2, 3)))
WRONG = np.zeros((4, 2))  # two numbers in place of three
# A call that is right, and one that jaxtyping refuses.
KINDS: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
    "function": (lambda: gaze_to_angles(VECTORS), lambda: gaze_to_angles(VECTORS.astype(int))),
    "class method": (
        lambda: Motion.of(25.0, VECTORS, np.zeros((4, 2, 3))),
        lambda: Motion.of(25.0, WRONG, np.zeros((4, 2, 3)), head_model="anny"),
    ),
    "method": (lambda: MOTION.cut(0, 2), lambda: MOTION.cut("0", "2")),  # type: ignore[arg-type]
}


def is_checked(call: Callable[[], object]) -> bool:
    try:
        call()
    except Exception as error:
        return "Type-check error" in str(error)
    return False


@pytest.mark.parametrize("kind", KINDS)
def test_first_calls_are_checked_further_ones_are_not_and_the_next_test_begins_again(kind: str) -> None:
    right, wrong = KINDS[kind]
    assert is_checked(wrong)
    for _ in range(2 * CALLS):
        right()
    assert not is_checked(wrong)
    check_again()
    assert is_checked(wrong)
