"""A motion with what is said about its file: above all what the file holds and a motion has no place for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from talkingeyes.core.motion import Motion

MAX_NAMES = 6  # in a note


@dataclass(frozen=True)
class NotedMotion:
    """A motion as read, and notes about it, a line each."""

    motion: Motion
    notes: tuple[str, ...]


def no_place_note(lost: Sequence[str], count: int, what: str = "shapes") -> tuple[str, ...]:
    """The note that of `count` shapes of a file these have no place in a motion; none without them."""
    if not lost:
        return ()
    shown = ", ".join(lost[:MAX_NAMES]) + (", ..." if len(lost) > MAX_NAMES else "")
    return (f"{len(lost)} of {count} {what} {'has' if len(lost) == 1 else 'have'} no place here: {shown}",)
