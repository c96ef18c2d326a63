"""Speech in; eye gaze, head motion and blinks out.

    import talkingeyes as te

    m = te.animate("speech.wav", seed=1)
    m.save("speech.npz")
    te.export(m, "speech.glb")

More examples are in docs/python.md, the structure is in docs/architecture.md. Names are imported on first use, because
torch takes seconds to import.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from talkingeyes.animation.animation import Animation as Animation
    from talkingeyes.animation.controls import Controls as Controls
    from talkingeyes.animation.controls import Liveliness as Liveliness
    from talkingeyes.animation.targets import load_targets as load_targets
    from talkingeyes.core.errors import InputError as InputError
    from talkingeyes.core.motion import Events as Events
    from talkingeyes.core.motion import Motion as Motion
    from talkingeyes.workflows.add_eyes import add_eyes as add_eyes
    from talkingeyes.workflows.animate import animate as animate
    from talkingeyes.workflows.animate import animate_samples as animate_samples
    from talkingeyes.workflows.animate import animate_to_folder as animate_to_folder
    from talkingeyes.workflows.convert import export as export
    from talkingeyes.workflows.direct import make_controls as make_controls
    from talkingeyes.workflows.pack import pack as pack
    from talkingeyes.workflows.render import render as render
    from talkingeyes.workflows.speak import speak as speak

_MODULES = {
    "Controls": "animation.controls",
    "Events": "core.motion",
    "InputError": "core.errors",
    "Liveliness": "animation.controls",
    "Motion": "core.motion",
    "Animation": "animation.animator",
    "add_eyes": "workflows.add_eyes",
    "animate": "workflows.animate",
    "animate_to_folder": "workflows.animate",
    "animate_samples": "workflows.animate",
    "make_controls": "workflows.direct",
    "export": "workflows.convert",
    "load_targets": "animation.targets",
    "pack": "workflows.pack",
    "render": "workflows.render",
    "speak": "workflows.speak",
}

__all__ = [
    "Animation",
    "Controls",
    "Events",
    "InputError",
    "Liveliness",
    "Motion",
    "add_eyes",
    "animate",
    "animate_samples",
    "animate_to_folder",
    "export",
    "load_targets",
    "make_controls",
    "pack",
    "render",
    "speak",
]


def __getattr__(name: str) -> Any:
    """A name of the list on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


class _Package(ModuleType):
    """Keeps a name of the list what it is: an import of the room `export` would put that in the function's place."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _MODULES:
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
