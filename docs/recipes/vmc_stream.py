"""VMC, live: eyes, blinks and head of a live stream by OSC, for VSeeFace, VMagicMirror, Warudo, EVMC4U and others.

    talkingeyes serve &
    python vmc_stream.py SPEECH.wav [--to 127.0.0.1:39539] [--request '{"eye_contact": 0.8}'] [--changes FILE]

One UDP packet a frame, an OSC bundle of the Virtual Motion Capture protocol: /VMC/Ext/OK, /VMC/Ext/Bone/Pos of Head,
LeftEye and RightEye (local position and rotation), /VMC/Ext/Blend/Val of Blink_L and Blink_R and of ARKit's 14 eye
coefficients (receivers take those that the avatar has), /VMC/Ext/Blend/Apply, /VMC/Ext/T. The protocol has Unity's axes
(left-handed, +z ahead, +x to the subject's right): x of positions and y and z of quaternions change their sign. Bones
are sent at position 0, which receivers of rotations ignore. A microphone instead of a file: live_frames.py.
Needs websockets; soundfile for files.
"""

import socket
import struct

from live_frames import arguments, chunks, live_frames

BONES = {"Head": "head", "LeftEye": "left_eye", "RightEye": "right_eye"}
BLINKS = {"Blink_L": "eyeBlinkLeft", "Blink_R": "eyeBlinkRight"}  # of VRM 0.x, which the protocol uses
IMMEDIATELY = struct.pack(">Q", 1)  # the time tag of OSC


def bundle(frame: dict) -> bytes:
    """A frame as an OSC bundle."""
    shapes = frame["blendshapes"]
    weights = {name: shapes[ours] for name, ours in BLINKS.items()} | shapes
    messages = [
        message("/VMC/Ext/OK", 1),
        *(message("/VMC/Ext/Bone/Pos", bone, 0.0, 0.0, 0.0, *to_unity(frame[part])) for bone, part in BONES.items()),
        *(message("/VMC/Ext/Blend/Val", name, float(weight)) for name, weight in weights.items()),
        message("/VMC/Ext/Blend/Apply"),
        message("/VMC/Ext/T", float(frame["time_s"])),
    ]
    return text("#bundle") + IMMEDIATELY + b"".join(struct.pack(">i", len(each)) + each for each in messages)


def to_unity(quaternion: list[float]) -> tuple[float, float, float, float]:
    """A rotation in Unity's axes: mirrored in x."""
    x, y, z, w = quaternion
    return x, -y, -z, w


def message(address: str, *values: str | int | float) -> bytes:
    """An OSC message of strings, int32 and float32."""
    tags = "".join({str: "s", int: "i", float: "f"}[type(value)] for value in values)
    packed = [
        text(value) if isinstance(value, str) else struct.pack(f">{tag}", value)
        for tag, value in zip(tags, values, strict=True)
    ]
    return text(address) + text(f",{tags}") + b"".join(packed)


def text(value: str) -> bytes:
    """A string of OSC: ends with a zero, padded to four bytes."""
    data = value.encode() + b"\0"
    return data + b"\0" * (-len(data) % 4)


def main() -> None:
    """Send until the sound ends."""
    given = arguments(__doc__.splitlines()[0], "127.0.0.1:39539")
    host, _, port = given.to.rpartition(":")
    count = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for frame in live_frames(chunks(given.speech), given.stream, given.request, given.changes):
            link.sendto(bundle(frame), (host, int(port)))
            count += 1
    print(f"{count} frames to {given.to}")


if __name__ == "__main__":
    main()
