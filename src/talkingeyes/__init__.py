"""Speech in; eye gaze, head motion and blinks out.

    import talkingeyes as te

    m = te.animate("speech.wav", seed=1)
    m.save("speech.npz")
    te.export(m, "speech.glb")

docs/python.md has the rest; docs/map.md says what stands where. Names are found on first use, for torch takes seconds.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from talkingeyes.animation import animate as animate
    from talkingeyes.animation import animate_into as animate_into
    from talkingeyes.animation import animate_samples as animate_samples
    from talkingeyes.conversion import export as export
    from talkingeyes.directing import direct as direct
    from talkingeyes.errors import InputError as InputError
    from talkingeyes.film import render as render
    from talkingeyes.motion import Events as Events
    from talkingeyes.motion import Motion as Motion
    from talkingeyes.pack import pack as pack
    from talkingeyes.performance.direction import Direction as Direction
    from talkingeyes.performance.direction import Liveliness as Liveliness
    from talkingeyes.performance.perform import Performance as Performance
    from talkingeyes.performance.targets import load_targets as load_targets
    from talkingeyes.speech import speak as speak

_HOMES = {
    "Direction": "performance.direction",
    "Events": "motion",
    "InputError": "errors",
    "Liveliness": "performance.direction",
    "Motion": "motion",
    "Performance": "performance.perform",
    "animate": "animation",
    "animate_into": "animation",
    "animate_samples": "animation",
    "direct": "directing",
    "export": "conversion",
    "load_targets": "performance.targets",
    "pack": "pack",
    "render": "film",
    "speak": "speech",
}

__all__ = [
    "Direction",
    "Events",
    "InputError",
    "Liveliness",
    "Motion",
    "Performance",
    "animate",
    "animate_into",
    "animate_samples",
    "direct",
    "export",
    "load_targets",
    "pack",
    "render",
    "speak",
]


def __getattr__(name: str) -> Any:
    """A name of the list on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


class _Package(ModuleType):
    """Keeps a name of the list what it is: an import of the room `export` would put that in the function's place."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _HOMES:
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
