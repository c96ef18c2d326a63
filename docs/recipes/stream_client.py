"""Send a sound to a running `talkingeyes serve` as a live stream and receive poses while it is sent.

    pip install websockets soundfile
    python stream_client.py SPEECH.wav [ws://127.0.0.1:8030/stream]     # 16 kHz mono; writes SPEECH.poses.csv

A row per frame: translation of the root (3, metres), quaternions x, y, z, w of neck, jaw, left eye and right eye (16),
then weights of blend shapes, in the order of the morph targets of http://127.0.0.1:8030/head.glb.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from pathlib import Path

from websockets.sync.client import ClientConnection, connect

CHUNK_S = 0.04
START_S = 60.0  # time limit for a service that is starting


def stream(sound: bytes, url: str, rate: int = 16_000, seed: int = 0, real_time: bool = True) -> list[list[float]]:
    """Rows of poses for 16-bit mono PCM. Raises RuntimeError with the reason of the server."""
    rows: list[list[float]] = []
    step = 2 * int(CHUNK_S * rate)
    with connect_when_ready(url) as socket:
        socket.send(json.dumps({"seed": seed}))
        about = _json(socket.recv())  # {"fps": 25.0, "latency_s": 0.237, "columns": ...}
        started = time.monotonic()
        for start in range(0, len(sound), step):
            socket.send(sound[start : start + step])
            _receive(socket, rows, about["columns"], timeout=0)
            if real_time:
                time.sleep(max(0.0, started + (start + step) / 2 / rate - time.monotonic()))
        socket.send(json.dumps({"end": True}))
        while _receive(socket, rows, about["columns"], timeout=60):
            pass
    return rows


def connect_when_ready(url: str) -> ClientConnection:
    """A connection to a service that may still be starting."""
    until = time.monotonic() + START_S
    while True:
        try:
            return connect(url)
        except ConnectionRefusedError:
            if time.monotonic() > until:
                raise
            time.sleep(0.5)


def _receive(socket, rows: list[list[float]], columns: int, timeout: float) -> bool:
    """Take all messages that have come; False after the last one of the stream."""
    while True:
        try:
            message = socket.recv(timeout=timeout)
        except TimeoutError:
            return True
        if isinstance(message, str):
            return "end" not in _json(message)
        (first,) = struct.unpack_from("<I", message)  # index of the first frame in this message
        assert first == len(rows)
        values = struct.unpack_from(f"<{(len(message) - 4) // 4}f", message, 4)
        rows += [list(values[start : start + columns]) for start in range(0, len(values), columns)]


def _json(message: str | bytes) -> dict:
    content = json.loads(message)
    if "error" in content:
        raise RuntimeError(content["error"])
    return content


if __name__ == "__main__":
    import soundfile

    file = Path(sys.argv[1])
    speech, rate = soundfile.read(file, dtype="int16")
    if rate != 16_000 or speech.ndim != 1:
        sys.exit(f"{file}: should be 16 kHz mono, got {rate} Hz with {speech.ndim} dimensions")
    poses = stream(speech.tobytes(), sys.argv[2] if len(sys.argv) > 2 else "ws://127.0.0.1:8030/stream")
    out = file.with_suffix(".poses.csv")
    out.write_text("".join(",".join(f"{value:.6g}" for value in row) + "\n" for row in poses))
    print(f"{out}: {len(poses)} frames")
