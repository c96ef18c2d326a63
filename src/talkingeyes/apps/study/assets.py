"""Files of the study's page."""

from __future__ import annotations

from pathlib import Path

from talkingeyes.apps.viewer.assets import MEDIA_TYPES, Asset

FOLDER = Path(__file__).parent / "assets"
NAMES = ("study.css", "study.html", "study.js")


def page_assets() -> dict[str, Asset]:
    """Files by the name that a browser requests."""
    found = {name: Asset((FOLDER / name).read_bytes(), MEDIA_TYPES[Path(name).suffix]) for name in NAMES}
    return {**found, "": found["study.html"]}
