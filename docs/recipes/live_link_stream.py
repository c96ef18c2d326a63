"""Unreal, live: eyes, blinks and head of a live stream as packets of the Live Link Face app.

    talkingeyes serve &
    python live_link_stream.py SPEECH.wav [--to 127.0.0.1:11111] [--request '{"eye_contact": 0.8}'] [--changes FILE]

Packets are those of unreal_live_link.py: 52 coefficients, of which the 14 of the eyes move, then yaw, pitch and roll of
head, left eye and right eye in radians. Mouth and brows are 0: in Unreal, take them from your lip animation. A
microphone instead of a file: live_frames.py. Needs websockets; soundfile for files.
"""

import math
import socket

from live_frames import arguments, chunks, live_frames
from unreal_live_link import packet

SUBJECT, FPS = "TalkingEyes", 25.0
COEFFICIENTS = 52
EYE_NAMES = [  # the first of the 52, in the order of the app
    f"eye{what}{side}"
    for side in ("Left", "Right")
    for what in ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")
]


def values(frame: dict) -> tuple[float, ...]:
    """The 61 numbers of a frame."""
    eyes = [frame["blendshapes"][name] for name in EYE_NAMES]
    angles = [angle for part in ("head", "left_eye", "right_eye") for angle in app_angles(*frame[part])]
    return (*eyes, *[0.0] * (COEFFICIENTS - len(eyes)), *angles)


def app_angles(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Yaw, pitch and roll of a quaternion, R = Ry Rx Rz, with the signs of the app (docs/formats.md)."""
    yaw = math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * x - y * z))))
    roll = math.atan2(2 * (x * y + w * z), 1 - 2 * (x * x + z * z))
    return -yaw, pitch, roll


def main() -> None:
    """Send until the sound ends."""
    given = arguments(__doc__.splitlines()[0], "127.0.0.1:11111")
    host, _, port = given.to.rpartition(":")
    count = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for frame in live_frames(chunks(given.speech), given.stream, given.request, given.changes):
            link.sendto(packet(count, values(frame), FPS, SUBJECT), (host, int(port)))
            count += 1
    print(f"{count} frames to {given.to}")


if __name__ == "__main__":
    main()
