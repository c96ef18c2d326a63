"""What the senders share: where frames come from, and how they go out.

    python SENDER.py take/sample_00.npz     a motion of `talkingeyes animate`, at its frame rate; needs talkingeyes
    python SENDER.py SPEECH.wav             a live stream of a running `talkingeyes serve`; needs websockets, soundfile
    arecord ... | python SENDER.py -        the same of a microphone (live_frames.py)

Frames are those of docs/live.md, with their `fps`. An error is one line and exit status 2; Ctrl-C ends a sender.
"""

import argparse
import json
import math
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def options(description: str, to: str) -> argparse.ArgumentParser:
    """Options of a sender."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "source", help="a motion (.npz); or sound for a stream: 16 kHz mono, - for PCM on the standard input"
    )
    parser.add_argument("--to", default=to)
    parser.add_argument("--stream", default="ws://127.0.0.1:8030/stream")
    parser.add_argument("--request", type=json.loads, default={}, help='of a stream: {"seed": 1, "eye_contact": 0.8}')
    parser.add_argument("--changes", type=Path, help="of a stream: a file; each line that is added is a change")
    return parser


def frames_of(given: argparse.Namespace) -> Iterator[dict]:
    """Frames of a file or of a stream, each when its time has come."""
    if given.source.endswith(".npz"):
        if given.request or given.changes:
            raise ValueError(f"--request, --changes: should be left out with a motion, got {given.source}")
        return file_frames(Path(given.source))
    from live_frames import chunks, live_frames

    return live_frames(chunks(given.source), given.stream, given.request, given.changes)


def file_frames(path: Path) -> Iterator[dict]:
    """Frames of a motion. Raises talkingeyes.InputError (a ValueError)."""
    from talkingeyes import Motion
    from talkingeyes.animation.line_of_sight import to_forward_axes
    from talkingeyes.apps.service.frame_encoding import json_frames

    motion = to_forward_axes(Motion.load(path))
    if motion.head_model == "flame":  # its expression has none of the coefficients of a frame
        motion = Motion.of(motion.fps, motion.head, motion.gaze, lid=motion.lid)
    frames = json.loads(json_frames(motion, 0))["frames"]
    started = time.monotonic()
    for frame in frames:
        time.sleep(max(0.0, started + frame["time_s"] - time.monotonic()))
        yield {**frame, "fps": motion.fps}


def send_frames(frames: Iterable[dict], send: Callable[[dict], None], resend_s: float | None = None) -> int:
    """Send frames, and the newest again whenever `resend_s` pass without one. Returns the number of frames."""
    count, newest, ended, came = 0, None, False, threading.Condition()

    def resend() -> None:
        with came:
            while not ended:
                if not came.wait(resend_s) and newest:
                    send(newest)

    with ThreadPoolExecutor(1) as pool:
        resending = pool.submit(resend)
        try:
            for newest in frames:
                with came:
                    send(newest)
                    came.notify()
                count += 1
        finally:
            with came:
                ended = True
                came.notify()
        resending.result()
    return count


def send_by_udp(
    given: argparse.Namespace,
    packets: Callable[[dict], list[bytes]],
    resend_s: float | None = None,
    last: Iterable[bytes] = (),
) -> None:
    """Send the packets of each frame, and at the end, also after Ctrl-C, the last ones."""
    host, _, port = given.to.rpartition(":")
    if not port.isdecimal():
        raise ValueError(f"--to: should be HOST:PORT, got {given.to}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:

        def send(all_packets: Iterable[bytes]) -> None:
            for each in all_packets:
                link.sendto(each, (host, int(port)))

        try:
            count = send_frames(frames_of(given), lambda frame: send(packets(frame)), resend_s)
        finally:
            send(last)
    print(f"{count} frames to {given.to}")


def run(main: Callable[[], None]) -> None:
    """Run a sender; what goes wrong is one line."""
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        sys.exit(2)


def angles(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Yaw (to the subject's left), pitch (down), roll (to the right shoulder) in radians of Ry Rx Rz."""
    yaw = math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * x - y * z))))
    roll = math.atan2(2 * (x * y + w * z), 1 - 2 * (x * x + z * z))
    return yaw, pitch, roll
