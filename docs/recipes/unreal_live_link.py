"""Unreal: plays the table of `talkingeyes export -f livelink` to a Live Link source, as the Live Link Face app would.

    python unreal_live_link.py HEAD.csv [--to 127.0.0.1:11111] [--subject TalkingEyes] [--loop]

In Unreal enable the plugins Live Link and Apple ARKit Face Support; Window > Virtual Production > Live Link then lists
the subject, and a MetaHuman or any head with ARKit's curves takes it. One UDP packet a frame: version, id, subject,
frame time, frame rate, 61 numbers in the order of the table (52 coefficients, then nine angles in radians).
Needs nothing but Python.
"""

import argparse
import csv
import socket
import struct
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

VERSION = 6
VALUES = 61


@dataclass(frozen=True)
class Take:
    """Frames of 61 numbers, and how many a second."""

    fps: float
    frames: list[tuple[float, ...]]


def read_take(path: Path) -> Take:
    """The table, whose rate follows from its time codes (HH:MM:SS:FF.fff)."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    frames = [tuple(float(value) for value in row[2 : 2 + VALUES]) for row in rows]
    seconds: dict[str, int] = {}
    for row in rows:
        second = row[0].rpartition(":")[0]
        seconds[second] = seconds.get(second, 0) + 1
    whole = list(seconds.values())[:-1]  # the last second may be cut
    return Take(float(max(whole, default=len(rows))), frames)


def packet(frame: int, values: tuple[float, ...], fps: float, subject: str) -> bytes:
    """A frame as the app sends it."""
    name = subject.encode()
    own = f"${uuid.uuid5(uuid.NAMESPACE_DNS, subject)}".encode()
    head = struct.pack("<i", VERSION) + own + struct.pack("!i", len(name)) + name
    return head + struct.pack("!if2i", frame, 0.0, round(fps), 1) + struct.pack(f"!B{VALUES}f", VALUES, *values)


def in_time(take: Take, loop: bool) -> Iterator[int]:
    """Frames when their time has come; one that is late is not sent twice."""
    start, index = time.monotonic(), 0
    while loop or index < len(take.frames):
        time.sleep(max(start + index / take.fps - time.monotonic(), 0.0))
        yield index
        index += 1


def main() -> None:
    """Send a take."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("table", type=Path)
    parser.add_argument("--to", default="127.0.0.1:11111")
    parser.add_argument("--subject", default="TalkingEyes")
    parser.add_argument("--loop", action="store_true")
    given = parser.parse_args()
    host, _, port = given.to.rpartition(":")
    take = read_take(given.table)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for index in in_time(take, given.loop):
            values = take.frames[index % len(take.frames)]
            link.sendto(packet(index, values, take.fps, given.subject), (host, int(port)))
    print(f"{len(take.frames)} frames at {take.fps:g} a second to {given.to}")


if __name__ == "__main__":
    main()
