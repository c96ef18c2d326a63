"""Decodes OSC by hand, from opensoundcontrol.org (OSC 1.0), independent of the encoder of the recipes."""

from __future__ import annotations

import struct
from typing import Any


def osc_message(data: bytes) -> tuple[str, list[Any]]:
    """Address and values of a message."""
    assert len(data) % 4 == 0
    address, here = _string(data, 0)
    tags, here = _string(data, here)
    values: list[Any] = []
    for tag in tags[1:]:
        if tag == "s":
            value, here = _string(data, here)
            values.append(value)
        else:
            values.append(struct.unpack_from(f">{tag}", data, here)[0])
            here += 4
    assert tags[0] == "," and here == len(data)
    return address, values


def osc_bundle(packet: bytes) -> list[tuple[str, list[Any]]]:
    """Address and values of each message of a bundle."""
    assert packet[:8] == b"#bundle\0" and packet[8:16] == bytes(7) + b"\1"
    found, at = [], 16
    while at < len(packet):
        size = int.from_bytes(packet[at : at + 4], "big")
        found.append(osc_message(packet[at + 4 : at + 4 + size]))
        at += 4 + size
    return found


def _string(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("ascii"), (end // 4 + 1) * 4
