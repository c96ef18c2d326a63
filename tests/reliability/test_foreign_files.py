"""Files of strangers: models that name code or repositories, corpora whose ids are paths."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from typing import Any

import pytest
import safetensors.numpy
from safetensors import safe_open
from toy_model import toy_model

from talkingeyes.animation.animator import Animator
from talkingeyes.animation.model_file import ALLOW_PLUGINS, METADATA_KEY, PACKAGED_MODEL
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip, read_index, write_index
from talkingeyes.workflows.pack import pack


@pytest.fixture
def model(tmp_path: Path) -> Path:
    pack(toy_model(tmp_path / "train" / "toy"), tmp_path / "toy.safetensors")
    return tmp_path / "toy.safetensors"


def with_encoder(model: Path, encoder: dict[str, Any]) -> Path:
    """The packed model with another encoder in its embedding.json."""
    with safe_open(model, "np") as file:
        header = json.loads(file.metadata()[METADATA_KEY])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    embedding = json.loads(header["files"]["toy/embedding.json"])
    embedding["settings"]["encoder"] = encoder
    header["files"]["toy/embedding.json"] = json.dumps(embedding)
    header["encoder"] |= {"kind": encoder["kind"], "settings": embedding["settings"]}
    safetensors.numpy.save_file(tensors, model, {METADATA_KEY: json.dumps(header)})
    return model


def test_a_packed_model_runs_no_code_of_its_choice(model: Path, tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "hostile_module.py").write_text(f"import pathlib\npathlib.Path({str(tmp_path / 'ran')!r}).touch()\n")
    monkeypatch.syspath_prepend(tmp_path)
    with_encoder(model, {"kind": "hostile_module:Encoder"})
    with pytest.raises(InputError, match=r"names the class 'hostile_module:Encoder'.*TALKINGEYES_ALLOW_PLUGINS=1"):
        Animator.load(model)
    assert not (tmp_path / "ran").exists()
    assert "hostile_module" not in sys.modules
    monkeypatch.setenv(ALLOW_PLUGINS, "1")  # the user's own choice
    with pytest.raises(InputError):
        Animator.load(model)
    assert (tmp_path / "ran").exists()


@pytest.mark.long
def test_opening_a_packed_model_asks_no_hub(model: Path, monkeypatch: Any) -> None:
    transformers = pytest.importorskip("transformers")
    asked: list[dict[str, Any]] = []

    def from_pretrained(name: str, **options: Any) -> Any:
        asked.append(options)
        raise OSError("not in the cache")

    monkeypatch.setattr(transformers.AutoConfig, "from_pretrained", from_pretrained)
    encoder = {"kind": "wav2vec2", "checkpoint": "someone/else", "layer": 1, "window_s": 10, "overlap_s": 1}
    with pytest.raises(InputError, match="should be a local folder or a downloaded checkpoint, got 'someone/else'"):
        Animator.load(with_encoder(model, encoder))
    assert asked == [{"local_files_only": True}]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "toy/config.json should be JSON"),
        ("[" * 100_000, "toy/config.json should be JSON"),
        (
            '{"model": {"speech": {"waveform_encoder": {"checkpoint": "someone/else"}}}, "architecture": null}',
            "architecture",
        ),
    ],
)
def test_a_damaged_or_greedy_configuration_is_one_line(model: Path, text: str, message: str) -> None:
    with safe_open(model, "np") as file:
        header = json.loads(file.metadata()[METADATA_KEY])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    header["files"]["toy/config.json"] = text
    safetensors.numpy.save_file(tensors, model, {METADATA_KEY: json.dumps(header)})
    with pytest.raises(InputError, match=message) as caught:
        Animator.load(model)
    assert "\n" not in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize(("key", "number"), [("width", 20_000), ("width", 10**7), ("layers", 10**9)])
def test_a_configuration_cannot_name_a_larger_network_than_its_file(tmp_path: Path, key: str, number: int) -> None:
    """Layers are refused before their memory is used: 20,000 wide would be 1.6 GB a layer."""

    def enlarge(node: Any) -> Any:
        if isinstance(node, dict):
            return {name: number if name == key and each else enlarge(each) for name, each in node.items()}
        return [enlarge(each) for each in node] if isinstance(node, list) else node

    with safe_open(PACKAGED_MODEL, "np") as file:
        header = json.loads(file.metadata()[METADATA_KEY])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    for name in [name for name in header["files"] if name.endswith("config.json")]:
        files = header["files"] | {name: json.dumps(enlarge(json.loads(header["files"][name])))}
        model = tmp_path / f"{name.split('/')[0]}.safetensors"
        safetensors.numpy.save_file(tensors, model, {METADATA_KEY: json.dumps(header | {"files": files})})
        before = getrusage(RUSAGE_SELF).ru_maxrss
        with pytest.raises(InputError) as caught:
            Animator.load(model)
        assert "\n" not in str(caught.value)
        assert getrusage(RUSAGE_SELF).ru_maxrss - before < 300_000  # KiB


@pytest.mark.parametrize("name", ["/elsewhere/x", "../x", "a/b", ".hidden", "", "a\nb", "a\\b"])
@pytest.mark.parametrize("column", ["id", "sound", "speaker"])
def test_names_of_a_corpus_cannot_be_paths(tmp_path: Path, column: str, name: str) -> None:
    good = Clip("c-1", "s-1", 0, "anna", "train", 1.0, 25.0, "neutral", 0, "en", "", "", "", "")
    path = tmp_path / "clips.parquet"
    write_index(path, [good])
    assert read_index(path) == [good]
    write_index(path, [good, replace(good, **{column: name})])
    with pytest.raises(InputError, match=f"{column} should be letters") as caught:
        read_index(path)
    assert "\n" not in str(caught.value)
