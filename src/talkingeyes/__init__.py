"""Speech in; eye gaze, head motion and blinks out.

    import talkingeyes as te

    m = te.animate("speech.wav", seed=1)
    m.save("speech.npz")
    te.export(m, "speech.glb")

docs/python.md has the rest; docs/architecture.md says what stands where. Names are found on first use, for torch takes seconds.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from talkingeyes.animation.direction import Direction as Direction
    from talkingeyes.animation.direction import Liveliness as Liveliness
    from talkingeyes.animation.perform import Performance as Performance
    from talkingeyes.animation.targets import load_targets as load_targets
    from talkingeyes.core.errors import InputError as InputError
    from talkingeyes.core.motion import Events as Events
    from talkingeyes.core.motion import Motion as Motion
    from talkingeyes.workflows.animate import animate as animate
    from talkingeyes.workflows.animate import animate_into as animate_into
    from talkingeyes.workflows.animate import animate_samples as animate_samples
    from talkingeyes.workflows.convert import export as export
    from talkingeyes.workflows.direct import direct as direct
    from talkingeyes.workflows.pack import pack as pack
    from talkingeyes.workflows.render import render as render
    from talkingeyes.workflows.speak import speak as speak

_HOMES = {
    "Direction": "animation.direction",
    "Events": "core.motion",
    "InputError": "core.errors",
    "Liveliness": "animation.direction",
    "Motion": "core.motion",
    "Performance": "animation.perform",
    "animate": "workflows.animate",
    "animate_into": "workflows.animate",
    "animate_samples": "workflows.animate",
    "direct": "workflows.direct",
    "export": "workflows.convert",
    "load_targets": "animation.targets",
    "pack": "workflows.pack",
    "render": "workflows.render",
    "speak": "workflows.speak",
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
