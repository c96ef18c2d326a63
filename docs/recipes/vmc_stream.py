"""VMC: eyes, blinks and head by OSC, for VSeeFace, VMagicMirror, Warudo, EVMC4U and others.

    python vmc_stream.py take/sample_00.npz [--to 127.0.0.1:39539]
    talkingeyes serve &
    python vmc_stream.py SPEECH.wav [--request '{"eye_contact": 0.8}'] [--changes FILE]

One UDP packet a frame, an OSC bundle of the Virtual Motion Capture protocol: /VMC/Ext/OK, /VMC/Ext/Bone/Pos of Head,
LeftEye and RightEye (local position and rotation), /VMC/Ext/Blend/Val of Blink_L and Blink_R and of ARKit's 14 eye
coefficients (receivers take those that the avatar has), /VMC/Ext/Blend/Apply, /VMC/Ext/T. The protocol has Unity's axes
(left-handed, +z ahead, +x to the subject's right): x of positions and y and z of quaternions change their sign. Bones
are sent at position 0, which receivers of rotations ignore. Sources, and what they need: sender.py.
"""

from osc import bundle, message
from sender import options, run, send_by_udp

BONES = {"Head": "head", "LeftEye": "left_eye", "RightEye": "right_eye"}
BLINKS = {"Blink_L": "eyeBlinkLeft", "Blink_R": "eyeBlinkRight"}  # of VRM 0.x, which the protocol uses


def packets(frame: dict) -> list[bytes]:
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
    return [bundle(messages)]


def to_unity(quaternion: list[float]) -> tuple[float, float, float, float]:
    """A rotation in Unity's axes: mirrored in x."""
    x, y, z, w = quaternion
    return x, -y, -z, w


def main() -> None:
    """Send until the motion or the sound ends."""
    send_by_udp(options(__doc__.splitlines()[0], "127.0.0.1:39539").parse_args(), packets)


if __name__ == "__main__":
    run(main)
