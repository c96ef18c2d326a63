"""Speech in; eye gaze, head motion and blinks out.

`talkingeyes.animate(...)` is the whole of it in one call; docs/map.md says what stands where.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from talkingeyes.animation import animate as animate

__all__ = ["animate"]


def __getattr__(name: str) -> Any:
    """`animate` on first use: it brings torch, which takes seconds to import."""
    if name == "animate":
        from talkingeyes.animation import animate

        return animate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
