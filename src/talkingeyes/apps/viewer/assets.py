"""Files of a page, kept in memory, and those of the viewer's, in the folder beside this module.

three.js is release 180 with its glTF loader and orbit controls as one ES module (MIT; NOTICE says where it is from).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ASSETS_FOLDER = Path(__file__).parent / "assets"
MEDIA_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html; charset=utf-8"}
NAMES = ("stage.js", "style.css", "three.js", "timeline.js", "view.html", "view.js")


@dataclass(frozen=True)
class Asset:
    """A file for a browser."""

    content: bytes
    media: str


def read_assets(folder: Path, names: Iterable[str]) -> dict[str, Asset]:
    """Files of a folder by the name that a browser requests: the page itself, the one in HTML, has none."""
    paths = [folder / name for name in names]
    return {
        "" if path.suffix == ".html" else path.name: Asset(path.read_bytes(), MEDIA_TYPES[path.suffix])
        for path in paths
    }
