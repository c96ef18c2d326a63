"""The default model in the registry of MLflow: registered once, loaded and served without the workspace."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import closing

import numpy as np
import pytest
import soundfile
from browser import CHROMIUM, open_browser
from test_mlflow_server import serving

from pipelines.register_model import register
from talkingeyes.animation.model_file import PACKAGED_MODEL
from talkingeyes.core.errors import InputError
from talkingeyes.workflows.animate import animate_samples

SECONDS, RATE = 2.0, 16_000


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A workspace without a trained model; the packaged model is registered."""
    root = tmp_path_factory.mktemp("registry")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        assert register(root) == "models:/talkingeyes/1"
        assert not os.environ.get("MLFLOW_TRACKING_URI")
    return root


@pytest.fixture(scope="module")
def speech(tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "speech.wav"
    soundfile.write(path, np.random.default_rng(0).normal(0, 0.1, round(SECONDS * RATE)), RATE)
    return path


def client(root):
    from mlflow import MlflowClient

    return MlflowClient(f"sqlite:///{root / 'mlflow.db'}")


@pytest.mark.long
def test_the_same_model_is_registered_once_and_another_as_the_next_version(root, monkeypatch, tmp_path):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    assert register(root) == "models:/talkingeyes/1"
    version = client(root).get_model_version("talkingeyes", "1")
    assert version.tags["source"] == "the packaged model"
    client(root).set_model_version_tag("talkingeyes", "1", "sha256", "of other weights")
    assert register(root) == "models:/talkingeyes/2"
    with pytest.raises(InputError, match="should be a folder"):
        register(tmp_path / "nothing")


def test_it_contains_its_weights_and_gives_the_motion_of_animate(root, speech, tmp_path, monkeypatch):
    import mlflow

    monkeypatch.chdir(tmp_path)
    stored = next((root / "mlartifacts" / "models").glob("*/artifacts/artifacts/talkingeyes_events.safetensors"))
    assert stored.read_bytes() == PACKAGED_MODEL.read_bytes()
    model = mlflow.pyfunc.load_model(str(stored.parents[1]))
    assert model.metadata.signature.params.to_dict()[0]["name"] == "seed"
    table = model.predict([{"speech": str(speech)}], params={"seed": 3, "samples": 2})
    assert list(table.columns) == model.metadata.signature.outputs.input_names()
    expected = animate_samples(speech, 2, seed=3, model=PACKAGED_MODEL)
    for sample, animation in enumerate(expected):
        rows = table[table["sample"] == sample]
        np.testing.assert_array_equal(rows["frame"], np.arange(len(animation.motion)))
        np.testing.assert_allclose(rows[["head_x", "head_y", "head_z"]], animation.motion.head)
        np.testing.assert_allclose(rows[["gaze_right_x", "gaze_right_y"]], animation.motion.gaze[:, 1, :2])
        np.testing.assert_allclose(rows["expression_browInnerUp"], animation.motion.expression[:, 2])
    with pytest.raises(InputError, match=r"nothing\.wav: cannot be opened"):
        model.predict([{"speech": "nothing.wav"}])


@pytest.mark.slow
def test_mlflow_serves_it(root, speech):
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "mlflow", "models", "serve", "-m", "models:/talkingeyes/1"]
    command += ["--env-manager", "local", "-h", "127.0.0.1", "-p", str(port)]
    environment = {**os.environ, "MLFLOW_TRACKING_URI": f"sqlite:///{root / 'mlflow.db'}"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=environment, start_new_session=True, **quiet)
    try:
        for _ in range(480):
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/ping", timeout=5):
                    break
            except OSError:
                assert process.poll() is None, "the server has ended"
                time.sleep(0.25)
        content = {"dataframe_records": [{"speech": str(speech)}], "params": {"samples": 2}}
        request = urllib.request.Request(
            f"http://127.0.0.1:{port}/invocations",
            data=json.dumps(content).encode(),
            headers={"Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=60) as answer:
            rows = json.load(answer)["predictions"]
        assert [rows[0]["sample"], rows[-1]["sample"]] == [0, 1]
        assert len(rows) == 2 * round(SECONDS * 25)
    finally:
        os.killpg(process.pid, 15)
        process.wait(timeout=60)


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
def test_the_registered_model_is_shown_with_its_signature(root, tmp_path):
    with serving(root) as server, open_browser(tmp_path / "profile") as browser:
        browser.open(f"{server.address}/#/models/talkingeyes/versions/1")
        browser.wait_for("document.body.innerText.includes('Outputs (')")
        text = browser.value("document.body.innerText")
    for shown in ("talkingeyes", "the packaged model", "Inputs ("):
        assert shown in text
