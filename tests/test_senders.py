"""The senders of the recipes with motions from files: signs, units, protocols, and what they say when it goes wrong."""

from __future__ import annotations

import importlib
import socket
import struct
import sys
import threading
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toy_motions
from osc_packets import osc_bundle, osc_message
from scipy.spatial.transform import Rotation
from vtube_studio import vtube_studio

from talkingeyes.animation.line_of_sight import from_forward_axes
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion

GAZE, CLOSED = "/tracking/eye/LeftRightPitchYaw", "/tracking/eye/EyesClosedAmount"
FRAMES = 3


@pytest.fixture(autouse=True)
def recipes(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Senders are imported by name, as they import each other."""
    monkeypatch.syspath_prepend(str(repository / "docs/recipes"))


def motion(gaze: np.ndarray, head: tuple[float, ...] = (0, 0, 0), lid: tuple[float, float] = (0, 0)) -> Motion:
    """Frames at 50 a second of lines of sight, and of a head turned by a rotation vector in degrees."""
    rows = np.ones((FRAMES, 1))
    made = Motion.of(50.0, rows * np.radians(head), rows[..., None] * gaze, lid=rows * lid)
    return from_forward_axes(made, "visual")


def run(name: str, *arguments: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a sender to its end."""
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    importlib.import_module("sender").run(importlib.import_module(name).main)


@pytest.fixture
def sent_by_udp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What a sender sends of a motion."""

    def packets(name: str, shown: Motion, count: int) -> list[bytes]:
        shown.save(tmp_path / "a.npz")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(0.3)
            to = f"127.0.0.1:{receiver.getsockname()[1]}"
            run(name, str(tmp_path / "a.npz"), "--to", to, monkeypatch=monkeypatch)
            found = [receiver.recv(4096) for _ in range(count)]
            with pytest.raises(TimeoutError):
                receiver.recv(4096)
        return found

    return packets


def test_vrchat_gets_the_numbers_of_its_documentation(sent_by_udp: Any) -> None:
    """docs.vrchat.com/docs/osc-eye-tracking: a target 15 degrees up, 20 to the right, 50 cm away, in two notations."""
    vectors = np.array([[0.387, 0.257, 0.886], [0.274, 0.268, 0.923]])  # LeftRightVec: +x to the user's right
    packets = sent_by_udp("vrchat_stream", motion(rotation.direction_to_rotvec(vectors * [-1, 1, 1])), 2 * FRAMES + 2)
    (address, values), *_ = map(osc_message, packets)
    assert address == GAZE
    np.testing.assert_allclose(values, [-14.903, 23.592, -15.560, 16.503], atol=0.1)


def test_vrchat_follows_gaze_to_the_left_and_up_and_ends_at_rest(sent_by_udp: Any) -> None:
    gaze = rotation.angles_to_gaze(np.radians([[12.0, 8.0], [16.0, 9.0]]))  # (yaw, pitch) to the subject's left and up
    packets = sent_by_udp("vrchat_stream", motion(gaze, head=(0, 30, 0), lid=(1.0, 0.0)), 2 * FRAMES + 2)
    messages = [osc_message(each) for each in packets]
    assert [address for address, _ in messages] == [GAZE, CLOSED] * (FRAMES + 1)
    for (_, looks), (_, closed) in zip(messages[:-2:2], messages[1:-2:2], strict=True):
        np.testing.assert_allclose(looks, [-8, -12, -9, -16], atol=0.01)  # about the head; down and right are positive
        assert closed == [0.5]  # one value for both eyes
    assert messages[-2:] == [(GAZE, [0.0] * 4), (CLOSED, [0.0])]


def test_vtube_studio_gets_live2d_signs_and_asks_the_user_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gaze = rotation.angles_to_gaze(np.radians([[18.5, 3.7], [14.8, 3.7]]))
    motion(gaze, head=(0, 20, 0), lid=(1.0, 0.0)).save(tmp_path / "a.npz")
    with vtube_studio() as studio:
        command = (str(tmp_path / "a.npz"), "--to", studio.address, "--token", str(tmp_path / "token"))
        run("vtube_studio_stream", *command, monkeypatch=monkeypatch)
        assert studio.asked[:2] == ["AuthenticationTokenRequest", "AuthenticationRequest"]
        assert (tmp_path / "token").stat().st_mode & 0o077 == 0
        first = studio.injected[0]
        assert studio.injected[-1] == first and len(studio.injected) >= FRAMES
        wanted = {"FaceAngleX": 20, "FaceAngleY": 0, "FaceAngleZ": 0}  # X: right of the screen, the character's left
        wanted |= {"EyeLeftX": 0.5, "EyeLeftY": 0.1, "EyeRightX": 0.4, "EyeRightY": 0.1}
        wanted |= {"TalkingEyesLookX": 0.45, "TalkingEyesLookY": 0.1, "EyeOpenLeft": 0, "EyeOpenRight": 1}
        assert first == pytest.approx(wanted, abs=2e-3)
        assert "Allow the plugin" in capsys.readouterr().out
        studio.asked.clear()
        run("vtube_studio_stream", *command, monkeypatch=monkeypatch)
        assert studio.asked[0] == "AuthenticationRequest"
        assert "AuthenticationTokenRequest" not in studio.asked
        studio.tokens.clear()  # the user has revoked it
        run("vtube_studio_stream", *command, monkeypatch=monkeypatch)
        assert "AuthenticationTokenRequest" in studio.asked


@pytest.mark.parametrize(
    ("head", "wanted"),
    [((-10, 0, 0), {"FaceAngleY": 10}), ((0, -10, 0), {"FaceAngleX": -10}), ((0, 0, 10), {"FaceAngleZ": -10})],
    ids=["up", "to the subject's right", "to the subject's right shoulder"],
)
def test_vtube_studio_gets_each_turn_of_the_head(head: tuple[float, ...], wanted: dict[str, float]) -> None:
    looks = {f"eyeLook{way}{side}": 0.0 for way in ("In", "Out", "Up", "Down") for side in ("Left", "Right")}
    turned = Rotation.from_rotvec(head, degrees=True).as_quat().tolist()
    frame = {"head": turned, "look_deg": [0, 0], "blendshapes": {**looks, "eyeBlinkLeft": 0.0, "eyeBlinkRight": 0.0}}
    found = importlib.import_module("vtube_studio_stream").parameters(frame)
    angles = {f"FaceAngle{axis}": 0.0 for axis in "XYZ"} | wanted
    assert {name: found[name] for name in angles} == pytest.approx(angles, abs=1e-6)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (
            {"allow": False},
            "VTube Studio: User has denied API access for your plugin. (AuthenticationTokenRequest, error",
        ),
        (
            {"taken": "EyeLeftX"},
            "VTube Studio: EyeLeftX: controlled by another plugin. (InjectParameterDataRequest, err",
        ),
    ],
    ids=["denied", "taken"],
)
def test_errors_of_vtube_studio_are_one_line(
    settings: dict[str, Any],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    motion(np.zeros((2, 3))).save(tmp_path / "a.npz")
    with vtube_studio(**settings) as studio, pytest.raises(SystemExit) as ended:
        options = ("--to", studio.address, "--token", str(tmp_path / "token"))
        run("vtube_studio_stream", str(tmp_path / "a.npz"), *options, monkeypatch=monkeypatch)
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith(reason)
    assert (tmp_path / "token").exists() == ("taken" in settings)


@pytest.mark.parametrize(
    ("name", "options", "reason"),
    [
        ("vtube_studio_stream", ("--to", "ws://127.0.0.1:9"), "ws://127.0.0.1:9: should be VTube Studio with its API"),
        ("vrchat_stream", ("--to", "localhost"), "--to: should be HOST:PORT, got localhost"),
        ("vmc_stream", ("--request", '{"seed": 1}'), "--request, --changes: should be left out with a motion"),
        ("vmc_stream", (), "no.npz: not a readable motion npz (No such file or directory)"),
    ],
)
def test_what_goes_wrong_is_one_line(
    name: str,
    options: tuple[str, ...],
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(name, "no.npz", *options, monkeypatch=monkeypatch)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and said.startswith(reason), said


def test_the_newest_frame_is_sent_again_while_none_comes() -> None:
    sender = importlib.import_module("sender")
    sent, again = [], threading.Event()

    def frames() -> Iterator[dict]:
        yield {"time_s": 0}
        assert again.wait(20)  # a source that stops, such as a microphone
        yield {"time_s": 1}

    def send(frame: dict) -> None:
        sent.append(frame["time_s"])
        if len(sent) > 2:
            again.set()

    assert sender.send_frames(frames(), send, 0.01) == 2
    assert sent[:3] == [0, 0, 0] and sent.count(1) >= 1
    assert importlib.import_module("vrchat_stream").RESEND_S < 10
    assert importlib.import_module("vtube_studio_stream").RESEND_S < 1


def test_a_file_is_sent_at_its_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sender, now = importlib.import_module("sender"), [0.0]
    clock = types.SimpleNamespace(monotonic=lambda: now[0], sleep=lambda seconds: now.__setitem__(0, now[0] + seconds))
    monkeypatch.setattr(sender, "time", clock)
    for shown in (toy_motions.motion(60.0, 1.0), toy_motions.flame_motion()):
        shown.save(tmp_path / "a.npz")
        now[0] = 0.0
        times = [(now[0], frame["fps"]) for frame in sender.file_frames(tmp_path / "a.npz")]
        np.testing.assert_allclose(times, [(frame / shown.fps, shown.fps) for frame in range(len(shown))], atol=1e-4)


def test_vmc_and_live_link_play_files_too(sent_by_udp: Any) -> None:
    shown = motion(rotation.angles_to_gaze(np.radians([[10.0, 0.0]] * 2)), head=(0, 20, 0), lid=(1.0, 0.0))
    for packet in sent_by_udp("vmc_stream", shown, FRAMES):
        messages = osc_bundle(packet)
        bones = {values[0]: values[4:] for address, values in messages if address == "/VMC/Ext/Bone/Pos"}
        turn = np.degrees([Rotation.from_quat(bones[name]).as_rotvec() for name in ("Head", "LeftEye", "RightEye")])
        np.testing.assert_allclose(turn, [[0, -20, 0], [0, -10, 0], [0, -10, 0]], atol=0.01)  # Unity's axes
    for index, packet in enumerate(sent_by_udp("live_link_stream", shown, FRAMES)):
        length = struct.unpack("!i", packet[41:45])[0]
        assert struct.unpack("!if2ib", packet[45 + length : 62 + length]) == (index, 0.0, 50, 1, 61)
        values = np.degrees(struct.unpack("!61f", packet[62 + length :])[52:])
        np.testing.assert_allclose(values, [-20, 0, 0, -10, 0, 0, -10, 0, 0], atol=0.01)
