"""Pages of the recipes that drive an avatar from a live stream, in a browser: three-vrm and TalkingHead."""

from __future__ import annotations

import functools
import http.server
import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import soundfile
from browser import CHROMIUM, Browser, open_browser
from live_model import write_live_model
from scipy.spatial.transform import Rotation
from talkinghead_model import talkinghead_model
from test_streaming import speech
from test_vrm_player import angle_deg
from toy_model import toy_model
from vrm_model import vrm_model

from talkingeyes.audio.waveform import SAMPLE_RATE

PACKAGES = ("three@0.180", "@pixiv/three-vrm@3.5.5", "@met4citizen/talkinghead@1.7.0")
SERVE = """
import sys
from talkingeyes.workflows.serve import run_service
run_service(model=sys.argv[1], live=sys.argv[2], port=0, stream_origins=[sys.argv[3]], jobs=1,
            on_start=lambda each: print(each, flush=True))
"""
SECONDS = 3.0

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(300),
    pytest.mark.skipif(CHROMIUM is None or shutil.which("npm") is None, reason="needs chromium and npm"),
]


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder without a log, modules with their type."""

    extensions_map: ClassVar = {**http.server.SimpleHTTPRequestHandler.extensions_map, ".mjs": "text/javascript"}

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Iterator[tuple[str, str]]:
    """Addresses of a folder with the recipes, and of a service that accepts streams of its pages."""
    root = tmp_path_factory.mktemp("pages")
    subprocess.run(["npm", "install", "--no-audit", "--no-fund", *PACKAGES], cwd=root, check=True, timeout=120)
    for name in ("vrm_live.html", "talkinghead_live.html", "live_avatar.js", "stream_client.js"):
        shutil.copy(repository / "docs/recipes" / name, root)
    vrm_model(root / "avatar.vrm")
    talkinghead_model(root / "avatar.glb")
    soundfile.write(root / "a.wav", speech(SECONDS), SAMPLE_RATE, subtype="PCM_16")
    model, live = toy_model(root / "model"), write_live_model(root / "live")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(QuietHandler, directory=root)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        command = [sys.executable, "-c", SERVE, str(model), str(live), address]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root)
        assert process.stdout is not None
        stream = process.stdout.readline().strip().replace("http", "ws") + "stream"
        yield address, stream
        process.terminate()
        process.wait(timeout=120)
        process.stdout.close()
        server.shutdown()


def played(browser: Browser, address: str) -> list[dict[str, Any]]:
    """Open a page, play its sound through a stream, look aside from the middle on; return the frames."""
    browser.open(address)
    browser.wait_for("document.title == 'ready'")
    browser.value("void start()")
    browser.wait_for("document.querySelector('output').value.startsWith('live')")
    head = browser.value("[...document.querySelectorAll('[name=head]')].map((each) => (each.value = 0)).length")
    assert head == 1
    browser.value("document.querySelector('form').oninput()")
    browser.wait_for(f"document.title == 'ended after {round(25 * SECONDS)} frames'")
    frames: list[dict[str, Any]] = browser.value("last.frames")
    return frames


def test_a_vrm_avatar_follows_the_stream(pages: tuple[str, str], tmp_path: Path) -> None:
    with open_browser(tmp_path / "profile") as browser:
        frames = played(browser, f"{pages[0]}/vrm_live.html?sound=a.wav&service={pages[1]}")
        assert len(frames) == round(25 * SECONDS)
        for frame in frames[::7]:
            state = browser.value(f"stateOf({json.dumps(frame)})")
            yaw, pitch = np.radians(frame["look_deg"])
            look = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
            head = Rotation.from_quat(frame["head"])
            for eye in ("leftEye", "rightEye"):
                assert angle_deg(np.array(state[eye]), head.apply(look)) < 0.1
            assert angle_deg(np.array(state["head"]), head.apply([0.0, 0.0, 1.0])) < 0.1
            for name, ours in (("blinkLeft", "eyeBlinkLeft"), ("blinkRight", "eyeBlinkRight")):
                assert state[name] == pytest.approx(frame["blendshapes"][ours], abs=1e-4)
        still = np.array([each["head"] for each in frames[-15:]])  # the page's control of the head was set to 0
        assert np.abs(still - still[0]).max() < 1e-4 < np.abs(np.diff([each["head"] for each in frames], axis=0)).max()
        browser.screenshot(tmp_path / "vrm.png")
    assert (tmp_path / "vrm.png").stat().st_size > 20_000


def test_a_service_that_does_not_name_the_page_is_one_line(pages: tuple[str, str], tmp_path: Path) -> None:
    with open_browser(tmp_path / "profile") as browser:
        browser.open(f"{pages[0].replace('127.0.0.1', 'localhost')}/vrm_live.html?sound=a.wav&service={pages[1]}")
        browser.wait_for("document.title == 'ready'")
        browser.value("void start()")
        browser.wait_for("document.querySelector('output').value.includes('cannot be reached')")


# What TalkingHead makes of a frame: blend shapes on the mesh, and the turn of its head bone beyond its own pose.
DRIVEN = """((frame) => {
    drive(head, frame);
    head.updateMorphTargets(40);
    head.updateMorphTargets(40); // lids look at the gaze of the update before
    const mesh = head.morphs[0], weight = (name) => mesh.morphTargetInfluences[mesh.morphTargetDictionary[name]];
    const { x, y, z } = head.poseDelta.props["Head.quaternion"];
    const names = ["eyeBlink", "eyeLookIn", "eyeLookOut", "eyeWide"].flatMap((each) => [`${each}Left`, `${each}Right`]);
    names.push("eyesLookDown", "eyesLookUp");
    return { turn: [x, y, z], ...Object.fromEntries(names.map((name) => [name, weight(name)])) };
})"""


def test_talkinghead_follows_the_stream_and_gets_its_eyes_back(pages: tuple[str, str], tmp_path: Path) -> None:
    with open_browser(tmp_path / "profile") as browser:
        frames = played(browser, f"{pages[0]}/talkinghead_live.html?sound=a.wav&service={pages[1]}")
        browser.screenshot(tmp_path / "talkinghead.png")
        browser.value("void head.stop()")  # its own animation would turn the body between the frames
        browser.value("['X', 'Y', 'Z'].forEach((axis) => (head.mtAvatar[`bodyRotate${axis}`].applied = 0))")
        for frame in frames[::7]:
            found, shapes = browser.value(f"{DRIVEN}({json.dumps(frame)})"), frame["blendshapes"]
            wanted = Rotation.from_quat(frame["head"]).as_euler("XYZ")
            np.testing.assert_allclose(found["turn"], wanted, atol=1e-4)
            for name in ("eyeLookIn", "eyeLookOut", "eyeWide"):
                for side in ("Left", "Right"):
                    assert found[f"{name}{side}"] == pytest.approx(shapes[f"{name}{side}"], abs=1e-4)
            down, up = (
                np.mean([shapes[f"eyeLook{way}{side}"] for side in ("Left", "Right")]) for way in ("Down", "Up")
            )
            assert found["eyesLookDown"] == pytest.approx(down, abs=1e-4)
            assert found["eyesLookUp"] == pytest.approx(up, abs=1e-4)
            for side in ("Left", "Right"):  # TalkingHead closes lids further with gaze that is down, and with brows
                assert shapes[f"eyeBlink{side}"] - 1e-4 < found[f"eyeBlink{side}"]
                assert found[f"eyeBlink{side}"] < max(shapes[f"eyeBlink{side}"], down / 2) + 0.1
        browser.value("release(head)")
        assert browser.value("Object.values(head.mtAvatar).every(({ realtime }) => realtime === null)")
    assert (tmp_path / "talkinghead.png").stat().st_size > 50_000  # 12,000 without an avatar
