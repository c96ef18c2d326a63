"""Restricted unpickler for arrays, sparse matrices, ordered dictionaries and chumpy values.

A pickle can execute code. This reader accepts only names on a short list and rejects all others before anything is
called. Classes of chumpy and scipy are not imported: placeholder objects receive their state, and the arrays are
extracted from it.
"""

from __future__ import annotations

import io
import math
import pickle
from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy import ndarray
from scipy import sparse

from talkingeyes.core.containers import MAX_ARRAY_BYTES
from talkingeyes.core.errors import InputError

ARRAYS = (
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
)
STORAGES = {
    "Float": "<f4",
    "Double": "<f8",
    "Half": "<f2",
    "Long": "<i8",
    "Int": "<i4",
    "Short": "<i2",
    "Byte": "u1",
    "Bool": "?",
}
PYTHON2 = {"copy_reg": "copyreg", "__builtin__": "builtins"}
CHUMPY = (("chumpy.ch", "Ch"), ("chumpy", "Ch"))
SPARSE = tuple((f"scipy.sparse{at}", f"{kind}_matrix") for kind in ("csc", "csr") for at in (f".{kind}", f"._{kind}"))


class PickledState:
    """Placeholder for an object of a class that is not imported: stores the pickled state."""

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}


class _RestrictedUnpickler(pickle.Unpickler):
    """Resolves the names in the lists above and no others."""

    def __init__(self, file: IO[bytes] | io.BytesIO) -> None:
        super().__init__(file, encoding="latin1")
        # A new class per file: a malicious pickle can set attributes on it.
        self._chumpy = type("ChumpyValue", (PickledState,), {})
        self._sparse = type("SparseMatrix", (PickledState,), {})
        self._allowed: dict[tuple[str, str], Any] = {
            **dict.fromkeys(CHUMPY, self._chumpy),
            **dict.fromkeys(SPARSE, self._sparse),
            ("copyreg", "_reconstructor"): self._reconstructed,
            ("builtins", "object"): object,
            ("builtins", "set"): set,
            ("collections", "OrderedDict"): OrderedDict,
            ("_codecs", "encode"): _encoded,
        }

    def find_class(self, module: str, name: str) -> Any:
        requested = (PYTHON2.get(module, module), name)
        if requested in ARRAYS:
            return super().find_class(requested[0].replace("numpy.core", "numpy._core"), name)
        if requested not in self._allowed:
            raise pickle.UnpicklingError(f"it names {module}.{name}, which is not on the list of allowed names")
        return self._allowed[requested]

    def _reconstructed(self, kind: type, _parent: type, _state: Any) -> PickledState:
        if kind not in (self._chumpy, self._sparse):
            raise pickle.UnpicklingError(f"it rebuilds {kind.__name__} in a way that no model file does")
        return PickledState.__new__(kind)


class _TensorUnpickler(_RestrictedUnpickler):
    """Also resolves torch tensors, as arrays."""

    def __init__(self, file: io.BytesIO, memory: Callable[[str], bytes]) -> None:
        super().__init__(file)
        self._memory, self._left = memory, MAX_ARRAY_BYTES
        self._allowed |= {
            **{("torch", f"{name}Storage"): np.dtype(kind) for name, kind in STORAGES.items()},
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            ("torch._utils", "_rebuild_parameter"): lambda data, *_: data,
        }

    def persistent_load(self, pid: Any) -> ndarray:
        """The memory of a storage: ("storage", type, key, device, size)."""
        _, kind, key, _, count = pid
        return np.frombuffer(self._memory(str(key)), kind, int(count))

    def _tensor(self, storage: ndarray, offset: int, shape: Sequence[int], strides: Sequence[int], *_: Any) -> ndarray:
        """Copy a view into a storage, after checking its bounds; a view can repeat its memory."""
        last = offset + sum((size - 1) * step for size, step in zip(shape, strides, strict=True))
        if 0 in shape:
            return np.zeros(shape, storage.dtype)
        if min(offset, *strides, 0) < 0 or last >= len(storage):
            raise pickle.UnpicklingError(f"a tensor of shape {shape} reaches out of its memory")
        self._left -= math.prod(shape) * storage.itemsize
        if self._left < 0:
            raise pickle.UnpicklingError(f"its tensors should have at most {MAX_ARRAY_BYTES:,} bytes")
        steps = tuple(step * storage.itemsize for step in strides)
        return np.array(np.lib.stride_tricks.as_strided(storage[offset:], shape, steps))


def read_pickle(path: Path, skip_bytes: int = 0) -> Any:
    """Read a pickle with allowed names only. Raises InputError for anything else."""
    try:
        with path.open("rb") as file:
            file.seek(skip_bytes)
            return _loaded(path, _RestrictedUnpickler(file))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def read_tensors(path: Path, pickled: bytes, memory: Callable[[str], bytes]) -> Any:
    """Read the pickle in a file saved by torch; `memory` returns the bytes of a tensor's storage."""
    return _loaded(path, _TensorUnpickler(io.BytesIO(pickled), memory))


def _loaded(path: Path, reader: _RestrictedUnpickler) -> Any:
    try:
        return reader.load()
    except (EOFError, pickle.UnpicklingError) as error:
        raise InputError(f"{path}: not a readable pickle of arrays ({_line(error)})") from None
    except Exception as error:  # a broken pickle can raise anything: numpy, memory, recursion
        raise InputError(f"{path}: broken or not a pickle ({type(error).__name__}: {_line(error)})") from None


def as_array(value: Any) -> ndarray:
    """The array in a result of `read_pickle`: an array, a chumpy value, or a sparse matrix (made dense)."""
    if isinstance(value, PickledState):
        state = value.state
        if "x" in state:
            return as_array(state["x"])
        if "indptr" in state:
            shape: Any = state.get("_shape", state.get("shape"))
            kind = sparse.csr_matrix if state.get("format") == "csr" else sparse.csc_matrix
            if math.prod(shape) * state["data"].itemsize > MAX_ARRAY_BYTES:
                raise InputError(f"a sparse matrix should have at most {MAX_ARRAY_BYTES:,} bytes, got shape {shape}")
            return np.asarray(kind((state["data"], state["indices"], state["indptr"]), shape=shape).toarray())
    return np.asarray(value)


def _encoded(text: str, encoding: str = "latin1") -> bytes:
    """Bytes as pickled by protocol 2."""
    if encoding not in ("latin1", "utf-8", "ascii"):
        raise pickle.UnpicklingError(f"it encodes text as {encoding!r}")
    return text.encode(encoding)


def _line(error: Exception) -> str:
    return str(error) or "it ends too early"
