"""Progress of everything that takes longer than a few seconds, on stderr: a bar in a terminal, whole lines elsewhere.

A bar is redrawn in its line, so two processes would overwrite each other, and a log would hold every state. Without a
terminal, or with TALKINGEYES_PROGRESS=lines (`make repro` sets it where two rows of stages run side by side), a line is
written every ten seconds. Neither has colours, so NO_COLOR changes nothing.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from typing import Any, TypeVar

A = TypeVar("A")

MODE_VARIABLE = "TALKINGEYES_PROGRESS"
LINE_INTERVAL_S = 10.0
LINE_FORMAT = "{desc}: {n_fmt} of {total_fmt}, {elapsed} elapsed, {remaining} left"


def progress_bar(items: Iterable[A], title: str, total: int | None = None, **options: Any) -> Any:
    """A tqdm bar over items, as a bar or in lines; `options` are those of tqdm."""
    from tqdm import tqdm

    style: dict[str, Any] = {"file": sys.stderr, "mininterval": 0.5}
    if os.environ.get(MODE_VARIABLE) == "lines" or not sys.stderr.isatty():
        interval = {"mininterval": LINE_INTERVAL_S, "maxinterval": LINE_INTERVAL_S, "delay": LINE_INTERVAL_S}
        style = {"file": _Lines(sys.stderr), "bar_format": LINE_FORMAT, **interval}
    return tqdm(items, desc=title, total=total, **{**style, **options})


class _Lines:
    """Writes every state of a bar as a line of its own."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._last = stream, ""

    def write(self, text: str) -> None:
        """Write a state without what would redraw a line; repetitions are left out."""
        line = text.strip()
        if line and line != self._last:
            self._last = line
            self._stream.write(f"{line}\n")

    def flush(self) -> None:
        """Write through."""
        self._stream.flush()
