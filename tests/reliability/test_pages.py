"""Names from outside in the pages that are written."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

from talkingeyes.tracking.journal import ShotRecord
from talkingeyes.tracking.report import VideoResult, write_page
from talkingeyes.tracking.sources import VideoSource


def test_the_name_of_a_video_is_text_in_the_page_of_thumbnails(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(1)>.mp4"
    shot = Mock(spec=ShotRecord, id="a", start_s=0.0, stop_s=1.0, reason="<b>")
    source = Mock(spec=VideoSource)
    source.name = name
    write_page(tmp_path / "thumbnails.html", {"a": 'a".jpg'}, [Mock(spec=VideoResult, source=source, entries=[shot])])
    text = (tmp_path / "thumbnails.html").read_text()
    assert "<img src=x" not in text
    assert "&lt;img src=x" in text
    assert "<b>" not in text
