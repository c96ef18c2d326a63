"""Unreal: eyes, blinks and head as packets of the Live Link Face app, live or of a motion.

    python live_link_stream.py take/sample_00.npz [--to 127.0.0.1:11111]
    talkingeyes serve &
    python live_link_stream.py SPEECH.wav [--request '{"eye_contact": 0.8}'] [--changes FILE]

Packets are those of unreal_live_link.py: 52 coefficients, of which the 14 of the eyes move, then yaw, pitch and roll of
head, left eye and right eye in radians. Mouth and brows are 0: in Unreal, take them from your lip animation. Sources,
and what they need: sender.py.
"""

from sender import angles, options, run, send_by_udp
from unreal_live_link import packet

SUBJECT = "TalkingEyes"
COEFFICIENTS = 52
EYE_NAMES = [  # the first of the 52, in the order of the app
    f"eye{what}{side}"
    for side in ("Left", "Right")
    for what in ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")
]


def packets(frame: dict) -> list[bytes]:
    """A frame as the app sends it."""
    return [packet(round(frame["time_s"] * frame["fps"]), values(frame), frame["fps"], SUBJECT)]


def values(frame: dict) -> tuple[float, ...]:
    """The 61 numbers of a frame."""
    eyes = [frame["blendshapes"][name] for name in EYE_NAMES]
    turned = [app_angle for part in ("head", "left_eye", "right_eye") for app_angle in app_angles(frame[part])]
    return (*eyes, *[0.0] * (COEFFICIENTS - len(eyes)), *turned)


def app_angles(quaternion: list[float]) -> tuple[float, float, float]:
    """Yaw, pitch and roll with the signs of the app (docs/formats.md)."""
    yaw, pitch, roll = angles(*quaternion)
    return -yaw, pitch, roll


def main() -> None:
    """Send until the motion or the sound ends."""
    send_by_udp(options(__doc__.splitlines()[0], "127.0.0.1:11111").parse_args(), packets)


if __name__ == "__main__":
    run(main)
