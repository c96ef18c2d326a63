"""Files of the viewer's page, in the folder beside this module; only these names are served.

three.js is release 180 with its glTF loader and orbit controls as one ES module (MIT; NOTICE says where it is from).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

ASSETS_FOLDER = Path(__file__).parent / "assets"
MEDIA_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html; charset=utf-8"}
NAMES = ("stage.js", "style.css", "three.js", "timeline.js", "view.html", "view.js")


@dataclass(frozen=True)
class Asset:
    """A file for a browser."""

    content: bytes
    media: str


@cache
def asset(name: str) -> Asset:
    """Read one of NAMES. Raises KeyError for any other name."""
    if name not in NAMES:
        raise KeyError(name)
    path = ASSETS_FOLDER / name
    return Asset(path.read_bytes(), MEDIA_TYPES[path.suffix])
