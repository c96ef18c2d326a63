"""`talkingeyes view`: data of the page, its behaviour in a browser, and one-line errors."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import soundfile
from browser import CHROMIUM, open_browser
from command_line import call
from fastapi.testclient import TestClient
from scipy.spatial.transform import Rotation
from toy_workspace import toy_workspace

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.apps.viewer.assets import ASSETS_FOLDER, NAMES
from talkingeyes.apps.viewer.pose_encoding import POSE_COLUMNS, pose_rows
from talkingeyes.apps.viewer.scene import traces, waveform_peaks
from talkingeyes.apps.viewer.server import viewer_app
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Events, Motion
from talkingeyes.core.rotation import angles_to_gaze, eye_in_head
from talkingeyes.corpus.samples import Samples
from talkingeyes.formats.writers.glb import joint_offsets
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.gaze_controller import homogeneous
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.workflows.view import build_scene, write_page

FPS, FRAMES = 25.0, 50
LOCAL = "http://127.0.0.1"


def motion(seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    head = np.cumsum(rng.normal(0, 0.01, (FRAMES, 3)), axis=0)
    gaze = angles_to_gaze(np.cumsum(rng.normal(0, 0.02, (FRAMES, 2, 2)), axis=0))
    return Motion.of(FPS, head, gaze, jaw=np.full((FRAMES, 3), [0.1, 0, 0]), lid=rng.uniform(0, 1, (FRAMES, 2)))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with two motions of one sound, its words, and the truth."""
    monkeypatch.chdir(tmp_path)
    for index, name in enumerate(("a", "b", "true")):
        motion(index).save(tmp_path / f"{name}.npz")
    Events(blinks=(Blink(0.5, 0.1, 0.05, 0.2, 1.0),)).save(tmp_path / "a.events.json")
    soundfile.write("a.wav", np.sin(np.arange(32_000) / 10) * np.linspace(0, 0.5, 32_000), 16_000)
    Annotation(words=(Span(0.2, 0.6, "good"), Span(0.7, 1.2, "morning"))).save(tmp_path / "words.json")
    return tmp_path


def test_rows_have_the_pose_of_the_head(place: Path) -> None:
    head, shown = anny_head(), motion(3)
    rows, pose = pose_rows(head, shown), motion_to_pose(head, shown)
    assert rows.shape == (FRAMES, POSE_COLUMNS + len(head.expression_names))
    assert rows.dtype == np.dtype("<f4")
    assert np.allclose(rows[:, :3] - joint_offsets(head)[0], pose.translation, atol=1e-6)
    for place_, vectors in enumerate((pose.head, pose.jaw, pose.gaze[:, 0], pose.gaze[:, 1])):
        turned = Rotation.from_quat(rows[:, 3 + 4 * place_ : 7 + 4 * place_]).as_matrix()
        assert np.allclose(turned, Rotation.from_rotvec(vectors).as_matrix(), atol=1e-5)
    assert np.allclose(rows[:, POSE_COLUMNS:], pose.expression, atol=1e-6)


def test_page_data_has_truth_samples_words_and_sound(place: Path) -> None:
    scene = build_scene(["a.npz", "b.npz"], truth="true.npz", sound="a.wav", words="words.json")
    page = TestClient(viewer_app(scene, anny_head()), base_url=LOCAL)
    told = page.get("/scene.json").json()
    assert [(viewer_motion["name"], viewer_motion["truth"]) for viewer_motion in told["takes"]] == [
        ("true", True),
        ("a", False),
        ("b", False),
    ]
    assert told["words"] == [[0.2, 0.6, "good"], [0.7, 1.2, "morning"]]
    assert (told["seconds"], told["sound"]) == (2.0, True)
    assert told["takes"][1]["blinks"] == [[0.5, 0.85]]
    assert np.allclose(told["takes"][2]["traces"]["gaze_yaw_deg"], traces(motion(1))["gaze_yaw_deg"], atol=0.01)
    rows = np.frombuffer(page.get("/poses/2").content, "<f4").reshape(FRAMES, -1)
    assert np.array_equal(rows, pose_rows(anny_head(), Motion.load(Path("b.npz"))))
    assert page.get("/sound.wav").content[:4] == b"RIFF"
    assert page.get("/head.glb").content[:4] == b"glTF"
    assert "style.css" in page.get("/").text


def test_angles_left_and_up_are_positive() -> None:
    looking = Motion.of(FPS, np.zeros((1, 3)), angles_to_gaze(np.radians([[[10.0, 5.0], [10.0, 5.0]]])))
    found = traces(looking)
    assert (round(found["gaze_yaw_deg"][0], 3), round(found["gaze_pitch_deg"][0], 3)) == (10.0, 5.0)
    assert found["head_yaw_deg"][0] == 0


def test_the_outline_follows_the_loudness() -> None:
    peaks = waveform_peaks(np.concatenate([np.full(8000, 0.01), np.full(8000, 0.2)]))
    assert len(peaks) == 100
    assert set(peaks[:50]) == {0.05}
    assert set(peaks[51:]) == {1.0}


def test_a_clip_of_a_corpus_brings_its_sound_words_and_truth(tmp_path: Path) -> None:
    workspace = toy_workspace(tmp_path)
    clip = next(path for path in (tmp_path / "data/sample/random").rglob("*.npz"))
    scene = build_scene([clip], corpus=workspace.corpus)
    samples = Samples.load(clip)
    assert [viewer_motion.truth for viewer_motion in scene.viewer_motions] == [True] + [False] * len(samples.head)
    assert scene.viewer_motions[2].name == f"{clip.stem}, sample 1"
    assert np.array_equal(scene.viewer_motions[2].motion.head, samples.head[1])
    assert scene.sound is not None


def test_only_own_files_are_served(place: Path) -> None:
    page = TestClient(viewer_app(build_scene(["a.npz"]), anny_head()), base_url=LOCAL, raise_server_exceptions=False)
    for name in (
        "a.npz",
        "../a.npz",
        "..%2fa.npz",
        "%2e%2e/%2e%2e/etc/passwd",
        "poses/1",
        "poses/-1",
        "sound.wav",
        "x" * 5000,
    ):
        assert page.get(f"/{name}").status_code == 404, name
    assert page.post("/scene.json").status_code == 405
    answer = page.get("/", headers={"host": "elsewhere.example"})
    assert answer.status_code == 400
    assert "default-src 'self'" in page.get("/").headers["content-security-policy"]


def test_pages_load_nothing_from_elsewhere() -> None:
    for name in NAMES:
        if name == "three.js":
            continue
        text = (ASSETS_FOLDER / name).read_text()
        assert "//cdn" not in text
        assert "http:" not in text
        assert "https:" not in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.npz"], "none.npz: not a readable motion"),
        (["a.npz", "--truth", "none.npz"], "none.npz: not a readable motion"),
        (["a.npz", "--sound", "words.json"], "words.json: "),
        (["a.npz", "--annotation", "a.wav"], "a.wav: not a readable annotation"),
        (["a.npz", "--corpus", "."], "clips.parquet: not a readable corpus index"),
        (["a.npz", "--head", "duck"], "should be one of anny, flame"),
        (["a.npz"] * 13, "at most 12"),
        (["a.npz", "--port", "70000"], "port: should be 0 to 65535, got 70000"),
    ],
)
def test_a_mistake_is_one_line(place: Path, capfd: pytest.CaptureFixture[str], words: list[str], message: str) -> None:
    before = sorted(place.iterdir())
    status = call("view", *words)
    captured = capfd.readouterr()
    assert status == 2
    assert message in captured.err
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert sorted(place.iterdir()) == before


def test_a_port_that_is_taken_is_one_line(place: Path) -> None:
    from talkingeyes.workflows.view import view

    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(InputError, match="port: should be free"):
        view(["a.npz"], port=taken.getsockname()[1], on_start=lambda _: None)


@pytest.fixture
def address(place: Path) -> Iterator[str]:
    """The page of two motions with their truth."""
    with served("a.npz", "b.npz", "--truth", "true.npz", "--sound", "a.wav", "--annotation", "words.json") as found:
        yield found


@contextmanager
def served(*words: str) -> Iterator[str]:
    """Run the command on a free port."""
    command = [sys.executable, "-m", "talkingeyes.cli.main", "view", *words, "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process:
        yield process.stdout.readline().split(" ")[0]
        process.send_signal(2)
        assert process.wait(timeout=30) == 0


STATE = "JSON.stringify(document.body.dataset)"


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
def test_heads_play_synchronously_in_a_browser(address: str, tmp_path: Path) -> None:
    with open_browser(tmp_path / "profile") as browser:
        browser.open(f"{address}#at=0.8&rays=1")
        browser.wait_for("document.body.dataset.state == 'paused'")
        assert json.loads(browser.value(STATE))["frames"] == "20,20,20"
        assert browser.value("document.querySelectorAll('.take').length") == 3
        assert browser.value("document.querySelector('.take').classList.contains('truth')")
        still = browser.value("document.getElementById('heads').toDataURL()")
        assert len(set(still)) > 40
        browser.value("document.getElementById('forth').click()")
        browser.wait_for("document.body.dataset.frames == '21,21,21'")
        assert browser.value("document.getElementById('heads').toDataURL()") != still
        browser.value("document.getElementById('back').click()")
        browser.wait_for("document.body.dataset.frames == '20,20,20'")
        browser.value(
            "(speed => { speed.value = '0.5'; speed.onchange({target: speed}); })(document.getElementById('speed'))"
        )
        browser.value("document.getElementById('play').click()")
        browser.wait_for("document.body.dataset.state == 'playing'")
        assert browser.value("document.getElementById('sound').playbackRate") == 0.5
        browser.wait_for("Number(document.body.dataset.now) > 1")
        frames = json.loads(browser.value(STATE))["frames"].split(",")
        assert len(set(frames)) == 1  # synchronous
        browser.wait_for("document.body.dataset.state == 'paused' && document.body.dataset.now == '2.000'")
        box = browser.value("JSON.stringify(document.getElementById('whole').getBoundingClientRect())")
        left = json.loads(box)
        for kind in ("mousePressed", "mouseReleased"):
            at = {"x": left["x"] + left["width"] / 4, "y": left["y"] + 5}
            browser.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)
        browser.wait_for("document.body.dataset.frames == '12,12,12'")  # a quarter of two seconds
        browser.screenshot(tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 50_000


RAYS = """(async () => {
    const { THREE } = await import("./three.js"), { Stage } = await import("./stage.js");
    const stage = await Stage.open(document.createElement("canvas"), "head.glb", [document.body]);
    const rows = new Float32Array(await (await fetch("poses/0")).arrayBuffer());
    const frames = 4, columns = rows.length / frames;
    const found = [], point = new THREE.Vector3();
    for (let frame = 0; frame < frames; frame++) {
        stage.pose(0, rows.subarray(frame * columns, (frame + 1) * columns));
        stage.heads[0].scene.updateMatrixWorld(true);
        found.push(stage.heads[0].rays.map(({ matrixWorld }) => [0, 1].map((end) =>
            point.set(0, 0, end).applyMatrix4(matrixWorld).toArray())));
    }
    return found;
})()"""


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
def test_gaze_rays_go_from_the_pupils_to_what_is_looked_at(place: Path, tmp_path: Path) -> None:
    """In the page of the command; the last frame has parallel lines of sight, which meet nowhere."""
    points = np.array([[0.0, 0.0, 1.0], [0.3, 0.1, 0.9], [-0.1, -0.05, 0.5]])
    head = np.array([[0.0, 0.0, 0.0], [0.0, 0.2, 0.0], [-0.05, 0.0, 0.02], [0.0, 0.0, 0.0]])
    axes = line_of_sight.optical_axes_rad(head[:3], homogeneous(points), "world")
    axes = np.concatenate([axes, line_of_sight.MEAN_KAPPA_RAD[None]])
    Motion.of(FPS, head, eye_in_head(head, axes)).save(Path("met.npz"))
    model = anny_head()
    vertices = posed_vertices(model, motion_to_pose(model, to_forward_axes(Motion.load(Path("met.npz")))))
    with served("met.npz") as address, open_browser(tmp_path / "profile") as browser:
        browser.open(address)
        browser.wait_for("document.body.dataset.state == 'paused'")
        rays = np.array(browser.value(RAYS))  # frame, eye, end, axis
        without = browser.value("document.getElementById('heads').toDataURL()")
        browser.value("document.getElementById('rays').click()")
        browser.wait_for(f"document.getElementById('heads').toDataURL() != {json.dumps(without)}")
    np.testing.assert_allclose(rays[:, :, 0], vertices[:, model.pupils], atol=1e-5)
    met = points[:, None] + line_of_sight.BETWEEN_EYES_M
    assert np.linalg.norm(rays[:3, :, 1] - met, axis=-1).max() < 0.01
    np.testing.assert_allclose(np.linalg.norm(rays[3, :, 1] - model.eye_centres, axis=-1), 1.0, atol=1e-5)


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
def test_a_written_page_plays_without_a_server(place: Path, tmp_path: Path) -> None:
    page = (place / "page.html").resolve()
    write_page(["a.npz", "b.npz"], page, sound="a.wav")
    with open_browser(tmp_path / "profile") as browser:
        browser.open(f"{page.as_uri()}#at=0.8")
        browser.wait_for("document.body.dataset.state == 'paused'")
        assert json.loads(browser.value(STATE))["frames"] == "20,20"
        assert len(set(browser.value("document.getElementById('heads').toDataURL()"))) > 40
        assert browser.wait_for("document.getElementById('sound').duration") == pytest.approx(2.0, abs=0.1)
        browser.screenshot(tmp_path / "page.png")
    with pytest.raises(InputError, match=r"page\.html"):  # an existing page is kept
        write_page(["a.npz"], page)


def test_the_player_is_valid_javascript() -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    for name in NAMES:
        if name.endswith(".js") and name != "three.js":
            checked = subprocess.run(
                [node, "--input-type=module", "--check"],
                check=False,
                input=(ASSETS_FOLDER / name).read_bytes(),
                capture_output=True,
            )
            assert checked.returncode == 0, checked.stderr
