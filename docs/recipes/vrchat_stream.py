"""VRChat: gaze and blinks by OSC eye tracking.

    python vrchat_stream.py take/sample_00.npz [--to 127.0.0.1:9000]
    talkingeyes serve &
    python vrchat_stream.py SPEECH.wav [--request '{"eye_contact": 0.8}'] [--changes FILE]

Two UDP packets a frame, an OSC message each, as docs.vrchat.com/docs/osc-eye-tracking describes them:

- /tracking/eye/LeftRightPitchYaw, the one gaze address of those that may be used at a time: pitch and yaw of the left
  eye, then of the right, in degrees about the head, positive down and to the user's right. Ours are positive down
  (rotation about +x) and to the left, so yaw changes its sign. Each eye keeps its own direction: the avatar converges.
- /tracking/eye/EyesClosedAmount: 0 open to 1 closed, one value for both eyes, so the mean: one eye shut is 0.5.

VRChat returns to its own gaze and blinks 10 s after the last message. The newest frame is therefore sent again every
4 s while none comes. At the end the eyes are opened and turned straight ahead, and VRChat takes over 10 s later. The
head is the user's own. Sources, and what they need: sender.py.
"""

import math

from osc import message
from sender import angles, options, run, send_by_udp

RESEND_S = 4.0


def packets(frame: dict) -> list[bytes]:
    """Gaze and lids of a frame."""
    left, right = (angles(*frame[eye]) for eye in ("left_eye", "right_eye"))
    shut = (frame["blendshapes"]["eyeBlinkLeft"] + frame["blendshapes"]["eyeBlinkRight"]) / 2
    return messages([math.degrees(angle) for yaw, pitch, _ in (left, right) for angle in (pitch, -yaw)], shut)


def messages(pitch_yaw_deg: list[float], shut: float) -> list[bytes]:
    """Pitch and yaw of the left eye and of the right in VRChat's signs, and how far both are shut."""
    return [
        message("/tracking/eye/LeftRightPitchYaw", *pitch_yaw_deg),
        message("/tracking/eye/EyesClosedAmount", shut),
    ]


def main() -> None:
    """Send until the motion or the sound ends."""
    given = options(__doc__.splitlines()[0], "127.0.0.1:9000").parse_args()
    send_by_udp(given, packets, RESEND_S, last=messages([0.0] * 4, 0.0))


if __name__ == "__main__":
    run(main)
