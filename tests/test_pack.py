"""A model in one file: packing, loading without conf/, errors for damaged or foreign files."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from toy_model import sound_file, toy_model

import talkingeyes
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.model_file import (
    METADATA_KEY,
    PACKAGED_LIVE_MODEL,
    PACKAGED_MODEL,
    PACKAGED_MODELS,
    PACKAGED_REMOTE_CALL_MODEL,
    SCHEMA,
    find_model,
    open_model,
    read_packed_metadata,
)
from talkingeyes.animation.streaming import LiveModel
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.packed import PACKAGED
from talkingeyes.workflows.pack import pack

pytestmark = pytest.mark.usefixtures("models_loaded_once")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model, unpacked and packed, and a sound."""
    root = tmp_path_factory.mktemp("packed")
    pack(toy_model(root / "train" / "toy"), root / "toy.safetensors")
    sound_file(root / "a.wav", 2.0)
    return root


def test_a_packed_model_performs_as_its_folder_does(place: Path) -> None:
    one, other = (
        talkingeyes.animate(place / "a.wav", seed=3, model=place / name) for name in ("train/toy", "toy.safetensors")
    )
    np.testing.assert_array_equal(one.motion.gaze, other.motion.gaze)
    np.testing.assert_array_equal(one.motion.head, other.motion.head)
    assert one.events == other.events


def test_pack_lists_its_sources(place: Path) -> None:
    packed = read_packed_metadata(place / "toy.safetensors")
    assert packed.models == ("toy",)
    assert json.loads(packed.files["toy/config.json"])["model"]["kind"] == "similar"
    assert set(packed.files) == {"toy/config.json", "toy/embedding.json", "toy/blinks.json", "toy/speakers.json"}
    assert (packed.encoder["kind"], packed.encoder["channels"]) == ("logmel", 28)


def test_the_same_model_packs_into_the_same_bytes(place: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        pack([place / "train" / "toy"], tmp_path / f"{name}.safetensors")
    assert (tmp_path / "one.safetensors").read_bytes() == (tmp_path / "two.safetensors").read_bytes()


def test_pack_can_contain_several_models(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "train" / "toy", tmp_path / "face")
    done = pack([place / "train" / "toy", tmp_path / "face"], tmp_path / "both.safetensors")
    assert done.models == ("toy", "face")
    with open_model(tmp_path / "both.safetensors") as folder:
        assert folder.name == "toy"
        assert (folder.parent / "face" / "model.safetensors").is_file()
    assert not folder.exists()


def test_linked_folders_keep_their_names(place: Path, tmp_path: Path) -> None:
    for name in ("talkingeyes_events", "probtalk3d"):  # as in a workspace whose results lie in a store
        (tmp_path / name).symlink_to(shutil.copytree(place / "train" / "toy", tmp_path / f"store-{name}" / "output"))
    done = pack(tmp_path / "talkingeyes_events", tmp_path / "both.safetensors", half_precision=True)
    assert done.models == ("talkingeyes_events", "probtalk3d")


@pytest.mark.long
def test_packed_model_needs_no_conf(place: Path, repository: Path, tmp_path: Path) -> None:
    """An installed copy of the package in another folder, without the repository."""
    shutil.copytree(
        repository / "src" / "talkingeyes",
        tmp_path / "site" / "talkingeyes",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    (tmp_path / "empty").mkdir()
    shutil.copy(place / "toy.safetensors", tmp_path / "empty")
    words = [
        "animate",
        str(place / "a.wav"),
        "-o",
        "out",
        "--model",
        "toy.safetensors",
        "--samples",
        "1",
        "--no-previews",
    ]
    ended = subprocess.run(
        [sys.executable, "-m", "talkingeyes.cli.main", *words],
        cwd=tmp_path / "empty",
        env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr
    here = talkingeyes.animate(place / "a.wav", model=place / "toy.safetensors")
    there = Motion.load(tmp_path / "empty" / "out" / "sample_00.npz")
    np.testing.assert_allclose(there.head, here.motion.head, atol=1e-6)


def test_half_precision_halves_the_weights_and_hardly_moves_the_motion(place: Path, tmp_path: Path) -> None:
    pack(place / "train" / "toy", tmp_path / "half.safetensors", half_precision=True)
    assert (tmp_path / "half.safetensors").stat().st_size < 0.7 * (place / "toy.safetensors").stat().st_size
    one, other = (
        talkingeyes.animate(place / "a.wav", seed=3, model=path)
        for path in (place / "toy.safetensors", tmp_path / "half.safetensors")
    )
    np.testing.assert_allclose(one.motion.head, other.motion.head, atol=1e-3)


def test_the_default_is_the_model_of_the_workspace_then_the_packaged_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_model("some/model") == Path("some/model")
    assert find_model(None) == PACKAGED_MODEL
    assert find_model(Path("talkingeyes_remote_call")) == PACKAGED_REMOTE_CALL_MODEL
    (tmp_path / "talkingeyes_remote_call").mkdir()
    assert find_model("talkingeyes_remote_call") == Path("talkingeyes_remote_call"), "a folder of that name goes first"
    (tmp_path / "data" / "train" / "talkingeyes_events").mkdir(parents=True)
    assert find_model("talkingeyes") == Path("talkingeyes"), "no row of that name is trained"
    (tmp_path / "data" / "train" / "talkingeyes").mkdir()
    assert find_model("talkingeyes") == Path("data/train/talkingeyes")
    assert find_model(None) == Path("data/train/talkingeyes_events")


def test_the_packaged_models_are_small_and_complete() -> None:
    assert sum(each.stat().st_size for each in PACKAGED_MODELS.values()) < 9e6
    animator = Animator.load(PACKAGED_MODEL)
    assert animator.face is not None
    assert animator.persons
    assert LiveModel.load(PACKAGED_LIVE_MODEL).latency_s < 0.25
    for path in (PACKAGED_LIVE_MODEL, PACKAGED_REMOTE_CALL_MODEL):
        assert Animator.load(path).face is not None, "it has the face of the default"
    assert Animator.load(PACKAGED_REMOTE_CALL_MODEL).persons


def interpreter(version: str) -> str | None:
    """A Python of this version that runs, on the path or among those of pyenv."""
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return sys.executable
    of_pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for found in filter(None, (shutil.which(f"python{version}"), *map(str, of_pyenv))):
        if not subprocess.run([found, "-c", ""], capture_output=True, check=False).returncode:
            return found
    return None


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_the_wheel_animates_in_an_empty_environment_and_folder(repository: Path, tmp_path: Path, version: str) -> None:
    """Needs the package registry of pip."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"no python{version} here")
    source = tmp_path / "source"  # setuptools builds inside the source tree
    shutil.copytree(repository / "src", source / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(repository / name, source)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def run(*command: str | Path) -> str:
        ended = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=600
        )
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation")
    run(*pip, "--wheel-dir", str(tmp_path), str(source))
    (wheel,) = tmp_path.glob("talkingeyes-*.whl")
    assert wheel.stat().st_size - PACKAGED.stat().st_size < 8e6
    run(python, "-m", "venv", str(tmp_path / "venv"))
    run(tmp_path / "venv" / "bin" / "pip", "install", "--quiet", "--no-compile", wheel)
    installed = run(tmp_path / "venv" / "bin" / "pip", "list", "--format", "freeze")
    assert "torch==" not in installed
    sound_file(tmp_path / "speech.wav", 2.0)
    command = tmp_path / "venv" / "bin" / "talkingeyes"
    said = run(command, "animate", "speech.wav", "--samples", "1")
    assert said == "speech: 1 motion of 2.00 s at 25 fps; head, gaze and face: the packaged model\n"
    made = {path.name for path in (tmp_path / "speech").iterdir()}
    assert {"sample_00.npz", "sample_00.mp4", "traces.png", "sheet.png"} <= made
    motion = "speech/sample_00.npz"
    run(command, "export", motion, "-f", "glb", "-o", "head.glb")
    run(command, "render", motion, "-o", "film.mp4")
    run(command, "view", motion, "--sound", "speech.wav", "--page", "page.html")
    run(command, "benchmark-corpus", "corpus")
    run(command, "evaluate", "speech", "--reference", "corpus", "-o", "measured", "--n-resamples", "20")
    assert (tmp_path / "measured" / "benchmark.json").is_file()


def foreign(path: Path) -> None:
    safetensors.numpy.save_file({"a": np.zeros(3, np.float32)}, path)


def newer(path: Path) -> None:
    safetensors.numpy.save_file(
        {"a": np.zeros(3, np.float32)}, path, {METADATA_KEY: json.dumps({"schema": "talkingeyes.model/2", "new": 1})}
    )


def outside(path: Path) -> None:
    said = {"schema": SCHEMA, "models": ["toy"], "files": {"toy/../../a.json": "{}"}, "encoder": {"kind": "logmel"}}
    safetensors.numpy.save_file(
        {"toy/a.safetensors:a": np.zeros(3, np.float32)}, path, {METADATA_KEY: json.dumps(said)}
    )


def other_encoder(path: Path) -> None:
    said = {"schema": SCHEMA, "models": ["toy"], "files": {}}
    said["encoder"] = {"kind": "moonshine", "weights_sha256": "0" * 64}
    safetensors.numpy.save_file(
        {"toy/a.safetensors:a": np.zeros(3, np.float32)}, path, {METADATA_KEY: json.dumps(said)}
    )


def test_an_error_about_the_face_names_the_packed_file(place: Path, tmp_path: Path) -> None:
    """As of a file of a version whose faces had other settings."""
    path = tmp_path / "model.safetensors"
    with open_model(PACKAGED_MODEL) as folder:
        shutil.copytree(folder.parent, tmp_path / "models")
    config = tmp_path / "models" / "probtalk3d" / "config.json"
    content = json.loads(config.read_text())
    del content["model"]["temperature"]
    config.write_text(json.dumps(content))
    pack([tmp_path / "models" / name for name in ("talkingeyes_events", "probtalk3d")], path)
    with pytest.raises(InputError, match="not a face model of this version") as caught:
        talkingeyes.animate(place / "a.wav", model=path)
    assert str(caught.value).startswith(f"{path}/probtalk3d: ")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:2000]), "not a readable folder of the train stage or file"),
        (lambda path: path.write_bytes(b"RIFF" + bytes(100)), "not a readable folder of the train stage or file"),
        (lambda path: path.write_bytes(b""), "not a readable folder of the train stage or file"),
        (foreign, "should be a model of `talkingeyes pack` (talkingeyes.model/1), got None"),
        (newer, "should be a model of `talkingeyes pack` (talkingeyes.model/1), got talkingeyes.model/2"),
        (outside, "holds 'toy/../../a.json', which belongs to none of its models"),
        (other_encoder, "made with other weights of the speech encoder moonshine"),
        (Path.unlink, "no trained model here"),
    ],
)
def test_invalid_model_is_one_line_error(place: Path, tmp_path: Path, spoil, message: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "model.safetensors"
    shutil.copy(place / "toy.safetensors", path)
    spoil(path)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        talkingeyes.animate(place / "a.wav", model=path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "embedding.json").unlink(), "got one without embedding.json"),
        (lambda folder: (folder / "embedding.json").write_text("{}"), "not the embedding of a trained model"),
        (lambda folder: (folder / "model.safetensors").write_bytes(b"no"), "not a readable file of weights"),
        (lambda folder: (folder / "x.bin").write_bytes(b"\xff\xfe\x00"), "should be a text or safetensors file"),
        (shutil.rmtree, "should be a trained model"),
    ],
)
def test_failed_packing_leaves_no_file(place: Path, tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    shutil.copytree(place / "train" / "toy", tmp_path / "toy")
    change(tmp_path / "toy")
    with pytest.raises(InputError, match=message):
        pack(tmp_path / "toy", tmp_path / "a.safetensors")
    assert not list(tmp_path.glob("*a.safetensors*"))
