"""Damage to files: bytes of any file, and the values inside those whose form is known.

A mutation takes the bytes of a good file and a random generator, and returns other bytes. Those that know a form leave
the file well formed and change what it says: types, shapes, sizes, names, numbers that are none.
"""

from __future__ import annotations

import copy
import io
import json
import pickle
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.lib import format as npy
from numpy.random import Generator

Mutation = Callable[[bytes, Generator], bytes]

# Values that a reader of JSON, YAML or tables may meet where it expects another.
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, -(2**63), 2**64, 10**400, 1e308, -1e-320, 0.5, float("nan"), float("inf")),
    *("", "a", "nan", "1e5", "x" * 5000, "../../a", "\u0000", "\u202e\U0001f600", "\ud800", "a\nb\tc", "[1]"),
    *([], {}, [[]], [None], [1, "a"], [[1.0, 2.0], [3.0]], {"a": {}}, [0] * 1000),
)
SIZES = (0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**62, 2**64 - 1)
WORDS = ("nan", "inf", "-1", "1e400", "0", "999999999999999999999", "word", "", '"', "\u00e9", "1,5", "{", "\x00", "-")
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
MAX_NODES = 3000  # of a JSON document among which one is chosen


def _pick(rng: Generator, among: Any) -> Any:
    return copy.deepcopy(among[int(rng.integers(len(among)))])


def _span(content: bytes, rng: Generator) -> tuple[int, int]:
    start = int(rng.integers(len(content) + 1))
    return start, min(len(content), start + int(rng.integers(1, 200)))


def truncate(content: bytes, rng: Generator) -> bytes:
    """Cut the end off; one time in ten all of it."""
    return content[: 0 if rng.random() < 0.1 else int(rng.integers(len(content) + 1))]


def change_bytes(content: bytes, rng: Generator) -> bytes:
    """Flip bits or set bytes, often near the start, where headers are."""
    changed = bytearray(content)
    reach = len(changed) if rng.random() < 0.5 else min(len(changed), 300)
    for _ in range(int(rng.integers(1, 20)) if reach else 0):
        at = int(rng.integers(reach))
        changed[at] = changed[at] ^ (1 << int(rng.integers(8))) if rng.random() < 0.5 else int(rng.integers(256))
    return bytes(changed)


def write_size(content: bytes, rng: Generator) -> bytes:
    """Overwrite some bytes by an integer that could be taken for a huge size or count."""
    width, order = _pick(rng, (2, 4, 8)), _pick(rng, ("little", "big"))
    at = int(rng.integers(max(1, min(len(content), _pick(rng, (64, 1024, len(content) + 1))) - width)))
    return content[:at] + (_pick(rng, SIZES) % 2 ** (8 * width)).to_bytes(width, order) + content[at + width :]


def move_span(content: bytes, rng: Generator) -> bytes:
    """Remove, double or insert a part."""
    start, end = _span(content, rng)
    middle = _pick(rng, (b"", 2 * content[start:end], rng.bytes(int(rng.integers(1, 100)))))
    return content[:start] + middle + content[end:]


BYTES: tuple[Mutation, ...] = (truncate, change_bytes, write_size, move_span)


def _nodes(value: Any) -> list[tuple[Any, Any]]:
    """Containers of a JSON value with the keys of their children, level by level."""
    found: list[tuple[Any, Any]] = []
    level = [value]
    while level and len(found) < MAX_NODES:
        following = []
        for node in level:
            children = node.items() if isinstance(node, dict) else enumerate(node)
            for key, child in children:
                found.append((node, key))
                if isinstance(child, dict | list):
                    following.append(child)
        level = following
    return found


def change_value(value: Any, rng: Generator) -> Any:
    """A JSON value with one of its parts of another type, removed, renamed, doubled or nested."""
    nodes = _nodes(value) if isinstance(value, dict | list) else []
    if not nodes or rng.random() < 0.03:
        return _pick(rng, VALUES)
    place, key = nodes[int(rng.integers(len(nodes) if rng.random() < 0.5 else min(len(nodes), 40)))]
    kind = rng.integers(6)
    if kind == 0:
        del place[key]
    elif kind == 1 and isinstance(place, dict):
        place[_pick(rng, (f"{key}x", "", "a", str(key).upper()))] = place.pop(key)
    elif kind == 2 and isinstance(place, list):
        place.insert(key, place[key])
    elif kind == 3:
        for _ in range(_pick(rng, (1, 50, 400))):
            place[key] = [place[key]]
    else:
        place[key] = _pick(rng, VALUES)
    return value


def _several(value: Any, rng: Generator) -> Any:
    for _ in range(int(rng.integers(1, 4))):
        value = change_value(value, rng)
    return value


def change_json(content: bytes, rng: Generator) -> bytes:
    """Change values of a JSON document, or of one line of JSON lines."""
    text = content.decode("utf-8-sig")
    try:
        return json.dumps(_several(json.loads(text), rng)).encode()
    except json.JSONDecodeError:
        lines = text.splitlines()
        at = int(rng.integers(len(lines)))
        lines[at] = json.dumps(_several(json.loads(lines[at]), rng))
        return "\n".join(lines).encode()


def change_text(content: bytes, rng: Generator) -> bytes:
    """Change numbers, words, lines or the encoding of a text."""
    for _ in range(int(rng.integers(1, 4))):
        kind = rng.integers(5)
        if kind == 0 and (numbers := list(NUMBER.finditer(content))):
            found = _pick(rng, numbers if rng.random() < 0.7 else numbers[:20])
            content = content[: found.start()] + _pick(rng, WORDS).encode() + content[found.end() :]
        elif kind == 1 and (words := list(re.finditer(rb"\w+", content[:20_000]))):
            found = _pick(rng, words)
            content = content[: found.start()] + _pick(rng, WORDS).encode() + content[found.end() :]
        elif kind == 2:
            lines = content.splitlines(keepends=True)
            at = int(rng.integers(len(lines) + 1)) if rng.random() < 0.5 else int(rng.integers(min(len(lines), 5) + 1))
            lines[at : at + int(rng.integers(1, 5))] = _pick(rng, ([], lines[at : at + 1] * 2, [b"\n"], [b",\n"]))
            content = b"".join(lines)
        elif kind == 3:
            mark = _pick(rng, (b",", b":", b" ", b"{", b'"', b"."))
            content = content.replace(mark, _pick(rng, (b";", b"\t", b"", 2 * mark)), _pick(rng, (1, 50, -1)))
        elif rng.random() < 0.2:
            content = content.decode("utf-8", "replace").encode(_pick(rng, ("utf-16", "utf-32")), "replace")
    return content


def _npy(shape: tuple[int, ...], descr: str, data: bytes = b"") -> bytes:
    header = io.BytesIO()
    npy.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    return header.getvalue() + data


class _Canary:
    """Unpickles by opening a file to write: reading data should never do so."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("canary"),)


def _saved(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def change_array(content: bytes, rng: Generator) -> bytes:
    """An array (.npy) of another type or shape, with values that are no numbers, or larger than its data."""
    try:
        array = np.load(io.BytesIO(content))
    except (ValueError, EOFError):  # no array
        return truncate(content, rng)
    kind = rng.integers(12)
    if kind < 3:
        kinds = ("U8", "S3", "c16", "i1", "u8", "f2", "bool", "f8")
        array = array.astype(_pick(rng, kinds if array.dtype.kind in "fiub" else ("U1", "S2", "U400", "O")))
    elif kind == 3:
        array = array.astype(object)
    elif kind == 4:
        array = np.array([_Canary()], object)
    elif kind < 7:
        rows = np.atleast_1d(array)
        array = _pick(
            rng,
            (
                rows[:0],
                rows[:1],
                array[None],
                array.T,
                rows.ravel(),
                array[..., None],
                rows[..., :1],
                rows[:1].reshape(-1)[0],
            ),
        )
    elif kind < 10 and array.dtype.kind == "f":
        array = array.copy()
        flat = array.reshape(-1)
        places = rng.integers(max(1, flat.size), size=_pick(rng, (1, 10, max(1, flat.size))))
        if flat.size:
            flat[places] = _pick(rng, (np.nan, np.inf, -np.inf, 1e30, -1e30, 1e300 if flat.itemsize > 4 else 1e38, 0))
    else:
        shape = tuple(_pick(rng, (*array.shape, *SIZES)) for _ in range(_pick(rng, (0, 1, 2, 3, 40))))
        return _npy(shape, _pick(rng, ("<f8", "|u1", "<U9", "|O")), content[128:])
    return _saved(array)


def change_zip(content: bytes, rng: Generator) -> bytes:
    """An archive (npz) with members removed, renamed, added, changed, or that inflate to a GiB."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    changed = io.BytesIO()
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(members))) if members else 0
        kind = rng.integers(8) if members else 5
        if kind == 0:
            del members[at]
        elif kind == 1:
            members[at] = (_pick(rng, ("a.npy", "../a.npy", "a", members[0][0], members[at][0] * 2)), members[at][1])
        elif kind == 5:
            members.append((_pick(rng, ("expression.npy", "a", "head.npy")), _pick(rng, (b"", rng.bytes(50)))))
        elif kind == 6 and rng.random() < 0.2:
            members[at] = (members[at][0], _npy((2**30,), "|u1") + bytes(2**26))
        else:
            members[at] = (members[at][0], change_array(members[at][1], rng))
    with zipfile.ZipFile(changed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in dict(members).items():
            archive.writestr(name, data)
    return changed.getvalue()


def change_glb(content: bytes, rng: Generator) -> bytes:
    """A GLB whose JSON says something else, or whose numbers are others."""
    (length,) = struct.unpack_from("<I", content, 12)
    document, rest = json.loads(content[20 : 20 + length]), bytearray(content[20 + length :])
    if rng.random() < 0.3 and len(rest) > 12:
        for _ in range(int(rng.integers(1, 50))):
            at = 8 + 4 * int(rng.integers((len(rest) - 8) // 4))
            rest[at : at + 4] = struct.pack("<f", _pick(rng, (np.nan, np.inf, -1.0, 1e30, 0.0, 7.0)))
    else:
        document = _several(document, rng)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 20 + len(text) + len(rest)
    return struct.pack("<4sIIII", content[:4], 2, total, len(text), 0x4E4F534A) + text + bytes(rest)


def change_safetensors(content: bytes, rng: Generator) -> bytes:
    """A safetensors file whose header, or whose JSON inside the metadata, says something else."""
    (length,) = struct.unpack_from("<Q", content)
    header = json.loads(content[8 : 8 + length])
    metadata = header.get("__metadata__", {})
    kind = rng.integers(3)
    if kind == 0 or not metadata:
        header = _several(header, rng)
    else:
        key = _pick(rng, sorted(metadata))
        inner = json.loads(metadata[key])
        if kind == 2 and isinstance(inner, dict) and inner.get("files"):
            name = _pick(rng, sorted(inner["files"]))
            inner["files"][name] = change_json(inner["files"][name].encode(), rng).decode()
        else:
            inner = _several(inner, rng)
        metadata[key] = json.dumps(inner)
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + content[8 + length :]


def change_pickle(content: bytes, rng: Generator) -> bytes:
    """A pickle that calls a function, or that holds what it should not."""
    made = (_Canary(), {"a": _Canary()}, np.array([_Canary()], object), *VALUES)[int(rng.integers(3 + len(VALUES)))]
    return pickle.dumps(made, protocol=int(rng.integers(6)))


def change_parquet(content: bytes, rng: Generator) -> bytes:
    """A table without a column, with one of another type, with nulls, twice the rows, or none."""
    table = pq.read_table(io.BytesIO(content))
    column = int(rng.integers(table.num_columns))
    name, kind = table.column_names[column], rng.integers(6)
    if kind == 0:
        table = table.drop([name])
    elif kind == 1:
        table = table.slice(0, 0)
    elif kind == 2:
        table = pa.concat_tables([table, table])
    elif kind == 3:
        table = table.rename_columns([*table.column_names[:column], "a", *table.column_names[column + 1 :]])
    else:
        values = [_pick(rng, (None, 1.5, float("nan"), -1, 2**40)) for _ in range(table.num_rows)]
        words = [_pick(rng, ("", "a/b", "..", "x" * 999)) for _ in range(table.num_rows)]
        array = pa.array(words) if kind == 4 else pa.array(values, pa.float64())
        table = table.set_column(column, name, array)
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


FORMS: dict[str, tuple[Mutation, ...]] = {
    "binary": (),
    "json": (change_json, change_text),
    "text": (change_text,),
    "npz": (change_zip,),
    "npy": (change_array,),
    "glb": (change_glb,),
    "safetensors": (change_safetensors,),
    "pickle": (change_pickle,),
    "torch": (change_zip, change_pickle),
    "parquet": (change_parquet,),
}


def mutate(content: bytes, form: str, rng: Generator) -> bytes:
    """One random mutation of a file; two of three times one that knows its form, where there is one."""
    known = FORMS[form]
    return _pick(rng, known if known and rng.random() < 0.67 else BYTES)(content, rng)
