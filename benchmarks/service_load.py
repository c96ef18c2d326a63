"""Load test of live streams: latency of real-time speech on every stream, cost, memory, and what happens beyond that.

Run: python -m benchmarks.service_load [MODEL] [--clients 50] [--seconds 40] [--jobs 2] [--hostile]

Starts `talkingeyes serve` on a free port of 127.0.0.1 and feeds each stream with 40 ms of sound every 40 ms. Prints the
latency of frames over all streams (from the time of a frame until it is received, so with the model's lookahead), lost
frames, streams refused, what the service says of itself, CPU seconds, and at start and end memory, threads and files.
`--hostile` adds clients that send half a request, do not read, send too fast, noise or too much, or leave.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import random
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass, field

import numpy as np
import psutil
import websockets
from websockets.asyncio.client import ClientConnection, connect

from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import SAMPLE_RATE, frame_count, read_speech

CHUNK_S = 0.04
STAGGER_S = 0.08  # starts of streams are spread over the duration of a bin of gaze, as in practice
TOLD = ("waiting_seconds", "lateness_seconds", "load")
HALF_REQUEST = b"POST /performances HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nRIFF"
REQUESTS = ("{}", "{}", "{}", '{"channels": 2}', "[", '{"seed": -1}')
MESSAGES = (b"\0" * 64_000, b"\0" * 64_000, b"\1" * 1281, b"\0" * 200_000, '{"set": {"state": 1}}')


@dataclass
class StreamResult:
    """Results of one stream: latency of each received frame, and the expected number of frames."""

    latencies_s: list[float] = field(default_factory=list)
    frames: int = 0
    expected: int = 0
    behind_messages: int = 0
    error: str = ""


async def stream(address: str, sound: np.ndarray, wait_s: float, seed: int) -> StreamResult:
    """Send a sound in real time and receive the frames."""
    await asyncio.sleep(wait_s)
    result = StreamResult()
    try:
        async with connect(f"{address}stream", max_size=None, ping_interval=None, open_timeout=60) as socket:
            await socket.send(json.dumps({"seed": seed}))
            about = json.loads(await socket.recv())
            if "error" in about:
                return StreamResult(error=about["error"])
            result.expected = frame_count(len(sound), about["fps"])
            begun = time.monotonic()
            speaking = asyncio.create_task(_speak(socket, sound, begun))
            async for message in socket:
                if isinstance(message, str):
                    content = json.loads(message)
                    result.behind_messages += "behind_s" in content
                    result.error = content.get("error", "")
                    continue
                count = (len(message) - 4) // (4 * about["columns"])
                first = int.from_bytes(message[:4], "little")
                now = time.monotonic() - begun
                result.latencies_s += [now - (first + index) / about["fps"] for index in range(count)]
                result.frames += count
            await speaking
    except (OSError, websockets.WebSocketException) as error:
        received = getattr(error, "rcvd", None)
        result.error = received.reason if received else str(error)
    return result


async def _speak(socket: ClientConnection, sound: np.ndarray, begun: float) -> None:
    """Send each chunk at the time of its last sample."""
    size = round(CHUNK_S * SAMPLE_RATE)
    samples = np.round(sound * 32767).astype("<i2")
    for start in range(0, len(samples), size):
        chunk = samples[start : start + size]
        await asyncio.sleep(max(begun + (start + len(chunk)) / SAMPLE_RATE - time.monotonic(), 0))
        await socket.send(chunk.tobytes())
    await socket.send('{"end": true}')


async def hostile(address: str, port: int, seed: int) -> None:
    """Be one bad client after the other, until cancelled."""
    draw = random.Random(seed)
    while True:
        with contextlib.suppress(OSError, websockets.WebSocketException, TimeoutError):
            if draw.random() < 0.3:
                _, writer = await asyncio.open_connection("127.0.0.1", port)
                writer.write(HALF_REQUEST[: draw.randint(1, len(HALF_REQUEST))])
                await asyncio.sleep(5 * draw.random())
                writer.close()
                continue
            async with connect(f"{address}stream", ping_interval=None, open_timeout=60) as socket:
                await socket.send(draw.choice(REQUESTS))
                message = draw.choice(MESSAGES)
                for _ in range(draw.randint(1, 20)):  # faster than spoken, and never read
                    await asyncio.wait_for(socket.send(message), 5)
                if draw.random() < 0.5:
                    socket.transport.abort()
        await asyncio.sleep(draw.random())


async def load(
    address: str, port: int, sound: np.ndarray, clients: int, hostiles: int
) -> tuple[list[StreamResult], str]:
    """Run all clients at once; returns their results, and what the service said of itself a second before the end."""
    bad = [asyncio.create_task(hostile(address, port, seed)) for seed in range(hostiles)]
    streams = [stream(address, sound, STAGGER_S * index / clients, index) for index in range(clients)]
    asked = asyncio.create_task(_metrics(port, len(sound) / SAMPLE_RATE - 1))
    found = await asyncio.gather(*streams)
    for each in bad:
        each.cancel()
    return list(found), await asked


async def _metrics(port: int, wait_s: float) -> str:
    await asyncio.sleep(max(wait_s, 0))
    answer = await asyncio.to_thread(urllib.request.urlopen, f"http://127.0.0.1:{port}/metrics", timeout=60)
    with answer:
        lines = [line.removeprefix("talkingeyes_") for line in answer.read().decode().splitlines()]
    return "\n".join(line for line in lines if line.startswith(TOLD))


def report(found: list[StreamResult], cpu_s: float) -> None:
    """Print the results."""
    admitted = [each for each in found if each.expected]
    latencies = np.concatenate([each.latencies_s for each in admitted]) * 1000
    lost = sum(each.expected - each.frames for each in admitted)
    print(f"{len(found)} clients, {len(admitted)} admitted: {len(latencies)} frames, {lost} lost")
    errors = [each.error for each in found if each.error]
    for error in sorted(set(errors)):
        print(f"  {errors.count(error)} times: {error}")
    marks = zip(("p50", "p99", "greatest"), np.percentile(latencies, [50, 99, 100]), strict=True)
    print("latency ms: " + ", ".join(f"{name} {value:.0f}" for name, value in marks))
    notified = sum(each.behind_messages > 0 for each in admitted)
    print(f"within 400 ms: {np.mean(latencies <= 400):.1%}; {notified} streams were notified that they are behind")
    print(f"CPU of the service: {cpu_s:.1f} s, {cpu_s / len(latencies) * 25:.4f} per second of a stream")


class ProcessTree:
    """CPU seconds and sizes of a process and its descendants."""

    def __init__(self, pid: int) -> None:
        root = psutil.Process(pid)
        self._all = [root, *root.children(recursive=True)]

    def cpu_s(self) -> float:
        """User and system seconds."""
        return sum(sum(each.cpu_times()[:2]) for each in self._all)

    def sizes(self) -> str:
        """Memory, threads and open files in one line."""
        memory = sum(each.memory_info().rss for each in self._all) / 1e6
        threads, files = sum(each.num_threads() for each in self._all), sum(each.num_fds() for each in self._all)
        return f"{memory:.0f} MB, {threads} threads, {files} files"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default="data/train/talkingeyes_live")
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--hostile", action="store_true")
    asked = parser.parse_args()
    sound = np.resize(read_speech(package_file(EXAMPLE_SPEECH)), round(asked.seconds * SAMPLE_RATE))
    command = [sys.executable, "-m", "talkingeyes.cli.main", "serve", "--live-model", asked.model]
    command += ["--jobs", str(asked.jobs), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as service:
        assert service.stdout is not None
        said = service.stdout.readline()
        if not said:  # the service has printed the error
            sys.exit(service.wait())
        address = said.split()[0].replace("http", "ws")
        port = int(address.rstrip("/").rpartition(":")[2])
        asyncio.run(load(address, port, sound[:SAMPLE_RATE], asked.jobs, 0))  # then the models are loaded
        tree = ProcessTree(service.pid)
        sizes, before = tree.sizes(), tree.cpu_s()
        found, told = asyncio.run(load(address, port, sound, asked.clients, 10 * asked.hostile))
        report(found, tree.cpu_s() - before)
        print(f"{told}\nstart: {sizes}\nend: {tree.sizes()}")
        service.terminate()


if __name__ == "__main__":
    main()
