"""The service: responses, errors with their messages, and robustness to any input."""

from __future__ import annotations

import contextlib
import html
import io
import itertools
import json
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import face_files
import numpy as np
import pytest
import soundfile
from browser import CHROMIUM, FLAGS, Browser, open_browser
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from live_model import write_live_model
from osc_packets import osc_bundle, osc_message
from scipy.spatial.transform import Rotation
from test_live_nods import phrases
from test_streaming import speech
from vtube_studio import vtube_studio
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from talkingeyes.animation.streaming import LiveModel
from talkingeyes.apps.service.animation_request import AnimationRequest, EyesRequest
from talkingeyes.apps.viewer.pose_encoding import POSE_COLUMNS
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.formats import arkit
from talkingeyes.workflows import convert

pytestmark = pytest.mark.timeout(200)  # a service that does not answer must not stop the run
OF_FLAME = ("flame", "vhap", "diffposetalk")
SECONDS, STREAMS, IDLE_S = 1.6, 3, 5.0  # limit for a client on a busy machine
LIMITED = f"""
import sys
from dataclasses import replace
from pathlib import Path
from talkingeyes.workflows.serve import LIMITS, run_service
more = dict(max_stream_s=30, max_speech_s=4, work_timeout_s=60, max_results=3)
limits = replace(LIMITS, streams={STREAMS}, max_upload_bytes=300_000, idle_timeout_s={IDLE_S}, **more)
run_service(model=sys.argv[1], live=sys.argv[2], port=0, limits=limits, on_start=lambda each: print(each, flush=True))
"""


@dataclass(frozen=True)
class Answer:
    """A response of the service."""

    status: int
    body: bytes

    @property
    def told(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Service:
    """A running service."""

    address: str
    live: Path
    place: Path

    def ask(self, path: str, body: bytes | None = None, **headers: str) -> Answer:
        """GET, or POST with a body."""
        headers = {"Content-Type": "audio/wav", **{name.replace("_", "-"): value for name, value in headers.items()}}
        request = urllib.request.Request(self.address + path, data=body, headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=300) as found:
                return Answer(found.status, found.read())
        except urllib.error.HTTPError as error:
            return Answer(error.code, error.read())

    def stream(self, **headers: str) -> ClientConnection:
        """Open a WebSocket stream."""
        return connect(self.address.replace("http", "ws") + "stream", additional_headers=headers)

    @property
    def port(self) -> int:
        return int(urllib.parse.urlsplit(self.address).port or 0)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    place = tmp_path_factory.mktemp("service")
    told = {"kind": "speaker", "condition_dropout": 0.0, "embedding_scale": {"head": 1.0, "gaze": 1.0}}
    model = write_live_model(place / "talkingeyes", ("anna", "bert"), conditions=[told])
    live = write_live_model(place / "talkingeyes_live")
    (place / "temporary").mkdir()
    environment = {**os.environ, "TMPDIR": str(place / "temporary")}
    process = subprocess.Popen(
        [sys.executable, "-c", LIMITED, str(model), str(live)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=place,
        env=environment,
    )
    assert process.stdout is not None
    found = Service(process.stdout.readline().strip(), live, place)
    yield found
    process.terminate()
    process.wait(timeout=120)
    process.stdout.close()
    assert not any((place / "temporary").iterdir())  # all workers end with the service


def wav(sound: np.ndarray, rate: int = SAMPLE_RATE, format: str = "WAV") -> bytes:
    buffer = io.BytesIO()
    soundfile.write(buffer, sound, rate, format=format)
    return buffer.getvalue()


def pcm(sound: np.ndarray) -> bytes:
    return np.round(sound * 32767).astype("<i2").tobytes()


def spoken(connection: ClientConnection, sound: np.ndarray, chunk: int = 3200) -> tuple[np.ndarray, dict[str, Any]]:
    """Send a sound; return all rows of the stream and its last message."""
    about = json.loads(connection.recv(120))
    for start in range(0, len(sound), chunk):
        connection.send(pcm(sound[start : start + chunk]))
    connection.send('{"end": true}')
    rows, expected = [], 0
    while True:
        message = connection.recv(120)
        if isinstance(message, str):
            if "behind_s" in message:  # as on a busy machine
                continue
            return np.concatenate(rows), json.loads(message)
        assert int.from_bytes(message[:4], "little") == expected
        rows.append(np.frombuffer(message[4:], "<f4").reshape(-1, about["columns"]))
        expected += len(rows[-1])


def json_stream(connection: ClientConnection, sound: np.ndarray) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Send a sound; return the first message of a stream of JSON, and its frames."""
    about, frames = json.loads(connection.recv(120)), []
    connection.send(pcm(sound))
    connection.send('{"end": true}')
    while "end" not in (message := json.loads(connection.recv(120))):
        assert message.get("first", len(frames)) == len(frames)
        frames += message.get("frames", ())  # none of {"behind_s": ...}
    return about, frames


def until_set(connection: ClientConnection) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The frames of a stream of JSON up to the answer to {"set": ...}, and this answer."""
    frames: list[dict[str, Any]] = []
    while "set" not in (message := json.loads(connection.recv(120))):
        frames += message.get("frames", ())
    return frames, message


def live_link_frame(packet: bytes, index: int, frame: dict[str, Any]) -> None:
    """Check a packet of Live Link Face: version, id, subject, frame time and rate, 61 big-endian floats."""
    length = struct.unpack("!i", packet[41:45])[0]
    assert (struct.unpack("<i", packet[:4])[0], packet[45 : 45 + length]) == (6, b"TalkingEyes")
    assert struct.unpack("!if2ib", packet[45 + length : 62 + length]) == (index, 0.0, 25, 1, 61)
    values = np.array(struct.unpack("!61f", packet[62 + length :]))
    np.testing.assert_allclose(values[:14], [frame["blendshapes"][name] for name in arkit.NAMES[:14]], atol=1e-6)
    assert not values[14:52].any()
    turned = Rotation.from_quat([frame[name] for name in ("head", "left_eye", "right_eye")])
    signs = [-1.0, 1.0, 1.0]  # yaw is negative to the subject's left (docs/formats.md)
    np.testing.assert_allclose(values[52:], (turned.as_euler("YXZ") * signs).ravel(), atol=1e-5)


def vmc_frame(packet: bytes, index: int, frame: dict[str, Any]) -> None:
    """Check a bundle of the Virtual Motion Capture protocol."""
    messages = osc_bundle(packet)
    assert messages[0] == ("/VMC/Ext/OK", [1])
    assert [address for address, _ in messages[-2:]] == ["/VMC/Ext/Blend/Apply", "/VMC/Ext/T"]
    assert messages[-1][1] == [pytest.approx(index / 25)]
    bones = {values[0]: values[1:] for address, values in messages if address == "/VMC/Ext/Bone/Pos"}
    mirror = np.diag([-1.0, 1.0, 1.0])  # Unity's x is to the subject's right
    for bone, name in (("Head", "head"), ("LeftEye", "left_eye"), ("RightEye", "right_eye")):
        assert bones[bone][:3] == [0, 0, 0]
        ours = mirror @ Rotation.from_quat(frame[name]).as_matrix() @ mirror
        np.testing.assert_allclose(Rotation.from_quat(bones[bone][3:]).as_matrix(), ours, atol=2e-5)
    weights = dict(values for address, values in messages if address == "/VMC/Ext/Blend/Val")
    assert weights.pop("Blink_L") == pytest.approx(frame["blendshapes"]["eyeBlinkLeft"], abs=1e-6)
    assert weights.pop("Blink_R") == pytest.approx(frame["blendshapes"]["eyeBlinkRight"], abs=1e-6)
    assert weights == pytest.approx(frame["blendshapes"], abs=1e-6)


def vrchat_frame(gaze: bytes, lids: bytes, _: int, frame: dict[str, Any]) -> None:
    """Check the messages of VRChat: degrees down and to the right of each eye, and how far both are shut."""
    axes = np.array([Rotation.from_quat(frame[name]).apply([0, 0, 1]) for name in ("left_eye", "right_eye")])
    pitch_yaw = np.degrees([-np.arcsin(axes[:, 1]), -np.arctan2(axes[:, 0], axes[:, 2])]).T
    (gaze_address, looks), (lids_address, shut) = osc_message(gaze), osc_message(lids)
    assert (gaze_address, lids_address) == ("/tracking/eye/LeftRightPitchYaw", "/tracking/eye/EyesClosedAmount")
    np.testing.assert_allclose(looks, pitch_yaw.ravel(), atol=2e-3)
    assert shut == [pytest.approx(np.mean([frame["blendshapes"][f"eyeBlink{side}"] for side in ("Left", "Right")]))]


SENDERS = {"live_link_stream": (live_link_frame, 1), "vmc_stream": (vmc_frame, 1), "vrchat_stream": (vrchat_frame, 2)}


def missed_deg(frame: dict[str, Any], target_m: np.ndarray) -> float:
    """Angle between the gaze of both eyes together and a point, which is given from between the eyes at rest."""
    between = np.array([0.0, 0.041374, 0.084397])  # from the neck joint
    yaw, pitch = np.radians(frame["look_deg"])
    look = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    head = Rotation.from_quat(frame["head"])
    wanted = target_m + between - head.apply(between)
    return float(np.degrees(np.arccos(head.apply(look) @ wanted / np.linalg.norm(wanted))))


def well(service: Service) -> None:
    """Assert that the service still works."""
    assert service.ask("performances?seed=1", wav(speech(0.5))).status == 200
    with service.stream() as connection:
        connection.send("{}")
        assert spoken(connection, speech(0.5))[1] == {"end": True, "frames": 12}


class TestFiles:
    @pytest.mark.long
    def test_upload_becomes_animation_with_sound(self, service: Service) -> None:
        sound = speech(SECONDS)
        made = service.ask("performances?seed=3", wav(sound))
        assert made.status == 200
        assert made.told["frames"] == int(SECONDS * 25)
        place = f"performances/{made.told['id']}"
        rows = np.frombuffer(service.ask(f"{place}/poses").body, "<f4").reshape(made.told["frames"], -1)
        assert rows.shape[1] == made.told["columns"] > POSE_COLUMNS
        assert np.ptp(rows[:, 3:7], axis=0).max() > 1e-3  # the head turns
        heard, rate = soundfile.read(io.BytesIO(service.ask(f"{place}/sound").body))
        assert (rate, len(heard)) == (SAMPLE_RATE, len(sound))
        np.testing.assert_allclose(heard, sound, atol=1e-3)

    def test_seed_and_controls_have_effect(self, service: Service) -> None:
        def poses(asked: str) -> bytes:
            made = service.ask(f"performances?{asked}", wav(speech(SECONDS)))
            assert made.status == 200, made.body
            return service.ask(f"performances/{made.told['id']}/poses").body

        first = poses("seed=3")
        assert poses("seed=3") == first
        for asked in (
            "seed=4",
            "seed=3&head_liveliness=2",
            "seed=3&gaze_liveliness=0",
            "seed=3&fps=50",
            "seed=3&eye_contact=1",
        ):
            assert poses(asked) != first, asked
        as_each = [poses(f"seed=3&person={name}") for name in service.ask("service.json").told["persons"]]
        assert as_each.count(first) == 1  # the speaker selected by the seed
        assert len(as_each) == 2

    def test_other_audio_formats_and_rates_are_accepted(self, service: Service) -> None:
        for format, rate in (("FLAC", 44_100), ("OGG", 48_000), ("MP3", 22_050)):
            assert service.ask("performances", wav(speech(1.0), rate, format)).status == 200

    @pytest.mark.parametrize("format", [name for name in convert.FORMATS if name not in {"mp4", *OF_FLAME}])
    def test_downloads(self, service: Service, format: str, performed: str) -> None:
        found = service.ask(f"{performed}/{format}")
        assert found.status == 200, found.body
        assert len(found.body) > 100

    @pytest.mark.parametrize("format", OF_FLAME)
    def test_formats_of_flame_say_what_a_moving_face_needs(self, service: Service, format: str, performed: str) -> None:
        found = service.ask(f"{performed}/{format}")
        assert found.status == 422
        assert "should be your FLAME file" in found.told["error"]

    @pytest.mark.slow
    def test_a_film_is_a_download_too(self, service: Service, performed: str) -> None:
        assert service.ask(f"{performed}/mp4").body[4:8] == b"ftyp"

    def test_a_face_gets_the_eyes_of_an_animation(self, service: Service, performed: str, tmp_path: Path) -> None:
        table = face_files.live_link(tmp_path / "take.csv", frames=90).read_bytes()
        kept = service.ask(f"{performed}/faces/csv?keep_head=true&blend=0", table, Content_Type="text/csv")
        assert (kept.status, kept.body) == (200, table)
        made = service.ask(f"{performed}/faces/csv", table, Content_Type="text/csv")
        assert made.status == 200, made.body
        names, *rows = (line.split(",") for line in made.body.decode().splitlines())
        _, *own = (line.split(",") for line in table.decode().splitlines())
        changed = {name for k, name in enumerate(names) if [row[k] for row in rows] != [row[k] for row in own]}
        assert all(face_files.is_eye(name) or name.startswith("Head") for name in changed)
        assert {"EyeLookInLeft", "RightEyeYaw", "HeadYaw"} <= changed
        sample = face_files.diffposetalk(tmp_path / "sample.npz").read_bytes()
        told = service.ask(f"{performed}/faces/npz", sample).told
        assert told == {"error": "the face: should contain its frame rate, got none; set --fps"}
        assert service.ask(f"{performed}/faces/npz?fps=25", sample).body[:2] == b"PK"
        long = face_files.audio2face_json(tmp_path / "a.json", frames=150).read_bytes()
        assert (
            service.ask(f"{performed}/faces/json", long).told["error"].startswith("the face: should last at most 4 s")
        )
        for path, status in (("faces/fbx", 404), ("faces/csv?blend=2", 422), ("faces/json", 422)):
            assert service.ask(f"{performed}/{path}", table).status == status
        assert service.ask(f"{performed}/faces/csv", table, Content_Type="multipart/form-data").status == 415
        assert service.ask(f"performances/{'0' * 32}/faces/csv", table).status == 404

    @pytest.fixture
    def performed(self, service: Service) -> str:
        return f"performances/{service.ask('performances', wav(speech(0.4))).told['id']}"

    def test_only_the_newest_are_kept(self, service: Service) -> None:
        made = [service.ask("performances", wav(speech(0.4))).told["id"] for _ in range(4)]
        assert service.ask(f"performances/{made[0]}/poses").status == 404
        assert service.ask(f"performances/{made[1]}/poses").status == 200


class TestStreams:
    def test_a_stream_gives_every_frame_in_order(self, service: Service) -> None:
        live, sound = LiveModel.load(service.live), speech(SECONDS)
        with service.stream() as connection:
            connection.send('{"seed": 5}')
            rows, end = spoken(connection, sound)
        heard = np.frombuffer(pcm(sound), "<i2") / np.float32(32768)
        assert end == {"end": True, "frames": int(SECONDS * 25)}
        assert len(rows) == end["frames"]
        whole = live.generate_offline(heard.astype(np.float32), 5)
        from talkingeyes.animation.line_of_sight import to_forward_axes
        from talkingeyes.apps.viewer.pose_encoding import pose_rows
        from talkingeyes.head.looks import dressed_head

        np.testing.assert_allclose(rows, pose_rows(dressed_head(), to_forward_axes(whole)), atol=1e-4)

    def test_nods_answer_the_second_channel(self, service: Service) -> None:
        live, own, partner = LiveModel.load(service.live), np.zeros(6 * SAMPLE_RATE), phrases(6.0)
        with service.stream() as connection:
            connection.send('{"seed": 1, "channels": 2}')
            rows, end = spoken(connection, np.stack([own, partner], axis=1))
        received = (np.frombuffer(pcm(partner), "<i2") / np.float32(32768)).astype(np.float32)
        whole = live.generate_offline(own.astype(np.float32), 1, partner=received)
        assert np.abs(whole.head - live.generate_offline(own.astype(np.float32), 1).head).max() > np.radians(1.0)
        assert end["frames"] == len(rows) == 6 * 25
        from talkingeyes.animation.line_of_sight import to_forward_axes
        from talkingeyes.apps.viewer.pose_encoding import pose_rows
        from talkingeyes.head.looks import dressed_head

        np.testing.assert_allclose(rows, pose_rows(dressed_head(), to_forward_axes(whole)), atol=1e-4)

    def test_json_frames_are_the_rows(self, service: Service) -> None:
        """An independent decoding: quaternions and coefficients of the frames against the rows of the same stream."""
        sound = speech(SECONDS)
        with service.stream() as connection:
            connection.send('{"seed": 5}')
            rows, _ = spoken(connection, sound)
        with service.stream() as connection:
            connection.send('{"seed": 5, "format": "json"}')
            about, frames = json_stream(connection, sound)
        assert about == {"fps": 25.0, "latency_s": about["latency_s"], "format": "json"}
        assert [round(each["time_s"] * 25) for each in frames] == list(range(len(rows)))
        for name, first in (("head", 3), ("left_eye", 11), ("right_eye", 15)):
            np.testing.assert_allclose([each[name] for each in frames], rows[:, first : first + 4], atol=2e-5)
        eyes = [
            Rotation.from_quat([each[name] for each in frames]).apply([0, 0, 1]) for name in ("left_eye", "right_eye")
        ]
        yaw_deg = [np.degrees(np.arctan2(each[:, 0], each[:, 2])) for each in eyes]
        x, y, z = np.sum(eyes, axis=0).T
        middle = np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))]).T
        np.testing.assert_allclose([each["look_deg"] for each in frames], middle, atol=0.01)
        shapes = [each["blendshapes"] for each in frames]
        assert set(shapes[0]) == {f"{what}{side}" for side in ("Left", "Right") for what in arkit.EYE_COEFFICIENTS}
        out = np.array([each["eyeLookOutLeft"] - each["eyeLookInLeft"] for each in shapes])
        np.testing.assert_allclose(np.clip(yaw_deg[0] / 37, -1, 1), out, atol=1e-3)
        assert max(each["eyeBlinkLeft"] for each in shapes) <= 1.0

    def test_a_change_takes_effect_within_200_ms(self, service: Service) -> None:
        """In stream time: frames after the message; the reply names the first of them."""
        sound, half = speech(2 * SECONDS), int(SECONDS * SAMPLE_RATE)
        target = [0.4, 0.1, 1.0]
        with service.stream() as connection:
            connection.send('{"seed": 5, "format": "json", "blink_liveliness": 0}')
            about = json.loads(connection.recv(120))
            connection.send(pcm(sound[:half]))
            connection.send('{"set": {}}')
            before = until_set(connection)[0]
            connection.send(json.dumps({"set": {"target": target}}))
            reply = json.loads(connection.recv(120))
            connection.send(pcm(sound[half:]))
            connection.send('{"end": true}')
            after = []
            while "end" not in (message := json.loads(connection.recv(120))):
                after += message.get("frames", ())
        assert reply == {"set": {"target": target}, "frame": len(before)}
        assert SECONDS - len(before) / about["fps"] < about["latency_s"] + 0.1
        missed = [missed_deg(each, np.array(target)) for each in before[-1:] + after[round(0.2 * about["fps"]) - 1 :]]
        assert missed[0] > 5.0
        assert max(missed[1:]) < 1.0

    def test_the_state_is_of_the_request_and_changes(self, service: Service) -> None:
        sound, half = speech(2 * SECONDS), int(SECONDS * SAMPLE_RATE)
        found = []
        for changes in ([], [{"state": "thinking"}], [{"state": "thinking"}, {"state": None}]):
            frames = []
            with service.stream() as connection:
                connection.send('{"seed": 5, "format": "json", "state": "listening"}')
                connection.recv(120)
                connection.send(pcm(sound[:half]))
                for change in [{}, *changes]:
                    connection.send(json.dumps({"set": change}))
                    more, reply = until_set(connection)
                    frames += more
                    assert reply == {"set": change, "frame": len(frames)}
                connection.send(pcm(sound[half:]))
                connection.send('{"end": true}')
                named = len(frames)
                while "end" not in (message := json.loads(connection.recv(120))):
                    frames += message.get("frames", ())
            found.append(np.array([each["head"] + each["look_deg"] for each in frames]))
        for each, other in itertools.combinations(found, 2):
            np.testing.assert_array_equal(each[:named], other[:named])
            assert np.abs(each[named:] - other[named:]).max() > 0.1

    @pytest.mark.parametrize("client", ["python", "javascript"])
    def test_the_clients_of_the_recipes_receive_every_frame(
        self, service: Service, repository: Path, tmp_path: Path, client: str
    ) -> None:
        sound = speech(SECONDS)
        soundfile.write(tmp_path / "a.wav", sound, SAMPLE_RATE, subtype="PCM_16")
        (tmp_path / "a.pcm").write_bytes(pcm(sound))
        url, recipes = f"{service.address.replace('http', 'ws')}stream", repository / "docs" / "recipes"
        if client == "python":
            command = [sys.executable, str(recipes / "stream_client.py"), "a.wav", url]
        else:
            node = shutil.which("node")
            if node is None or "experimental-websocket" not in subprocess.check_output([node, "--help"], text=True):
                pytest.skip("needs Node.js with WebSocket")
            script = f"""
                import {{ readFileSync }} from "node:fs";
                const {{ openStream }} = await import("{(recipes / "stream_client.js").as_uri()}");
                const sound = new Int16Array(readFileSync("a.pcm").buffer.slice(0));
                let received = 0;
                const stream = await openStream("{url}", {{ seed: 1 }}, (frame) => (received += frame === received));
                for (let at = 0; at < sound.length; at += 3200) stream.send(sound.slice(at, at + 3200));
                console.log(`${{await stream.end()}} frames, ${{received}} received`);
            """
            command = [node, "--experimental-websocket", "--input-type=module", "-e", script]
        ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
        assert ended.returncode == 0, ended.stderr
        assert f"{int(SECONDS * 25)} frames" in ended.stdout
        if client == "javascript":
            assert f"{int(SECONDS * 25)} received" in ended.stdout
        else:
            assert len((tmp_path / "a.poses.csv").read_text().splitlines()) == int(SECONDS * 25)

    @pytest.mark.parametrize("sender", SENDERS)
    def test_senders_of_the_recipes_pass_every_frame_on(
        self, service: Service, repository: Path, tmp_path: Path, sender: str
    ) -> None:
        """UDP packets of a sender, decoded here from what is known of their layout, against a stream of JSON."""
        sound, url = speech(SECONDS), f"{service.address.replace('http', 'ws')}stream"
        soundfile.write(tmp_path / "a.wav", np.frombuffer(pcm(sound), "<i2"), SAMPLE_RATE)
        (tmp_path / "changes").write_text('{"eye_contact": 1}\n{"head_liveliness": 2}\n')
        with service.stream() as connection:
            connection.send('{"seed": 3, "format": "json", "eye_contact": 1, "head_liveliness": 2}')
            _, frames = json_stream(connection, sound)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(120)
            options = ("--to", f"127.0.0.1:{receiver.getsockname()[1]}", "--stream", url, "--changes", "changes")
            asked = '{"seed": 3, "eye_contact": 1, "head_liveliness": 2}'  # the changes repeat it
            command = [sys.executable, str(repository / f"docs/recipes/{sender}.py"), "a.wav", *options]
            process = subprocess.Popen([*command, "--request", asked], cwd=tmp_path)
            check, each = SENDERS[sender]
            packets = [[receiver.recv(4096) for _ in range(each)] for _ in frames]
            assert process.wait(120) == 0
        for index, (sent, frame) in enumerate(zip(packets, frames, strict=True)):
            check(*sent, index, frame)

    def test_vtube_studio_follows_the_stream(self, service: Service, repository: Path, tmp_path: Path) -> None:
        sound, url = speech(SECONDS), f"{service.address.replace('http', 'ws')}stream"
        soundfile.write(tmp_path / "a.wav", np.frombuffer(pcm(sound), "<i2"), SAMPLE_RATE)
        with service.stream() as connection:
            connection.send('{"seed": 3, "format": "json"}')
            _, frames = json_stream(connection, sound)
        with vtube_studio() as studio:
            options = ("--to", studio.address, "--stream", url, "--request", '{"seed": 3}', "--token", "token")
            command = [sys.executable, str(repository / "docs/recipes/vtube_studio_stream.py"), "a.wav", *options]
            subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
        names = ("FaceAngleX", "FaceAngleY", "TalkingEyesLookX", "TalkingEyesLookY", "EyeOpenRight")
        found = [tuple(round(values[name], 3) for name in names) for values in studio.injected]
        wanted = []
        for frame in frames:
            yaw, pitch, _ = Rotation.from_quat(frame["head"]).as_euler("YXZ", degrees=True)
            looks = np.clip(frame["look_deg"], -37, 37) / 37
            wanted.append(np.round([yaw, -pitch, *looks, 1 - frame["blendshapes"]["eyeBlinkRight"]], 3))
        once = [next(same) for _, same in itertools.groupby(found)]  # a frame that had to wait is sent again
        np.testing.assert_allclose(once, [next(same) for _, same in itertools.groupby(map(tuple, wanted))], atol=2e-3)

    def test_a_sender_stops_with_the_reason_of_the_service(
        self, service: Service, repository: Path, tmp_path: Path
    ) -> None:
        soundfile.write(tmp_path / "a.wav", speech(0.5), SAMPLE_RATE, subtype="PCM_16")
        url = f"{service.address.replace('http', 'ws')}stream"
        command = [sys.executable, str(repository / "docs/recipes/vmc_stream.py"), "a.wav", "--stream", url]
        ended = subprocess.run(
            [*command, "--request", '{"target": "sun"}'], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 2
        assert ended.stderr.startswith("request.target: should be camera, listener, [x, y, z]")
        assert ended.stderr.count("\n") == 1

    def test_concurrent_streams_are_separate_and_limited(self, service: Service) -> None:
        with contextlib.ExitStack() as stack:
            streams = [stack.enter_context(service.stream()) for _ in range(STREAMS)]
            for seed, each in enumerate(streams):  # all at once: an idle stream would be closed
                each.send(json.dumps({"seed": seed}))
            for each in streams:
                assert "latency_s" in each.recv(120)
            with service.stream() as late:
                assert f"{STREAMS} streams are running" in late.recv(120)
                with pytest.raises(ConnectionClosed, match="1013"):
                    late.recv(120)
            for part in np.array_split(speech(SECONDS), 5):
                for each in streams:
                    each.send(pcm(part))
            found = []
            for each in streams:
                each.send('{"end": true}')
                messages = list(iter(lambda each=each: each.recv(120), '{"end": true, "frames": 40}'))
                found.append(b"".join(message[4:] for message in messages if isinstance(message, bytes)))
        assert len({len(each) for each in found}) == 1
        assert len(set(found)) == STREAMS
        well(service)

    @pytest.mark.parametrize(
        ("messages", "reason"),
        [
            (["no request"], "the first message should be a request"),
            ([b"\0\0"], "the first message should be a request"),
            (["[1]"], "the first message should be a request"),
            (['{"seed": -1}'], "request.seed: Input should be greater than or equal to 0, got -1"),
            (['{"seed": 1, "path": "/etc"}'], "request.path"),
            (['{"head_liveliness": 1e9}'], "request.head_liveliness"),
            (["{}", b"\0"], "sound should be 16-bit samples, got 1 bytes"),
            (["{}", b"\0" * 64_002], "at most 64000 bytes"),
            (['{"channels": 2}', b"\0" * 6], "sound should be pairs of 16-bit samples, got 6 bytes"),
            (['{"channels": 2}', b"\0" * 128_004], "at most 128000 bytes"),
            (['{"channels": 3}'], "request.channels: Input should be less than or equal to 2, got 3"),
            (["{}", '{"set": {"channels": 2}}'], "set.channels: Extra inputs are not permitted"),
            (["{}", "what"], "after the request"),
            (["{}", '{"set": 1}'], 'after the request should be {"set": {...}} or {"end": true}'),
            (["{}", '{"set": {}, "end": true}'], "after the request"),
            (["{}", '{"set": {"seed": 2}}'], "set.seed: Extra inputs are not permitted, got 2"),
            (["{}", '{"set": {"eye_contact": 2}}'], "set.eye_contact: Input should be less than or equal to 1, got 2"),
            (
                ["{}", '{"set": {"state": "asleep"}}'],
                "set.state: Input should be 'speaking', 'listening', 'thinking' or",
            ),
            (
                ['{"state": "asleep"}'],
                "request.state: Input should be 'speaking', 'listening', 'thinking' or 'idle', got",
            ),
            (["{}", '{"set": {"head_liveliness": null}}'], "set.head_liveliness: Input should be a valid number"),
            (
                ["{}", '{"set": {"target": "sun"}}'],
                "set.target: should be camera, listener, [x, y, z] in metres, or null",
            ),
            (["{}", '{"set": {"target": [0, 0, -1]}}'], "set.target: the point should be within 75 degrees"),
            (['{"target": [0, 0, 0.01]}'], "request.target: the point should be 0.15 m to"),
            (['{"format": "xml"}'], "request.format: Input should be 'binary' or 'json', got 'xml'"),
            (["{}", *[b"\0" * 64_000] * 16], "at most 30 s"),
        ],
    )
    def test_stream_error_is_reported_before_the_end(self, service: Service, messages: list[Any], reason: str) -> None:
        with service.stream() as connection:
            with contextlib.suppress(ConnectionClosed):
                for message in messages:
                    connection.send(message)
            told = []
            with pytest.raises(ConnectionClosed, match="1009" if "at most" in reason else "1008"):
                while True:
                    told.append(connection.recv(120))
        assert reason in json.loads(told[-1])["error"]
        assert "\n" not in json.loads(told[-1])["error"]

    def test_oversized_message_ends_the_stream(self, service: Service) -> None:
        with service.stream() as connection, pytest.raises(ConnectionClosed, match="1009"):
            connection.send(b"\0" * (1 << 20))
            connection.recv(120)
        well(service)

    @pytest.mark.long
    def test_idle_client_is_disconnected(self, service: Service) -> None:
        for first in ([], ["{}"]):
            with service.stream() as connection:
                for each in first:
                    connection.send(each)
                    connection.recv(120)
                assert "no data received" in connection.recv(120)
        well(service)

    def test_health_and_metrics_say_how_streams_are_doing(self, service: Service) -> None:
        with service.stream() as connection:
            connection.send("{}")
            connection.recv(120)
            connection.send(pcm(speech(1.0)))
            assert len(connection.recv(120)) > 4
            health = service.ask("health").told
            lines = dict(
                line.rsplit(" ", 1) for line in service.ask("metrics").body.decode().splitlines() if line[0] != "#"
            )
        assert health["streams"] == float(lines["talkingeyes_streams"]) == 1
        assert 0 < health["load"] < 1
        assert {"behind", "lateness_s"} < set(health)
        assert float(lines['talkingeyes_lateness_seconds{quantile="0.99"}']) >= 0
        assert float(lines["talkingeyes_memory_bytes"]) > 1e8
        assert float(lines["talkingeyes_threads"]) >= 3

    def test_disconnect_frees_the_stream(self, service: Service) -> None:
        wait_for = time.monotonic() + 120
        while service.ask("health").told["streams"]:  # of the tests before
            assert time.monotonic() < wait_for
            time.sleep(0.05)
        for _ in range(STREAMS):
            with service.stream() as connection:
                connection.send("{}")
                assert "latency_s" in connection.recv(120)
                connection.send(pcm(speech(0.5)))
                connection.socket.shutdown(socket.SHUT_RDWR)  # without a closing message
        refused = True
        while refused:
            with service.stream() as connection:
                try:
                    connection.send("{}")
                    refused = "error" in connection.recv(120)
                except ConnectionClosed as error:  # refused before it was asked
                    assert error.rcvd is not None
                    assert error.rcvd.code == 1013
            assert time.monotonic() < wait_for
        well(service)


class TestDescription:
    def test_schema_has_every_request_with_its_parameters(self, service: Service) -> None:
        paths = service.ask("openapi.json").told["paths"]
        made, faces = "/performances", "/performances/{name}/faces/{ending}"
        assert set(paths) == {made, faces, "/performances/{name}/{what}", "/service.json", "/health", "/metrics"}
        for path, asked in ((made, AnimationRequest), (faces, EyesRequest)):
            found = {each["name"]: each["in"] for each in paths[path]["post"]["parameters"]}
            assert {name for name, where in found.items() if where == "query"} == set(asked.model_fields)
            assert "application/octet-stream" in paths[path]["post"]["requestBody"]["content"]
        assert {"name", "ending"} < {each["name"] for each in paths[faces]["post"]["parameters"]}

    def test_page_says_what_the_schema_says_without_other_hosts(self, service: Service) -> None:
        page = service.ask("docs").body.decode()
        for path, methods in service.ask("openapi.json").told["paths"].items():
            for method, operation in methods.items():
                assert f"<code>{method.upper()} {path}</code>" in page
                for each in operation.get("parameters", ()):
                    assert f"<td>{each['name']}</td>" in page
        assert "<script" not in page
        for name in ("docs", "", "live.js", "live.css", "recorder.js", "waveform.js"):
            found = re.findall(r"(?:https?|wss?)://[^\s\"'<`]+", service.ask(name).body.decode())
            assert all(urllib.parse.urlsplit(each).port == service.port for each in found), (name, found)

    def test_examples_of_the_page_run(self, service: Service, tmp_path: Path) -> None:
        blocks = re.findall(r"<pre><code>(.*?)</code></pre>", service.ask("docs").body.decode(), re.DOTALL)
        address, *commands = [html.unescape(each) for each in blocks if "curl" in each or "SERVICE=" in each]
        assert len(commands) == 3
        soundfile.write(tmp_path / "speech.wav", speech(0.5), SAMPLE_RATE, subtype="PCM_16")
        face_files.live_link(tmp_path / "lips.csv", frames=90)
        place = service.ask("performances", wav(speech(0.5))).told["id"]
        if shutil.which("curl"):
            script = (
                "\n".join(("set -e", address, *commands))
                .replace("curl ", "curl --fail-with-body -sS ")
                .replace("/ID/", f"/{place}/")
            )
            subprocess.run(["bash", "-c", script], cwd=tmp_path, check=True, timeout=120)
            assert (tmp_path / "head.glb").read_bytes()[:4] == b"glTF"
            assert "EyeLookInLeft" in (tmp_path / "with_eyes.csv").read_text()
        (example,) = (html.unescape(each) for each in blocks if "import json" in each)
        ended = subprocess.run(
            [sys.executable, "-c", example], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120
        )
        assert ended.stdout.splitlines()[-1] == '{"end": true, "frames": 12}'


def test_an_emotion_has_an_intensity_by_default() -> None:
    asked = {"happy": None, "sad": 3, "neutral": None}
    styles = [AnimationRequest(emotion=name, intensity=each).controls.face[0].style for name, each in asked.items()]
    assert [style.intensity for style in styles] == [2, 3, 0]


class TestMistakes:
    @pytest.mark.parametrize(
        ("query", "body", "status", "reason"),
        [
            ("", b"", 422, "the sound: empty"),
            ("", b"RIFF and nothing else", 422, "the sound: not a sound that can be decoded"),
            ("", wav(np.zeros(8000)), 422, "the sound: silent"),
            ("", wav(speech(0.1)), 422, "at least 0.3 s"),
            ("", wav(speech(5.0)), 422, "at most 4 s, got 5.0 s"),
            ("", bytes(300_001), 413, "at most 300000 bytes"),
            ("seed=x", b"0", 422, "request.seed"),
            ("seed=1&name=../../x", b"0", 422, "request.name"),
            ("fps=1000", b"0", 422, "request.fps: Input should be less than or equal to 120"),
            ("eye_contact=nan", b"0", 422, "request.eye_contact"),
            ("emotion=glee&intensity=1", wav(speech(0.4)), 422, "emotion: should be one of"),
            ("person=dora", wav(speech(0.4)), 422, "person: should be one of anna, bert or a number, got dora"),
        ],
    )
    def test_one_line_and_a_status(self, service: Service, query: str, body: bytes, status: int, reason: str) -> None:
        answer = service.ask(f"performances?{query}", body)
        assert answer.status == status, answer.body
        assert reason in answer.told["error"]
        assert "\n" not in answer.told["error"]
        assert str(service.place) not in answer.body.decode()

    def test_other_content_and_other_methods(self, service: Service) -> None:
        for kind in ("multipart/form-data; boundary=x", "text/html", "application/json"):
            assert service.ask("performances", wav(speech(0.4)), Content_Type=kind).status == 415
        assert service.ask("performances").status == 404
        assert service.ask("stream", b"x").status == 405

    def test_nothing_else_can_be_read(self, service: Service) -> None:
        made = service.ask("performances", wav(speech(0.4))).told["id"]
        escapes = [
            "..",
            "../..",
            "..%2f..",
            "%2e%2e/motion.npz",
            "/etc/passwd",
            "motion.npz",
            "upload",
            "x" * 3000,
            "%00",
        ]
        for escape in escapes:
            for path in (escape, f"performances/{made}/{escape}", f"performances/{escape}/poses"):
                answer = service.ask(urllib.parse.quote(path, safe="/%."))
                assert answer.status in (400, 404), (path, answer.status)
                assert b"root:" not in answer.body

    def test_requests_of_other_origins_are_rejected(self, service: Service) -> None:
        elsewhere = "http://elsewhere.example"
        assert service.ask("performances", wav(speech(0.4)), Origin=elsewhere).status == 403
        assert service.ask("service.json", Host="elsewhere.example").status == 400
        with pytest.raises(Exception, match="403"):
            service.stream(Origin=elsewhere)
        assert service.ask("performances", wav(speech(0.4)), Origin=service.address.rstrip("/")).status == 200

    @pytest.mark.long
    def test_stalled_request_body_times_out(self, service: Service) -> None:
        with socket.create_connection(("127.0.0.1", service.port)) as stalled:
            stalled.sendall(b"POST /performances HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nRIFF")
            stalled.settimeout(20)
            assert b" 408 " in stalled.recv(4096)
        with socket.create_connection(("127.0.0.1", service.port)) as gone:
            gone.sendall(b"POST /performances HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nRIFF")
        well(service)

    @pytest.mark.long
    def test_half_sent_head_of_a_request_times_out(self, service: Service) -> None:
        for half in (b"", b"GET /service.js", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"):
            with socket.create_connection(("127.0.0.1", service.port)) as stalled:
                stalled.sendall(half)
                stalled.settimeout(60)
                assert stalled.recv(4096) == b""

    @settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(st.data())
    def test_damaged_and_random_files(self, service: Service, data: st.DataObject) -> None:
        whole = wav(speech(0.5), format=data.draw(st.sampled_from(("WAV", "FLAC", "OGG"))))
        cut = whole[: data.draw(st.integers(0, len(whole)))]
        body = bytearray(
            data.draw(st.sampled_from((cut, whole, b"ftyp", b"#EXTM3U\nfile:///etc/passwd\n", b"\x1aE\xdf\xa3")))
        )
        for _ in range(data.draw(st.integers(0, 20))):
            if body:
                body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
        answer = service.ask("performances", bytes(body) + data.draw(st.binary(max_size=64)))
        assert answer.status in (200, 422), answer.body
        assert answer.status == 200 or answer.told["error"]

    @settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(st.lists(st.one_of(st.text(max_size=30), st.binary(max_size=300), st.just('{"end": true}')), max_size=6))
    def test_random_streams(self, service: Service, messages: list[str | bytes]) -> None:
        with service.stream() as connection, contextlib.suppress(ConnectionClosed):
            connection.send("{}")
            for message in messages:
                connection.send(message)
            connection.send("{}")
            while True:
                connection.recv(120)

    def test_service_still_works_and_wrote_only_in_its_folder(self, service: Service) -> None:
        well(service)
        assert {each.name for each in service.place.iterdir()} == {
            "face_live",
            "talkingeyes",
            "talkingeyes_live",
            "temporary",
        }


def choose_file(browser: Browser, selector: str, path: Path) -> None:
    node = browser.call("DOM.getDocument")["root"]["nodeId"]
    field = browser.call("DOM.querySelector", nodeId=node, selector=selector)["nodeId"]
    browser.call("DOM.setFileInputFiles", nodeId=field, files=[str(path)])


def unnamed_controls(browser: Browser) -> list[str]:
    """Roles of controls for which a screen reader has no name."""
    browser.call("Accessibility.enable")
    roles = {"button", "link", "radio", "checkbox", "slider", "combobox", "spinbutton", "meter", "image", "textbox"}
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    shown = [each for each in nodes if not each["ignored"] and each.get("role", {}).get("value") in roles]
    assert len(shown) >= 5
    return [each["role"]["value"] for each in shown if not each.get("name", {}).get("value")]


PLAYING = "document.body.dataset.state === 'playing'"
KEYS = {"Home": 36, "ArrowRight": 39}
WAVE_HEIGHTS = """(() => {
    const canvas = document.getElementById("wave");
    const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const column = (x) => Array.from({ length: height }, (_, y) => data[4 * (y * width + x) + 3]);
    const columns = Array.from({ length: width }, (_, x) => column(x).filter(Boolean).length);
    return [Math.max(...columns.slice(0, 0.3 * width)), Math.max(...columns.slice(0.4 * width))];
})()"""
SENT = """(() => {
    const send = WebSocket.prototype.send;
    window.sent = [];
    WebSocket.prototype.send = function (data) {
        if (typeof data === "string") sent.push(data);
        return send.call(this, data);
    };
})()"""
REQUESTED = "performance.getEntriesByType('resource').filter((each) => each.name.includes('performances?'))"


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
class TestPage:
    def test_upload_is_animated_with_sound_and_controls(self, service: Service, tmp_path: Path) -> None:
        (tmp_path / "speech.wav").write_bytes(wav(speech(3.0)))
        with open_browser(tmp_path / "profile") as browser:
            browser.open(service.address)
            browser.wait_for("document.body.dataset.state === 'ready'")
            choose_file(browser, "#upload", tmp_path / "speech.wav")
            browser.wait_for(PLAYING)
            browser.wait_for("document.getElementById('sound').currentTime > 0.2")
            assert browser.value("document.querySelectorAll('#downloads a').length") == len(convert.FORMATS)
            for control, asked in (
                ("document.querySelectorAll('[name=seed]')[1]", "seed=1&"),
                ("document.getElementById('another')", "seed=3&"),
                ("document.querySelectorAll('[name=seed]')[2]", "seed=2&"),
            ):
                browser.value(f"{control}.click()")
                browser.wait_for(f"{REQUESTED}.at(-1).name.includes('{asked}') && {PLAYING}")
            count = browser.value(f"{REQUESTED}.length")
            browser.value("document.querySelector('[name=seed]').click()")  # back to the first, without waiting
            assert (browser.value(PLAYING), browser.value(f"{REQUESTED}.length")) == (True, count)
            browser.value("document.getElementById('request').person.value = 'bert'")
            browser.value(
                "document.getElementById('request').person.dispatchEvent(new Event('change', {bubbles: true}))"
            )
            browser.wait_for(f"{REQUESTED}.at(-1).name.includes('person=bert') && {PLAYING}")
            browser.screenshot(tmp_path / "page.png")
        assert (tmp_path / "page.png").stat().st_size > 20_000

    def test_dropped_file_shows_its_waveform_which_the_keyboard_seeks(self, service: Service, tmp_path: Path) -> None:
        sound = np.concatenate((np.zeros(SAMPLE_RATE), speech(2.0))).astype(np.float32)
        (tmp_path / "speech.wav").write_bytes(wav(sound))
        data = {"items": [], "files": [str(tmp_path / "speech.wav")], "dragOperationsMask": 1}
        with open_browser(tmp_path / "profile") as browser:
            browser.open(service.address)
            browser.wait_for("document.body.dataset.state === 'ready'")
            for kind in ("dragEnter", "dragOver", "drop"):
                browser.call("Input.dispatchDragEvent", type=kind, x=300, y=400, data=data)
            browser.wait_for(PLAYING)
            assert browser.value("document.getElementById('upload').files[0].name") == "speech.wav"
            browser.value("document.getElementById('sound').pause()")
            browser.value("document.getElementById('seek').focus()")
            for key in ("Home", "ArrowRight"):
                browser.call("Input.dispatchKeyEvent", type="rawKeyDown", key=key, windowsVirtualKeyCode=KEYS[key])
            assert 0 < browser.value("document.getElementById('sound').currentTime") < 0.1
            browser.wait_for("document.getElementById('seek').ariaValueText === '0.0 of 3.0 seconds'")
            heights = browser.value(WAVE_HEIGHTS)
        assert heights[0] <= 4  # a second of silence
        assert heights[1] > 40

    def test_downloads_and_face_motion_with_eyes(self, service: Service, tmp_path: Path) -> None:
        (tmp_path / "speech.wav").write_bytes(wav(speech(2.0)))
        face_files.live_link(tmp_path / "lips.csv", frames=90)
        with open_browser(tmp_path / "profile") as browser:
            browser.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "got"))
            browser.open(service.address)
            browser.wait_for("document.body.dataset.state === 'ready'")
            assert browser.value("document.getElementById('face').disabled")
            choose_file(browser, "#upload", tmp_path / "speech.wav")
            browser.wait_for(PLAYING)
            for title in ("GLB", "ARKit JSON", "Live Link CSV"):
                browser.value(
                    f"[...document.querySelectorAll('#downloads a')].find((a) => a.text === '{title}').click()"
                )
                browser.wait_for(f"document.getElementById('status').value === '{title} is downloaded'")
            choose_file(browser, "#face", tmp_path / "lips.csv")
            browser.wait_for("document.getElementById('status').value === 'eyes_lips.csv is downloaded'")
            expected = {"talkingeyes.glb", "talkingeyes.arkit.json", "talkingeyes.livelink.csv", "eyes_lips.csv"}
            until = time.monotonic() + 60
            while {each.name for each in (tmp_path / "got").glob("*")} != expected and time.monotonic() < until:
                time.sleep(0.1)
            choose_file(browser, "#face", tmp_path / "speech.wav")
            browser.wait_for("document.body.dataset.state === 'error'")
            assert "should be one of csv" in browser.value("document.getElementById('status').value")
            choose_file(browser, "#upload", tmp_path / "lips.csv")  # no sound: what was there before is not offered
            browser.wait_for("document.getElementById('status').value.includes('should be the sound file itself')")
            assert browser.value("document.querySelectorAll('#downloads a').length") == 0
        assert {each.name for each in (tmp_path / "got").iterdir()} == expected
        assert (tmp_path / "got/eyes_lips.csv").read_bytes() != (tmp_path / "lips.csv").read_bytes()

    @pytest.mark.parametrize("name", ["", "docs"])
    def test_a_phone_has_no_overflow_and_every_control_a_name(
        self, service: Service, tmp_path: Path, name: str
    ) -> None:
        with open_browser(tmp_path / "profile") as browser:
            metrics = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
            browser.call("Emulation.setDeviceMetricsOverride", **metrics)
            browser.open(service.address + name)
            if not name:
                browser.wait_for("document.body.dataset.state === 'ready'")
                browser.value("document.querySelectorAll('details').forEach((each) => (each.open = true))")
                browser.value("document.getElementById('level').hidden = false")
                browser.value("document.getElementById('feeling').hidden = false")
            assert browser.value("document.documentElement.scrollWidth") == 390
            assert unnamed_controls(browser) == []
            assert browser.value("document.querySelectorAll('a[href=docs]').length") == (0 if name else 1)

    def test_microphone_moves_the_head_and_becomes_an_animation(
        self, service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "speech.wav").write_bytes(wav(speech(3.0), 48_000))
        fake = ("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream")
        file = f"--use-file-for-fake-audio-capture={tmp_path / 'speech.wav'}"
        monkeypatch.setattr("browser.FLAGS", (*FLAGS, *fake, file))
        with open_browser(tmp_path / "profile") as browser:
            browser.open(service.address)
            browser.wait_for("document.body.dataset.state === 'ready'")
            assert browser.value("document.getElementById('level').hidden")
            browser.value("document.getElementById('record').click()")
            browser.wait_for("document.body.dataset.state === 'live'")
            browser.wait_for("document.getElementById('level').value > -45")
            picture = browser.value("document.getElementById('head').toDataURL()")
            browser.wait_for("Number(document.body.dataset.frames) > 25")
            assert browser.value("document.getElementById('head').toDataURL()") != picture
            browser.value(SENT)
            browser.value("document.getElementById('state').value = 'thinking'")
            browser.value("document.getElementById('state').dispatchEvent(new Event('change', {bubbles: true}))")
            assert json.loads(browser.value("sent.join()"))["set"]["state"] == "thinking"
            frames = browser.value("Number(document.body.dataset.frames)")
            browser.wait_for(f"Number(document.body.dataset.frames) > {frames + 25}")
            browser.value("document.getElementById('record').click()")
            browser.wait_for(PLAYING)
            assert browser.value("document.getElementById('level').hidden")

    @pytest.mark.slow
    def test_packaged_model_shows_an_emotion_and_gives_a_film(self, tmp_path: Path) -> None:
        (tmp_path / "speech.wav").write_bytes(wav(speech(1.5)))
        command = [sys.executable, "-c", "from talkingeyes.cli.main import main; main()", "serve", "--port", "0"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
        assert process.stdout is not None
        try:
            address = process.stdout.readline().split()[0]
            with open_browser(tmp_path / "profile") as browser:
                browser.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "got"))
                browser.open(address)
                browser.wait_for("document.body.dataset.state === 'ready'")
                choose_file(browser, "#upload", tmp_path / "speech.wav")
                browser.wait_for(PLAYING)
                assert browser.value("document.getElementById('request').intensity.disabled")
                browser.value("document.querySelector('[name=emotion][value=happy]').click()")
                browser.wait_for(f"{REQUESTED}.at(-1).name.includes('emotion=happy&intensity=2') && {PLAYING}")
                assert not browser.value("document.getElementById('request').intensity.disabled")
                browser.value("document.querySelector('#downloads a[href$=mp4]').click()")
                browser.wait_for("document.getElementById('status').value === 'Film (MP4) is downloaded'", 120)
                until = time.monotonic() + 60
                while not (tmp_path / "got/talkingeyes.mp4").exists() and time.monotonic() < until:
                    time.sleep(0.1)
        finally:
            process.terminate()
            process.wait(timeout=120)
            process.stdout.close()
        assert (tmp_path / "got/talkingeyes.mp4").read_bytes()[4:8] == b"ftyp"
