"""Opens the containers that users and strangers supply: npz, npy, zip, JSON, YAML, CSV, parquet and plain text.

Sizes are checked before anything of that size is read: that of a file, that which an archive declares for a member, and
that which the header of an array claims. Only the members that are asked for are read, and no pickles. A damaged or
greedy file is an InputError. The bounds are explained in docs/security.md.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy import ndarray
from numpy.lib import format as npy

from talkingeyes.core.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

MIB = 2**20
MAX_ARRAY_BYTES = 1024 * MIB  # of all arrays that are read of a file
MAX_TABLE_BYTES = 512 * MIB  # of a CSV or parquet, inflated
MAX_TEXT_BYTES = 64 * MIB  # of JSON and other text; parsed JSON needs up to 25 times as much
MAX_YAML_BYTES = MIB
MAX_ROWS, MAX_COLUMNS = 1_000_000, 10_000  # of a parquet, of a CSV
MAX_DEPTH = 64  # of JSON and YAML
MAX_DIGITS = 20  # of an integer in JSON, with its sign
MAX_YAML_NODES = 100_000  # with aliases expanded
MAX_DIRECTORY_BYTES = 4 * MIB  # of a zip: some 50,000 members
MAX_HEADER_BYTES = 10_000  # of an npy
CHUNK_BYTES = 2**18
HEADER_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Errors inside the block become one InputError that names the file and what it should be; numpy does not warn."""
    try:
        with np.errstate(all="ignore"):
            yield
    # A package that only an extra installs is no fault of the file.
    except (InputError, ModuleNotFoundError):
        raise
    except OSError as error:
        raise InputError(f"{path}: not a readable {what} ({error.strerror or error})") from None
    # A damaged file can raise anything: zipfile, zlib, the parsers of headers and texts, memory, recursion.
    except Exception as error:
        raise InputError(f"{path}: not a readable {what} ({str(error) or type(error).__name__})") from None


def read_bytes(path: Path, limit: int = MAX_ARRAY_BYTES) -> bytes:
    """The content of a file. Raises OSError, or ValueError if it is larger than `limit`."""
    with path.open("rb") as file:
        return _bounded(file, limit)


def read_text(path: Path, what: str, errors: str = "strict") -> str:
    """The UTF-8 text of a file, without a byte order mark. Raises InputError (one line)."""
    with reading(path, what):
        return read_bytes(path, MAX_TEXT_BYTES).decode("utf-8-sig", errors)


def read_json(path: Path, what: str) -> Any:
    """The value in a JSON file. Raises InputError (one line)."""
    with reading(path, what):
        return parse_json(read_bytes(path, MAX_TEXT_BYTES))


def parse_json(content: str | bytes) -> Any:
    """The value of a JSON text. Raises ValueError, also if it is too large, nested too deeply or has huge integers."""
    _check_size(len(content), MAX_TEXT_BYTES)
    try:
        value = json.loads(content, parse_int=_integer)
    except RecursionError:
        raise ValueError(f"should be nested at most {MAX_DEPTH} deep") from None
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        level = [
            child
            for node in level
            if isinstance(node, dict | list)
            for child in (node.values() if isinstance(node, dict) else node)
            if isinstance(child, dict | list)
        ]
        if not level:
            return value
    raise ValueError(f"should be nested at most {MAX_DEPTH} deep")


def _integer(digits: str) -> int:
    """An integer of JSON: times in nanoseconds and hashes have 64 bits, and of more no array could be made."""
    number = int(digits) if len(digits) <= MAX_DIGITS else 2**64
    if not -(2**63) <= number < 2**64:
        raise ValueError(f"integers should have 64 bits, got {len(digits)} digits")
    return number


def read_yaml(path: Path, what: str) -> Any:
    """The value in a YAML file of plain types. Raises InputError (one line)."""
    import yaml

    sizes: dict[str, int] = {}  # of anchored nodes

    class BoundedLoader(yaml.SafeLoader):
        """Bounds depth, and nodes with aliases expanded: a message, or a validator, walks through all of them."""

        depth, count = 0, 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            alias, anchor, before = self.check_event(yaml.AliasEvent), self.peek_event().anchor, self.count
            self.depth += 1
            if self.depth > MAX_DEPTH:
                raise ValueError(f"should be nested at most {MAX_DEPTH} deep")
            node = super().compose_node(parent, index)
            self.depth -= 1
            # Of an alias inside its own anchor, the size is unknown and has no end.
            self.count += sizes.get(anchor, MAX_YAML_NODES) if alias else 1
            if self.count > MAX_YAML_NODES:
                raise ValueError(f"should have at most {MAX_YAML_NODES:,} nodes, with aliases expanded")
            if anchor is not None and not alias:
                sizes[anchor] = self.count - before
            return node

    with reading(path, what):
        return yaml.load(read_bytes(path, MAX_YAML_BYTES), BoundedLoader)


def read_npz(path: Path, names: Collection[str], what: str) -> dict[str, ndarray]:
    """Those of the named arrays that an npz has; others are not read. Raises InputError (one line)."""
    with reading(path, what), open_zip(path) as archive:
        members = [info for info in archive.infolist() if info.filename.removesuffix(".npy") in names]
        _check_size(sum(info.file_size for info in members), MAX_ARRAY_BYTES)
        found = {}
        for info in members:
            with open_member(archive, info) as stream:
                found[info.filename.removesuffix(".npy")] = _read_array(stream, info.file_size)
        return found


def npz_names(path: Path, what: str) -> tuple[str, ...]:
    """The names of the arrays in an npz. Raises InputError (one line)."""
    with reading(path, what), open_zip(path) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())


def read_npy(path: Path, what: str) -> ndarray:
    """The array in an npy. Raises InputError (one line)."""
    with reading(path, what), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        _check_size(size, MAX_ARRAY_BYTES)
        return _read_array(file, size)


@contextmanager
def open_zip(path: Path) -> Iterator[zipfile.ZipFile]:
    """An archive, for members with `open_member` or `read_member`. Raises ValueError if its directory is large."""
    with _PiecewiseFile(io.FileIO(path)) as file, zipfile.ZipFile(file) as archive:
        yield archive


def open_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> zipfile.ZipExtFile:
    """A member as a stream, which ends at its declared size. Raises ValueError for rare ways of compression."""
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{info.filename} should be stored or deflated, got method {info.compress_type}")
    return cast(zipfile.ZipExtFile, archive.open(info))


def read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, limit: int) -> bytes:
    """The content of a member. Raises ValueError, before it is inflated, if it is larger than `limit`."""
    _check_size(info.file_size, limit)
    with open_member(archive, info) as stream:
        return b"".join(iter(lambda: stream.read(CHUNK_BYTES), b""))


def read_csv(path: Path) -> pa.Table:
    """A CSV table, plain or gzipped. Raises InputError (one line)."""
    from pyarrow import csv

    with reading(path, "CSV table"):
        with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
            content = _bounded(file, MAX_TABLE_BYTES)
        columns = sum(line.count(b",") + 1 for line in content[:MIB].splitlines()[:1])
        if columns > MAX_COLUMNS:
            raise ValueError(f"should have at most {MAX_COLUMNS:,} columns, got {columns:,}")
        table = csv.read_csv(io.BytesIO(content))
        table.column_names  # noqa: B018  (decoded here, or never)
        return table


def read_parquet(path: Path, columns: Sequence[str], what: str, optional: Sequence[str] = ()) -> list[dict[str, Any]]:
    """The rows of a parquet of plain values. Raises InputError (one line), also if one of `columns` is missing."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, what):
        columns = [*columns, *(name for name in optional if name in pq.read_schema(path).names)]
    with reading(path, what), pq.ParquetFile(path, read_dictionary=columns) as file:
        declared = file.metadata
        if declared.num_rows > MAX_ROWS:
            raise ValueError(f"should have at most {MAX_ROWS:,} rows, got {declared.num_rows:,}")
        _check_size(sum(declared.row_group(k).total_byte_size for k in range(declared.num_row_groups)), MAX_TABLE_BYTES)
        for name in columns:
            if name not in file.schema_arrow.names or pa.types.is_nested(file.schema_arrow.field(name).type):
                raise ValueError(f"should have a column {name} of plain values")
        table = file.read(columns)  # repeated texts are read once
        _check_size(sum(_text_bytes(chunk) for name in columns for chunk in table[name].chunks), MAX_TABLE_BYTES)
        return list(table.to_pylist())


class _PiecewiseFile(io.BufferedReader):
    """A file that is read in pieces. zipfile reads the whole directory of an archive at once, and members as asked."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > MAX_DIRECTORY_BYTES:
            raise ValueError(f"the directory of a zip should have at most {MAX_DIRECTORY_BYTES:,} bytes, got {size:,}")
        return super().read(size)


def _read_array(stream: io.BufferedIOBase, size: int) -> ndarray:
    """The array in the next `size` bytes, if its header claims no more than these."""
    content = np.empty(size, np.uint8)
    at, view = 0, content.data
    while read := stream.readinto(view[at : at + CHUNK_BYTES]):
        at += read
    header = io.BytesIO(view[: MAX_HEADER_BYTES + 12])
    read_header: Callable[..., Any] | None = HEADER_READERS.get(npy.read_magic(header))
    if at < size or read_header is None:
        raise ValueError("an array is cut off, or of an unknown version")
    shape, by_columns, dtype = read_header(header)
    count = math.prod(shape)
    if dtype.kind not in "fiubUS":
        raise ValueError(f"an array should hold numbers or text, got {dtype}")
    if min(shape, default=0) < 0 or count * dtype.itemsize > size - header.tell():
        raise ValueError(f"an array claims shape {shape} of {dtype}, got {size:,} bytes")
    return np.frombuffer(content, dtype, count, header.tell()).reshape(shape, order="F" if by_columns else "C")


def _bounded(file: Any, limit: int) -> bytes:
    content = bytearray()
    while piece := file.read(CHUNK_BYTES):
        content += piece
        _check_size(len(content), limit)
    return bytes(content)


def _check_size(size: int, limit: int) -> None:
    if size > limit:
        raise ValueError(f"should have at most {limit:,} bytes, got {size:,} or more")


def _text_bytes(chunk: Any) -> int:
    """Bytes of a column's texts with repetitions; 0 for other columns."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if not pa.types.is_dictionary(chunk.type):
        return 0
    return int(pc.sum(pc.binary_length(chunk.dictionary).take(chunk.indices)).as_py() or 0)
