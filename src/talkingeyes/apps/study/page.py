"""The files of the study's page."""

from __future__ import annotations

from pathlib import Path

from talkingeyes.apps.viewer.assets import MEDIA, Asset

FOLDER = Path(__file__).parent / "assets"
NAMES = ("study.css", "study.html", "study.js")


def files() -> dict[str, Asset]:
    """By the name that a browser asks for."""
    found = {name: Asset((FOLDER / name).read_bytes(), MEDIA[Path(name).suffix]) for name in NAMES}
    return {**found, "": found["study.html"]}
