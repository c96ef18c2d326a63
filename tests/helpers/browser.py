"""Headless Chromium for tests of pages, controlled over its pipe (DevTools protocol: JSON messages separated by NUL).

The Debian package is chromium. WebGL is rendered by SwiftShader on the CPU.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--autoplay-policy=no-user-gesture-required",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-background-networking",
    "--remote-debugging-pipe",
)


class Browser:
    """A page in a running browser."""

    def __init__(self, commands: int, answers: int) -> None:
        self.commands, self.answers = commands, answers
        self.buffer, self.calls = b"", 0
        self.session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Page.enable")

    def call(self, method: str, **params: Any) -> Any:
        """Send a command and return its result; other messages of the browser are ignored."""
        self.calls += 1
        message = {"id": self.calls, "method": method, "params": params}
        if self.session is not None:
            message["sessionId"] = self.session
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self.buffer:
                self.buffer += os.read(self.answers, 1 << 16)
            text, _, self.buffer = self.buffer.partition(b"\0")
            answer = json.loads(text)
            if answer.get("id") == self.calls:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, address: str) -> None:
        """Navigate to a page and wait until it is loaded."""
        self.call("Page.navigate", url=address)
        self.wait_for("document.readyState == 'complete'")

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page; promises are awaited."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait_for(self, expression: str, seconds: float = 60.0) -> Any:
        """Wait until an expression is true and return its value."""
        for _ in range(int(seconds / 0.1)):
            found = self.value(expression)
            if found:
                return found
            time.sleep(0.1)
        raise AssertionError(
            f"not true within {seconds} s: {expression}; page: {self.value('document.body.innerText')}"
        )

    def screenshot(self, path: Path) -> None:
        """Save a screenshot of the page as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def open_browser(profile: Path, width: int = 1400, height: int = 1000) -> Iterator[Browser]:
    """A browser with an empty profile in a folder; closed on exit."""
    assert CHROMIUM is not None
    to_browser, from_us = os.pipe()
    to_us, from_browser = os.pipe()

    def wired() -> None:  # Chromium reads from file descriptor 3 and writes to 4
        read, write = os.dup(to_browser), os.dup(from_browser)
        os.dup2(read, 3)
        os.dup2(write, 4)

    command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}"]
    process = subprocess.Popen(
        command,
        preexec_fn=wired,  # noqa: PLW1509 (no threads are started here)
        pass_fds=(3, 4, to_browser, from_browser),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.close(to_browser)
    os.close(from_browser)
    try:
        yield Browser(from_us, to_us)
    finally:
        os.killpg(process.pid, 15)
        process.wait(timeout=60)
        os.close(from_us)
        os.close(to_us)
