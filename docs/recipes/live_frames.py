"""Frames of a live stream of `talkingeyes serve`, for senders to other programs (sender.py).

    for frame in live_frames(chunks("SPEECH.wav"), "ws://127.0.0.1:8030/stream", {"seed": 1}):
        frame["head"], frame["left_eye"], frame["blendshapes"]["eyeBlinkLeft"]

A file is sent at the speed at which it is spoken. `-` reads 16-bit PCM, 16 kHz, mono from the standard input, such as a
microphone: `arecord -q -t raw -f S16_LE -r 16000 -c 1 | python SENDER.py -`. Each line that is added to the file of
changes is sent: `echo '{"target": [0.3, 0, 1]}' >> FILE`. Needs websockets; soundfile for files.
"""

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from stream_client import connect_when_ready
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection

RATE, CHUNK = 16_000, 640  # samples: 40 ms


def chunks(speech: str) -> Iterator[bytes]:
    """Sound of 40 ms when its time has come. Raises ValueError for another rate or more channels."""
    if speech == "-":
        while chunk := sys.stdin.buffer.read(2 * CHUNK):
            yield chunk[: len(chunk) // 2 * 2]
        return
    import soundfile

    sound, rate = soundfile.read(speech, dtype="int16")
    if rate != RATE or sound.ndim != 1:
        raise ValueError(f"{speech}: should be 16 kHz mono, got {rate} Hz with {sound.ndim} dimensions")
    started = time.monotonic()
    for start in range(0, len(sound), CHUNK):
        time.sleep(max(0.0, started + (start + CHUNK) / RATE - time.monotonic()))
        yield sound[start : start + CHUNK].tobytes()


def live_frames(sound: Iterator[bytes], url: str, request: dict, changes: Path | None = None) -> Iterator[dict]:
    """Frames (docs/live.md) as they come, with their `fps`. Raises RuntimeError with the reason of the service."""
    try:
        with connect_when_ready(url) as socket:
            socket.send(json.dumps({**request, "format": "json"}))
            fps = _content(socket.recv())["fps"]
            for frame in _received_while_sending(socket, sound, changes):
                yield {**frame, "fps": fps}
    except (ConnectionError, WebSocketException) as error:
        raise RuntimeError(f"{url}: {error}") from None


def _received_while_sending(socket: ClientConnection, sound: Iterator[bytes], changes: Path | None) -> Iterator[dict]:
    sent = 0
    for chunk in sound:
        lines = changes.read_text().splitlines() if changes and changes.exists() else []
        for line in lines[sent:]:
            socket.send(json.dumps({"set": json.loads(line)}))
        sent = max(sent, len(lines))
        socket.send(chunk)
        yield from _received(socket, timeout=0)
    socket.send(json.dumps({"end": True}))
    while "end" not in (content := _content(socket.recv())):
        yield from content.get("frames", ())


def _received(socket: ClientConnection, timeout: float) -> Iterator[dict]:
    """Frames of the messages that have come."""
    while True:
        try:
            content = _content(socket.recv(timeout=timeout))
        except TimeoutError:
            return
        yield from content.get("frames", ())


def _content(message: str | bytes) -> dict:
    content = json.loads(message)
    if "error" in content:
        raise RuntimeError(content["error"])
    return content
