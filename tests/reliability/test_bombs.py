"""Files that would exhaust memory, nest without end, or quote themselves: one line, status 2, little memory.

Bombs are small files that claim, or inflate to, more than the bounds of core/containers.py.
"""

from __future__ import annotations

import gzip
import io
import json
import multiprocessing
import os
import pickle
import re
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import toy_motions
from command_line import call
from fastapi.testclient import TestClient
from numpy.lib import format as npy

from talkingeyes.apps.service import live_stream
from talkingeyes.apps.service.animation_request import Limits
from talkingeyes.apps.service.app import ServiceResources, service_app
from talkingeyes.apps.service.worker_pool import WorkerPool
from talkingeyes.apps.study.design import load_design
from talkingeyes.core.containers import MAX_ARRAY_BYTES, MAX_COLUMNS, MAX_DIRECTORY_BYTES, MIB, parse_json
from talkingeyes.core.errors import MAX_LETTERS, InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.core.npz import save_npz
from talkingeyes.corpus.index import Clip, read_index, write_index
from talkingeyes.corpus.motion_files import read_motions
from talkingeyes.corpus.motion_loading import load_motions
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.formats import csv_text
from talkingeyes.formats.readers import gltf_document, usd
from talkingeyes.formats.readers.key_map import ArrayMapping, KeyMap, load_key_map, read_with_map
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.readers.torch_file import read_torch
from talkingeyes.head import restricted_pickle
from talkingeyes.head.model import load_head
from talkingeyes.head.observation import Observation
from talkingeyes.workflows import convert

PEAK_MIB = 64
DEEP_JSON = "[" * 100_000
OPENERS = re.compile(
    r"\bnp\.load\(|\bZipFile\(path\)|\bjson\.load\(|json\.loads\((\w+\.read|\(|line)|safe_load|\bcsv\.read_csv|\bpq\.[rP]"
)
OWN_FILES = {  # speech features, records and declarations of the pipeline, data of this package and of the package anny
    *(f"corpus/{name}.py" for name in ("fitted_clips", "packed", "poses")),
    *("evaluation/papers/posegan_metrics.py", "workflows/evaluate.py"),
    "formats/readers/tables.py",  # text within bounds
    *("head/anny_data.py", "orchestration/result_store.py", "orchestration/stage_graph.py", "tracking/journal.py"),
}
KEY_MAP = KeyMap(fps=25.0, head=ArrayMapping(key="head"))
NPZ_READERS: dict[str, Callable[[Path], Any]] = {
    "motion": Motion.load,
    "motions": load_motions,
    "fields": lambda path: list(read_motions(path)),
    "samples": Samples.load,
    "faces": FaceSamples.load,
    "observation": Observation.load,
    "head": load_head,
    "import": read_motion,
    "map": lambda path: read_with_map(path, KEY_MAP),
}


def peak_mib(action: Callable[[], Any]) -> tuple[Any, float]:
    """The result of an action, or its InputError, and the most memory that it held, arrays included."""
    tracemalloc.start()
    try:
        result = action()
    except InputError as error:
        result = error
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return result, peak / MIB


def refused(action: Callable[[], Any], message: str, most_mib: float = PEAK_MIB) -> None:
    """Assert that an action is refused in one short line, with little memory."""
    error, peak = peak_mib(action)
    assert isinstance(error, InputError), error
    assert message in str(error)
    assert "\n" not in str(error)
    assert len(str(error)) <= MAX_LETTERS
    assert peak < most_mib


def add_zeros(path: Path, name: str, mib: int) -> Path:
    """Add an array of zeros to an npz; a thousandth of its size on disk."""
    header = {"descr": "|u1", "fortran_order": False, "shape": (mib * MIB,)}
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(f"{name}.npy", "w", force_zip64=True) as member,
    ):
        npy.write_array_header_1_0(member, header)
        for _ in range(mib):
            member.write(bytes(MIB))
    return path


@pytest.fixture(scope="module")
def huge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An npz of some MB whose array `head` exceeds the bound."""
    path = tmp_path_factory.mktemp("huge") / "huge.npz"
    save_npz(path, fps=np.float64(25.0))
    add_zeros(path, "head", MAX_ARRAY_BYTES // MIB + 1)
    return path


def npy_header(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    header = io.BytesIO()
    npy.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    return header.getvalue()


def written(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_arrays_that_nobody_asked_for_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    toy_motions.motion().save(path)
    add_zeros(path, "unneeded", 2 * PEAK_MIB)
    for reader in (Motion.load, load_motions, lambda each: list(read_motions(each)), read_motion):
        result, peak = peak_mib(lambda reader=reader: reader(path))
        assert not isinstance(result, InputError)
        assert peak < PEAK_MIB


@pytest.mark.long
@pytest.mark.parametrize("reader", ["motion", "fields", "samples", "map"])
def test_a_huge_array_is_refused_before_it_is_inflated(huge: Path, reader: str) -> None:
    assert huge.stat().st_size < 16 * MIB
    refused(lambda: NPZ_READERS[reader](huge), "should have at most 1,073,741,824 bytes")


@pytest.mark.parametrize("shape", [(2**37,), (2**61, 3), (-5,), (2**70,), (2 * PEAK_MIB * MIB,)])
def test_headers_of_arrays_are_not_believed(tmp_path: Path, shape: tuple[int, ...]) -> None:
    content = npy_header(shape) + bytes(64)
    (tmp_path / "a.npy").write_bytes(content)
    refused(lambda: read_motion(tmp_path / "a.npy", 25.0), "a.npy: not a readable npy (an array claims shape")
    path = written(tmp_path / "a.npz", {"fps.npy": content, "head.npy": content})
    for reader in ("fields", "samples", "map"):
        refused(lambda reader=reader: NPZ_READERS[reader](path), "an array claims shape")


def test_a_long_header_is_not_read(tmp_path: Path) -> None:
    start = npy.magic(2, 0) + struct.pack("<I", 2**31)
    path = written(tmp_path / "a.npz", {"fps.npy": start + b" " * 32 * MIB})
    refused(lambda: NPZ_READERS["samples"](path), "not a readable samples file")


@pytest.mark.parametrize("reader", NPZ_READERS)
@pytest.mark.parametrize("damage", ["cut", "checksum", "lying", "encrypted", "method"])
def test_damaged_archives_are_one_line_errors(tmp_path: Path, reader: str, damage: str) -> None:
    names = ("schema", "fps", "head", "gaze", "jaw", "template", "landmarks")
    path, rng = tmp_path / "a.npz", np.random.default_rng(0)
    save_npz(path, **{name: rng.normal(size=4000) for name in names})
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")  # of the first array
    while damage != "cut" and entry >= 0:
        if damage == "checksum":
            content[entry + 16] ^= 1
        if damage == "lying":
            struct.pack_into("<I", content, entry + 24, 1000)  # the size that it inflates to
        if damage == "encrypted":
            content[entry + 8] |= 1
        if damage == "method":
            struct.pack_into("<H", content, entry + 10, zipfile.ZIP_LZMA)
        entry = content.find(b"PK\x01\x02", entry + 1)
    path.write_bytes(content[: len(content) // 2] if damage == "cut" else content)
    refused(lambda: NPZ_READERS[reader](path), "a.npz: ")


def test_the_directory_of_an_archive_is_bounded(tmp_path: Path) -> None:
    count = MAX_DIRECTORY_BYTES // 40
    path = written(tmp_path / "a.npz", {})
    name, entries = b"a", b""
    entry = struct.pack("<4s6H3I5H2I", b"PK\x01\x02", 20, 20, 0, 0, 0, 0, 0, 0, 0, len(name), 0, 0, 0, 0, 0, 0) + name
    entries = entry * count
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, count & 0xFFFF, count & 0xFFFF, len(entries), 0, 0)
    path.write_bytes(entries + end)
    refused(lambda: Motion.load(path), "the directory of a zip should have at most", 16)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a0: &a0 [x, x, x, x, x, x, x, x, x]\n", "nodes, with aliases expanded"),
        ("a: &a [*a]\n", "nodes, with aliases expanded"),
        ("[" * 200, "should be nested at most 64 deep"),
        ("\n".join(" " * k + "a:" for k in range(1000)), "should be nested at most 64 deep"),
        ("a: " + "9" * 5000, "not a readable"),
        ("a: 2001-99-99", "not a readable"),
        ("!!timestamp x", "not a readable"),
        ("a: " + "x" * 2 * MIB, "should have at most 1,048,576 bytes"),
    ],
)
def test_yaml_is_bounded(tmp_path: Path, text: str, message: str) -> None:
    if text.startswith("a0"):
        text += "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 8))
    path = tmp_path / "a.yaml"
    path.write_text(text)
    for reader in (lambda: load_design(str(path)), lambda: load_key_map(path)):
        refused(reader, message)


def test_yaml_may_use_an_anchor(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("fps: 25\nhead: &own {key: pose, columns: [0, 3]}\njaw: {<<: *own, columns: [3, 6]}\n")
    assert load_key_map(path).jaw == ArrayMapping(key="pose", columns=(3, 6))


@pytest.mark.parametrize("text", [DEEP_JSON, "[" * 500 + "]" * 500, '{"a":' * 500 + "1" + "}" * 500])
def test_deep_json_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    for reader in (Events.load, read_motion):
        refused(lambda reader=reader: reader(path), "should be nested at most 64 deep")


def test_integers_that_no_array_holds_are_refused(tmp_path: Path) -> None:
    assert parse_json(f"[{2**64 - 1}, {-(2**63)}]") == [2**64 - 1, -(2**63)]
    for number in (10**400, 2**64, -(10**30)):
        (tmp_path / "a.json").write_text(json.dumps({"schema": number}))
        for reader in (Events.load, read_motion):
            refused(lambda reader=reader: reader(tmp_path / "a.json"), "integers should have 64 bits, got")


def test_deep_json_of_a_client_is_no_request() -> None:
    with pytest.raises(live_stream.StreamRefusedError, match="should be a request"):
        live_stream._stream_request(live_stream._content({"text": DEEP_JSON}))


def test_messages_are_cut_and_cannot_be_seen_on_a_terminal() -> None:
    error = InputError(f"{'k' * 5000}: got {'v' * 5000}\n\x1b[31m; should be short")
    assert len(str(error)) == MAX_LETTERS
    assert str(error).endswith("\ufffd[31m; should be short")
    assert str(error).partition(": ")[2].startswith("got vvv")
    assert str(InputError(str(error))) == str(error)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(InputError("a.npz: should be\nshort, got 1")) == "a.npz: should be short, got 1"


def test_messages_of_the_service_are_cut(tmp_path: Path) -> None:
    workers = WorkerPool("none:none", [], 1, 0, tmp_path)
    resources = ServiceResources(workers, workers, b"", [], [], {})
    limits = Limits(1, 60.0, 1, 60.0, MIB, 60.0, 60.0, 1)
    client = TestClient(service_app(resources, limits, tmp_path, "127.0.0.1"), base_url="http://127.0.0.1")
    for query in (f"seed={'x' * 20_000}", f"{'x' * 20_000}=1"):
        reply = client.post(f"/performances?{query}", content=b"", headers={"content-type": "audio/wav"})
        assert reply.status_code == 422
        assert 20 < len(reply.json()["error"]) <= MAX_LETTERS


def test_tables_are_bounded_after_inflating(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_text, "MAX_TABLE_BYTES", 16 * MIB)
    path = tmp_path / "a.csv.gz"
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(b"a,b\n" + b"0,0\n" * (2 * PEAK_MIB * MIB // 4))
    refused(lambda: read_motion(path), "should have at most 16,777,216 bytes")
    (tmp_path / "a.csv").write_text("a," * MAX_COLUMNS + "a\n" + "1," * MAX_COLUMNS + "1\n")
    refused(lambda: read_motion(tmp_path / "a.csv"), "should have at most 10,000 columns, got 10,001")


def test_repeated_texts_of_an_index_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "clips.parquet"
    write_index(path, [Clip("c-1", "s-1", 0, "anna", "train", 1.0, 25.0, "neutral", 0, "en", "", "", "", "")])
    row = pq.read_table(path).to_pylist()[0]
    table = pa.Table.from_pylist([row] * 2000)
    text = pa.DictionaryArray.from_arrays(pa.array([0] * len(table), pa.int32()), ["x" * MIB])
    pq.write_table(table.set_column(table.column_names.index("text"), "text", text), path, compression="zstd")
    assert path.stat().st_size < MIB
    before = pa.total_allocated_bytes()
    refused(lambda: read_index(path), "not a readable corpus index (should have at most 536,870,912 bytes")
    assert pa.total_allocated_bytes() - before < PEAK_MIB * MIB
    pq.write_table(table, path)
    assert len(read_index(path)) == len(table)


def glb(content: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(binary)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return b"glTF" + struct.pack("<II", 2, total) + chunks


def test_animations_of_scenes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf_document, "MAX_ARRAY_BYTES", 16 * MIB)
    count = 40_000
    channels = [{"sampler": 0, "target": {"node": k, "path": "rotation"}} for k in range(500)]
    scene = {
        "nodes": [{"name": "head"}],
        "animations": [{"channels": channels, "samplers": [{"input": 0, "output": 0}]}],
        "accessors": [{"componentType": 5126, "type": "SCALAR", "count": count, "bufferView": 0}],
        "bufferViews": [{}],
        "buffers": [{"byteLength": 4 * count}],
    }
    (tmp_path / "a.glb").write_bytes(glb(scene, bytes(4 * count)))
    refused(lambda: read_motion(tmp_path / "a.glb"), "animation should have at most")

    good = tmp_path / "b.glb"
    convert.write_motion(toy_motions.motion().cut(0, 12), None, "glb", good)
    content = bytearray(good.read_bytes())
    length = struct.unpack_from("<I", content, 12)[0]
    scene = json.loads(content[20 : 20 + length])
    sampler = scene["animations"][0]["samplers"][scene["animations"][0]["channels"][0]["sampler"]]
    accessor = scene["accessors"][sampler["input"]]
    at = scene["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
    struct.pack_into("<f", content, 28 + length + at + 4 * (accessor["count"] - 1), 1e7)
    good.write_bytes(content)
    refused(lambda: read_motion(good, 100.0), "should have at most 1,000,000 frames")


def ends(path: Path) -> None:
    os._exit(1)


def test_a_stage_cannot_end_or_fill_the_process_that_reads_it(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    refused(lambda: usd._apart(tmp_path / "a.usdc", ends), "a.usdc: not a readable USD stage")
    with pytest.raises(MemoryError):
        usd._apart(tmp_path / "a.usdc", lambda path: len(bytearray(usd.MAX_ADDRESSES)))
    (tmp_path / "b.usda").write_text('#usda 1.0\n(\n    customLayerData = { string forward_axis = "visual" }\n)\n')
    assert usd.read_layer_data(tmp_path / "b.usda") == {"forward_axis": "visual"}


def reads(path: Path) -> None:
    assert usd.read_layer_data(path) == {}


def test_a_process_that_reads_a_stage_ends(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    reader = multiprocessing.get_context("fork").Process(target=reads, args=(tmp_path / "a.usda",))
    reader.start()
    reader.join(120)
    assert reader.exitcode == 0


def test_views_of_a_torch_file_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restricted_pickle, "MAX_ARRAY_BYTES", 16 * MIB)
    torch = pytest.importorskip("torch")
    views = [torch.zeros(1).expand(MIB) for _ in range(40)]  # 4 MiB each
    torch.save(views, tmp_path / "a.pt")
    assert (tmp_path / "a.pt").stat().st_size < MIB
    refused(lambda: read_torch(tmp_path / "a.pt"), "tensors should have at most")


def test_other_modules_open_only_files_of_the_pipeline(repository: Path) -> None:
    package = repository / "src" / "talkingeyes"
    found = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if OPENERS.search(path.read_text()) and path != package / "core" / "containers.py"
    }
    assert found == OWN_FILES


def command(capfd: pytest.CaptureFixture[str], words: list[str]) -> str:
    """Run a command that is refused; returns its line."""
    status = call(*words)
    said = capfd.readouterr()
    assert status == 2, said
    assert said.out == ""
    lines = [line for line in said.err.splitlines() if "it/s]" not in line and line.strip()]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["render", "huge.npz", "-o", "a.mp4"], "huge.npz: not a readable motion npz (should have at most"),
        (["view", "huge.npz"], "huge.npz: not a readable"),
        (["import", "claims.npy", "-o", "out"], "an array claims shape"),
        (["import", "cut.npz", "-o", "out"], "cut.npz: not a readable"),
        (["import", "good.npz", "--map", "aliases.yaml", "-o", "out"], "aliases expanded"),
        (["study", "make", "aliases.yaml", "-o", "out"], "aliases expanded"),
        (["study", "make", "deep.yaml", "-o", "out"], "nested at most 64 deep"),
        (["import", "deep.json", "-o", "out"], "nested at most 64 deep"),
        (["render", "good.npz", "-o", "a.mp4", "--keys", "deep.json"], "nested at most 64 deep"),
        (
            ["render", "good.npz", "-o", "a.mp4", "--keys", "long.json"],
            "schema should be talkingeyes.events/2, got xxx",
        ),
        (["study", "make", "long.yaml", "-o", "out"], "title"),
        (["import", "good.npz", "--map", "long.yaml", "-o", "out"], "got 'xxx"),
    ],
)
def test_commands_refuse_bombs_in_one_line(
    tmp_path: Path,
    huge: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "huge.npz").symlink_to(huge)
    toy_motions.motion(seconds=1.0).save(tmp_path / "good.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:2000])
    (tmp_path / "claims.npy").write_bytes(npy_header((2**37, 106)) + bytes(64))
    aliases = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 7)]
    (tmp_path / "aliases.yaml").write_text("a0: &a0 [x, x, x]\n" + "\n".join(aliases))
    (tmp_path / "deep.yaml").write_text("[" * 900)
    (tmp_path / "long.yaml").write_text(f"title: [{'x' * 90_000}]\nfps: {'x' * 900}\n")
    (tmp_path / "deep.json").write_text(DEEP_JSON)
    (tmp_path / "long.json").write_text(json.dumps({"schema": "x" * 4 * MIB}))
    line, peak = peak_mib(lambda: command(capfd, words))
    assert message in line
    assert len(line) <= len("error: ") + MAX_LETTERS
    assert peak < 4 * PEAK_MIB
    assert not (tmp_path / "out").exists()
