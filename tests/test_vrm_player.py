"""VRM animations on a VRM avatar, played by three-vrm in a browser (docs/recipes/vrm_player.html)."""

from __future__ import annotations

import functools
import http.server
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import face_files
import numpy as np
import pytest
import toy_motions
from browser import CHROMIUM, Browser, open_browser
from toy_model import sound_file, toy_model
from vrm_model import vrm_model

import talkingeyes as te
from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion

PACKAGES = ("three@0.187", "@pixiv/three-vrm@3.5.5", "@pixiv/three-vrm-animation@3.5.5")
MOMENTS = (0, 13, 28, 52, 70)  # at rest, in a saccade, between, in a blink, near the end
WITHIN_DEG = 0.1

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None or shutil.which("npm") is None, reason="needs chromium and npm"),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Iterator[tuple[Path, str]]:
    """A served folder with the recipe's page, its packages and the avatar, and its address."""
    root = tmp_path_factory.mktemp("vrm")
    subprocess.run(["npm", "install", "--no-audit", "--no-fund", *PACKAGES], cwd=root, check=True, timeout=120)
    shutil.copy(repository / "docs/recipes/vrm_player.html", root)
    vrm_model(root / "avatar.vrm")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=root)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield root, f"http://127.0.0.1:{server.server_port}/vrm_player.html"
        server.shutdown()


def played(page: tuple[Path, str], motion: str, browser: Browser) -> None:
    browser.open(f"{page[1]}?avatar=avatar.vrm&motion={motion}&at=0")
    browser.wait_for("document.title == 'ready'")


def angle_deg(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))


def check(browser: Browser, motion: Motion) -> None:
    """Eyes, head and blinks on the avatar are those of a motion (gaze: forward axes) at MOMENTS."""
    matrices = rotation.rotvec_to_matrix(motion.head)
    looks = rotation.angles_to_direction(rotation.cyclopean_gaze(rotation.gaze_to_angles(motion.gaze)))
    for frame in MOMENTS:
        state = browser.value(f"stateAt({frame / motion.fps})")
        for eye in ("leftEye", "rightEye"):
            assert angle_deg(np.array(state[eye]), matrices[frame] @ looks[frame]) < WITHIN_DEG
        assert angle_deg(np.array(state["head"]), matrices[frame] @ [0.0, 0.0, 1.0]) < WITHIN_DEG
        for eye, name in enumerate(("blinkLeft", "blinkRight")):
            assert state[name] == pytest.approx(max(motion.lid[frame, eye], 0.0), abs=1e-4)


def test_an_exported_animation_looks_and_blinks(page: tuple[Path, str], tmp_path: Path) -> None:
    te.export(toy_motions.motion(), page[0] / "motion.vrma", force=True)
    with open_browser(tmp_path / "profile") as browser:
        played(page, "motion.vrma", browser)
        check(browser, to_forward_axes(toy_motions.motion()))


def test_lips_of_another_program_get_eyes(page: tuple[Path, str], tmp_path: Path) -> None:
    face_files.lips_vrma(tmp_path / "lips.vrma")
    sound, model = sound_file(tmp_path / "speech.wav", seconds=3.0), toy_model(tmp_path / "model")
    out = page[0] / "with_eyes.vrma"
    done = te.add_eyes(tmp_path / "lips.vrma", sound, out, seed=2, model=model, force=True)
    with open_browser(tmp_path / "profile") as browser:
        played(page, "with_eyes.vrma", browser)
        check(browser, to_forward_axes(done.animation.motion))
        open_mouth = [browser.value(f"stateAt({frame / 30}).aa") for frame in MOMENTS]
    np.testing.assert_allclose(open_mouth, face_files.weights(75, 6)[list(MOMENTS), 0], atol=1e-4)
