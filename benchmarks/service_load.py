"""Load test of live streams: latency of real-time speech on every stream, and rejection of one stream too many.

Run: python -m benchmarks.service_load [MODEL] [--streams 20] [--seconds 20] [--jobs 2] Starts `talkingeyes serve` on a
free port of 127.0.0.1 and feeds streams with 40 ms of sound every 40 ms. Prints the latency of frames over all streams
(from the time of a frame until it is received, including sound, inference and transfer), its percentiles, lost frames,
the response to one stream too many, and the CPU seconds of the service.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import websockets
from websockets.asyncio.client import ClientConnection, connect

from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import SAMPLE_RATE, frame_count, read_speech

CHUNK_S = 0.04
STAGGER_S = 0.16  # starts of streams are spread over the duration of a gaze code, as in practice


@dataclass
class StreamResult:
    """Results of one stream: latency of each received frame, and the expected number of frames."""

    latencies_s: list[float] = field(default_factory=list)
    frames: int = 0
    expected: int = 0
    error: str = ""


async def stream(address: str, sound: np.ndarray, wait_s: float, seed: int) -> StreamResult:
    """Send a sound in real time and receive the frames."""
    await asyncio.sleep(wait_s)
    heard = StreamResult()
    try:
        async with connect(address, max_size=None, ping_interval=None) as socket:
            await socket.send(json.dumps({"seed": seed}))
            about = json.loads(await socket.recv())
            if "error" in about:
                return StreamResult(error=about["error"])
            heard.expected = frame_count(len(sound), about["fps"])
            begun = time.monotonic()
            speaking = asyncio.create_task(_speak(socket, sound, begun))
            async for message in socket:
                if isinstance(message, str):
                    break
                count = (len(message) - 4) // (4 * about["columns"])
                first = int.from_bytes(message[:4], "little")
                now = time.monotonic() - begun
                heard.latencies_s += [now - (first + index) / about["fps"] for index in range(count)]
                heard.frames += count
            await speaking
    except (OSError, websockets.WebSocketException) as error:
        heard.error = str(error)
    return heard


async def _speak(socket: ClientConnection, sound: np.ndarray, begun: float) -> None:
    """Send each chunk at the time of its last sample."""
    size = round(CHUNK_S * SAMPLE_RATE)
    samples = np.round(sound * 32767).astype("<i2")
    for start in range(0, len(samples), size):
        chunk = samples[start : start + size]
        await asyncio.sleep(max(begun + (start + len(chunk)) / SAMPLE_RATE - time.monotonic(), 0))
        await socket.send(chunk.tobytes())
    await socket.send('{"end": true}')


async def load(address: str, sound: np.ndarray, streams: int) -> list[StreamResult]:
    """Run all streams at once, and one more than allowed halfway through."""
    turns = [stream(address, sound, STAGGER_S * index / streams, index) for index in range(streams)]
    one_more = stream(address, sound[:SAMPLE_RATE], len(sound) / SAMPLE_RATE / 2, streams)
    return list(await asyncio.gather(*turns, one_more))


def report(found: list[StreamResult], cpu_s: float, seconds: float) -> None:
    """Print the results."""
    *streams, one_more = found
    errors = [each.error for each in streams if each.error]
    lost = sum(each.expected - each.frames for each in streams)
    latencies = np.concatenate([each.latencies_s for each in streams]) * 1000
    print(f"{len(streams)} streams of {seconds:.0f} s: {len(latencies)} frames, {lost} lost, {len(errors)} errors")
    for error in sorted(set(errors)):
        print(f"  error: {error}")
    if len(latencies):
        marks = np.percentile(latencies, [50, 90, 99, 100])
        print("latency ms: " + ", ".join(f"p{p} {v:.0f}" for p, v in zip((50, 90, 99, 100), marks, strict=True)))
        print(f"within 400 ms: {np.mean(latencies <= 400):.1%}")
    print(f"CPU of the service: {cpu_s:.1f} s, {cpu_s / len(streams) / seconds:.3f} per second of a stream")
    print(f"one more stream: {one_more.error or 'was accepted'}")


def cpu_of(pid: int) -> float:
    """CPU seconds of a process and its descendants."""
    total, todo = 0.0, [pid]
    while todo:
        one = todo.pop()
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        todo += [int(child) for child in Path(f"/proc/{one}/task/{one}/children").read_text().split()]
    return total


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default="data/train/talkingeyes_live")
    parser.add_argument("--streams", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    sound = read_speech(package_file(EXAMPLE_SPEECH))
    sound = np.resize(sound, round(asked.seconds * SAMPLE_RATE))
    command = [
        sys.executable,
        "-m",
        "talkingeyes.cli.main",
        "serve",
        "--model",
        asked.model,
        "--live-model",
        asked.model,
    ]
    command += ["--streams", str(asked.streams), "--jobs", str(asked.jobs), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as service:
        assert service.stdout is not None
        said = service.stdout.readline()
        if not said:  # the service has printed the error
            sys.exit(service.wait())
        address = said.split()[0].replace("http", "ws") + "stream"
        asyncio.run(stream(address, sound[:SAMPLE_RATE], 0.0, 0))  # afterwards, the processes have loaded their models
        before = cpu_of(service.pid)
        found = asyncio.run(load(address, sound, asked.streams))
        report(found, cpu_of(service.pid) - before, asked.seconds)
        service.terminate()


if __name__ == "__main__":
    main()
