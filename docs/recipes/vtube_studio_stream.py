"""VTube Studio, and through it Live2D models: gaze, blinks and head by its public API.

    python vtube_studio_stream.py take/sample_00.npz [--to ws://127.0.0.1:8001]
    talkingeyes serve &
    python vtube_studio_stream.py SPEECH.wav [--request '{"eye_contact": 0.8}'] [--changes FILE]

In VTube Studio switch on "Allow Plugin API access", and allow the plugin when it asks, once: the token is kept in a
file (--token). A frame is an InjectParameterDataRequest (github.com/DenchiSoft/VTubeStudio) of default parameters:
FaceAngleX, Y, Z (degrees), EyeLeftX, Y and EyeRightX, Y (-1 to 1, 1 being 37 degrees), EyeOpenLeft, Right (0 closed to
1). The plugin adds TalkingEyesLookX, Y, which are both eyes together, for models with one pair of pupils.

Signs: VTube Studio's automatic setup passes these parameters on to those of Live2D unchanged (FaceAngleX to
ParamAngleX, EyeRightX to ParamEyeBallX, EyeOpenLeft to ParamEyeLOpen). Of these, the Standard Parameter List
(docs.live2d.com) says: X and Z turn and lean to the right of the screen, Y up; left is the character's (its left brow
moves left to be knit). The character faces the screen, so the right of the screen is its left.

A parameter is lost 1 s after it was last sent, so the newest frame is sent again every 0.4 s while none comes. At the
end parameters return to what had them before, such as a camera. Needs websockets; sources, and what they need:
sender.py.
"""

import contextlib
import json
import math
from pathlib import Path

from sender import angles, frames_of, options, run, send_frames
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

PLUGIN = {"pluginName": "TalkingEyes", "pluginDeveloper": "TalkingEyes"}
TOKEN = Path.home() / ".talkingeyes_vtube_studio_token"
RESEND_S = 0.4
LOOK_DEG = 37.0  # a look coefficient of 1 (docs/live.md)
ADDED = {
    "TalkingEyesLookX": "Gaze of both eyes together, 1: to the right of the screen",
    "TalkingEyesLookY": "Gaze of both eyes together, 1: up",
}


def parameters(frame: dict) -> dict[str, float]:
    """Values of VTube Studio's parameters."""
    shape = frame["blendshapes"]
    yaw, pitch, roll = (math.degrees(angle) for angle in angles(*frame["head"]))
    look_x, look_y = (max(-1.0, min(1.0, angle / LOOK_DEG)) for angle in frame["look_deg"])
    return {
        "FaceAngleX": yaw,
        "FaceAngleY": -pitch,
        "FaceAngleZ": -roll,
        "EyeLeftX": shape["eyeLookOutLeft"] - shape["eyeLookInLeft"],
        "EyeLeftY": shape["eyeLookUpLeft"] - shape["eyeLookDownLeft"],
        "EyeRightX": shape["eyeLookInRight"] - shape["eyeLookOutRight"],
        "EyeRightY": shape["eyeLookUpRight"] - shape["eyeLookDownRight"],
        "EyeOpenLeft": 1.0 - shape["eyeBlinkLeft"],
        "EyeOpenRight": 1.0 - shape["eyeBlinkRight"],
        "TalkingEyesLookX": look_x,
        "TalkingEyesLookY": look_y,
    }


def inject(studio: ClientConnection, frame: dict) -> None:
    """Send a frame, and read what has been answered to earlier ones."""
    values = [{"id": name, "value": value} for name, value in parameters(frame).items()]
    post(studio, "InjectParameterDataRequest", {"faceFound": True, "mode": "set", "parameterValues": values})
    with contextlib.suppress(TimeoutError):
        while True:
            checked(studio.recv(timeout=0))


def log_in(studio: ClientConnection, token_file: Path) -> None:
    """Authenticate with the token of the file, or with a new one, which the user allows in VTube Studio."""
    if token_file.exists() and authenticate(studio, token_file.read_text())["authenticated"]:
        return
    print("Allow the plugin TalkingEyes in VTube Studio.", flush=True)
    token = ask(studio, "AuthenticationTokenRequest", PLUGIN)["authenticationToken"]
    answer = authenticate(studio, token)
    if not answer["authenticated"]:
        raise RuntimeError(f"VTube Studio: {answer['reason']}")
    token_file.touch(0o600)
    token_file.write_text(token)


def authenticate(studio: ClientConnection, token: str) -> dict:
    """What VTube Studio says to a token."""
    return ask(studio, "AuthenticationRequest", {**PLUGIN, "authenticationToken": token})


def ask(studio: ClientConnection, kind: str, data: dict) -> dict:
    """Send a request and return the data of its response. Responses to earlier requests come first."""
    post(studio, kind, data)
    while (answer := checked(studio.recv()))["messageType"] != kind.replace("Request", "Response"):
        pass
    return answer["data"]


def post(studio: ClientConnection, kind: str, data: dict) -> None:
    """Send a request."""
    head = {"apiName": "VTubeStudioPublicAPI", "apiVersion": "1.0", "requestID": kind, "messageType": kind}
    studio.send(json.dumps({**head, "data": data}))


def checked(message: str | bytes) -> dict:
    """A response. Raises RuntimeError with the reason of VTube Studio."""
    answer = json.loads(message)
    if answer["messageType"] == "APIError":
        error = answer["data"]
        raise RuntimeError(f"VTube Studio: {error['message']} ({answer['requestID']}, error {error['errorID']})")
    return answer


def main() -> None:
    """Send until the motion or the sound ends."""
    parser = options(__doc__.splitlines()[0], "ws://127.0.0.1:8001")
    parser.add_argument("--token", type=Path, default=TOKEN, help="file of the token")
    given = parser.parse_args()
    try:
        with connect(given.to) as studio:
            log_in(studio, given.token)
            for name, explanation in ADDED.items():
                added = {"parameterName": name, "explanation": explanation, "min": -1, "max": 1, "defaultValue": 0}
                ask(studio, "ParameterCreationRequest", added)
            count = send_frames(frames_of(given), lambda frame: inject(studio, frame), RESEND_S)
            ask(studio, "APIStateRequest", {})  # after the answers to all frames
    except (ConnectionError, WebSocketException) as error:
        raise RuntimeError(f"{given.to}: should be VTube Studio with its API switched on, got: {error}") from None
    print(f"{count} frames to {given.to}")


if __name__ == "__main__":
    run(main)
