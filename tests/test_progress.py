"""Progress on stderr: whole lines in a log and beside other processes, a bar in a terminal."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
import termios

import pytest

from talkingeyes.core import progress

SCRIPT = """
import sys, time
from talkingeyes.core import progress
progress.LINE_INTERVAL_S = 0.05
for _ in progress.progress_bar(range(4), sys.argv[1]):
    time.sleep(0.1)
"""


def test_a_log_has_whole_lines() -> None:
    command = [sys.executable, "-c", SCRIPT, "train one"]
    written = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stderr
    assert "\r" not in written
    assert "\x1b" not in written
    lines = written.splitlines()
    assert len(lines) >= 2
    assert all(line.startswith("train one: ") and line.endswith(" left") for line in lines)
    assert lines[-1].startswith("train one: 4 of 4, ")


@pytest.fixture(autouse=True)
def _default_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(progress.MODE_VARIABLE, raising=False)


def in_terminal(**environment: str) -> str:
    """What a process writes to a terminal."""
    main, other = pty.openpty()
    termios.tcsetwinsize(other, (24, 80))
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, "train one"], stderr=other, env={**os.environ, **environment}
    ) as process:
        os.close(other)
        written = b""
        try:
            while part := os.read(main, 4096):
                written += part
        except OSError:  # the end of a terminal
            pass
        assert process.wait(60) == 0
    os.close(main)
    return written.decode()


def test_a_terminal_has_a_bar_unless_lines_are_wanted() -> None:
    assert "\r" in in_terminal().replace("\r\n", "\n")
    side_by_side = in_terminal(TALKINGEYES_PROGRESS="lines", NO_COLOR="1").replace("\r\n", "\n")
    assert "\r" not in side_by_side
    assert "\x1b" not in side_by_side
    assert "train one: 4 of 4" in side_by_side


def test_short_work_writes_nothing_to_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream := io.StringIO())
    assert list(progress.progress_bar(iter([1, 2]), "short", 2)) == [1, 2]
    assert stream.getvalue() == ""
