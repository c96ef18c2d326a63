"""A model in one file: packed, opened elsewhere without conf/, refused when damaged or foreign."""

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
from talkingeyes.animation.model_file import METADATA_KEY, SCHEMA, open_model, read_packed_metadata
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.workflows.pack import pack


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model, as a folder and packed, and a sound."""
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


def test_it_says_what_it_was_made_of(place: Path) -> None:
    packed = read_packed_metadata(place / "toy.safetensors")
    assert packed.models == ("toy",)
    assert json.loads(packed.files["toy/config.json"])["model"]["kind"] == "similar"
    assert set(packed.files) == {"toy/config.json", "toy/embedding.json", "toy/blinks.json", "toy/speakers.json"}
    assert (packed.encoder["kind"], packed.encoder["channels"]) == ("logmel", 23)


def test_the_same_model_packs_into_the_same_bytes(place: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        pack([place / "train" / "toy"], tmp_path / f"{name}.safetensors")
    assert (tmp_path / "one.safetensors").read_bytes() == (tmp_path / "two.safetensors").read_bytes()


def test_others_stand_beside_the_first(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "train" / "toy", tmp_path / "face")
    done = pack([place / "train" / "toy", tmp_path / "face"], tmp_path / "both.safetensors")
    assert done.models == ("toy", "face")
    with open_model(tmp_path / "both.safetensors") as folder:
        assert folder.name == "toy"
        assert (folder.parent / "face" / "model.safetensors").is_file()
    assert not folder.exists()


def test_another_machine_needs_no_conf(place: Path, repository: Path, tmp_path: Path) -> None:
    """An installed copy of the package alone, in another folder, with nothing of the repository around it."""
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


def foreign(path: Path) -> None:
    safetensors.numpy.save_file({"a": np.zeros(3, np.float32)}, path)


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


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:2000]), "got an unreadable file"),
        (lambda path: path.write_bytes(b"RIFF" + bytes(100)), "got an unreadable file"),
        (lambda path: path.write_bytes(b""), "got an unreadable file"),
        (foreign, "should be a model of `talkingeyes pack` (talkingeyes.model/1), got None"),
        (outside, "holds 'toy/../../a.json', which belongs to none of its models"),
        (other_encoder, "made with other weights of the speech encoder moonshine"),
        (Path.unlink, "no trained model here"),
    ],
)
def test_what_is_no_model_is_one_clear_line(place: Path, tmp_path: Path, spoil, message: str) -> None:  # type: ignore[no-untyped-def]
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
def test_what_cannot_be_packed_leaves_nothing(place: Path, tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    shutil.copytree(place / "train" / "toy", tmp_path / "toy")
    change(tmp_path / "toy")
    with pytest.raises(InputError, match=message):
        pack(tmp_path / "toy", tmp_path / "a.safetensors")
    assert not list(tmp_path.glob("*a.safetensors*"))
