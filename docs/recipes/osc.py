"""Messages of Open Sound Control 1.0 (opensoundcontrol.org), for vmc_stream.py and vrchat_stream.py."""

import struct

IMMEDIATELY = struct.pack(">Q", 1)  # the time tag


def message(address: str, *values: str | int | float) -> bytes:
    """A message of strings, int32 and float32."""
    tags = "".join({str: "s", int: "i", float: "f"}[type(value)] for value in values)
    packed = [
        text(value) if isinstance(value, str) else struct.pack(f">{tag}", value)
        for tag, value in zip(tags, values, strict=True)
    ]
    return text(address) + text(f",{tags}") + b"".join(packed)


def bundle(messages: list[bytes]) -> bytes:
    """Messages that take effect together."""
    return text("#bundle") + IMMEDIATELY + b"".join(struct.pack(">i", len(each)) + each for each in messages)


def text(value: str) -> bytes:
    """A string: ends with a zero, padded to four bytes."""
    data = value.encode() + b"\0"
    return data + b"\0" * (-len(data) % 4)
