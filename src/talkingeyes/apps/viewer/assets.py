"""Files of the viewer's page: those beside this module, and three.js with its glTF loader and orbit controls.

three.js comes from the package nicegui, which ships it bundled as one ES module (MIT). Nothing else of that package is
used, and none of its code is run. Only these names are served.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from talkingeyes.core.errors import InputError

ASSETS_FOLDER = Path(__file__).parent / "assets"
THREE_JS_PATH = Path("elements", "scene", "dist", "index.js")  # within the package nicegui
MEDIA_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html; charset=utf-8"}
NAMES = ("stage.js", "style.css", "three.js", "timeline.js", "view.html", "view.js")


@dataclass(frozen=True)
class Asset:
    """A file for a browser."""

    content: bytes
    media: str


@cache
def asset(name: str) -> Asset:
    """Read one of NAMES. Raises KeyError for any other name, InputError if the package with three.js is missing."""
    if name not in NAMES:
        raise KeyError(name)
    path = three_js() if name == "three.js" else ASSETS_FOLDER / name
    return Asset(path.read_bytes(), MEDIA_TYPES[path.suffix])


def three_js() -> Path:
    """Path of the installed three.js."""
    found = find_spec("nicegui")  # finds the package without importing it
    places = [Path(each) / THREE_JS_PATH for each in (found.submodule_search_locations or ())] if found else []
    for path in places:
        if path.is_file():
            return path
    raise InputError("three.js: should be installed with the extra `web` (see `make setup`), got no package nicegui")
