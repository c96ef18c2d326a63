"""Reading a pickle that names only harmless things: arrays, sparse matrices, ordered dictionaries, chumpy's values.

A pickle is a program. This reader looks every name that it asks for up in a short list and refuses all others before
anything is called. Classes of chumpy and scipy are never imported: stand-ins take their state, and the arrays are
taken out of it.
"""

from __future__ import annotations

import io
import pickle
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy import ndarray
from scipy import sparse

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
    """Stands in for an object of a class that is not imported: keeps the state that the pickle gives it."""

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}


class _RestrictedUnpickler(pickle.Unpickler):
    """Resolves the names of the lists above, and no other."""

    def __init__(self, file: IO[bytes] | io.BytesIO) -> None:
        super().__init__(file, encoding="latin1")
        # A class of its own for every file: a hostile pickle can set attributes on what it is given.
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
            raise pickle.UnpicklingError(f"it names {module}.{name}, which is not on the list of harmless names")
        return self._allowed[requested]

    def _reconstructed(self, kind: type, _parent: type, _state: Any) -> PickledState:
        if kind not in (self._chumpy, self._sparse):
            raise pickle.UnpicklingError(f"it rebuilds {kind.__name__} in a way that no model file does")
        return PickledState.__new__(kind)


class _TensorUnpickler(_RestrictedUnpickler):
    """Knows torch's tensors too, and makes arrays of them."""

    def __init__(self, file: io.BytesIO, memory: Callable[[str], bytes]) -> None:
        super().__init__(file)
        self._memory = memory
        self._allowed |= {
            **{("torch", f"{name}Storage"): np.dtype(kind) for name, kind in STORAGES.items()},
            ("torch._utils", "_rebuild_tensor_v2"): _tensor,
            ("torch._utils", "_rebuild_parameter"): lambda data, *_: data,
        }

    def persistent_load(self, pid: Any) -> ndarray:
        """The memory of a storage: ("storage", its kind, its key, where it was, how many)."""
        _, kind, key, _, count = pid
        return np.frombuffer(self._memory(str(key)), kind, int(count))


def _tensor(storage: ndarray, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *_: Any) -> ndarray:
    """A copy of a view into a storage, which checks that the view lies in it."""
    last = offset + sum((size - 1) * step for size, step in zip(shape, strides, strict=True))
    if 0 in shape:
        return np.zeros(shape, storage.dtype)
    if min(offset, *strides, 0) < 0 or last >= len(storage):
        raise pickle.UnpicklingError(f"a tensor of shape {shape} reaches out of its memory")
    steps = tuple(step * storage.itemsize for step in strides)
    return np.array(np.lib.stride_tricks.as_strided(storage[offset:], shape, steps))


def read_pickle(path: Path, skip_bytes: int = 0) -> Any:
    """The content of a pickle, all names in it harmless. Raises InputError in one line for anything else."""
    try:
        with path.open("rb") as file:
            file.seek(skip_bytes)
            return _loaded(path, _RestrictedUnpickler(file))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def read_tensors(path: Path, pickled: bytes, memory: Callable[[str], bytes]) -> Any:
    """The same for the pickle in a file that torch saved; `memory` gives the bytes of a tensor's storage."""
    return _loaded(path, _TensorUnpickler(io.BytesIO(pickled), memory))


def _loaded(path: Path, reader: _RestrictedUnpickler) -> Any:
    try:
        return reader.load()
    except (EOFError, pickle.UnpicklingError) as error:
        raise InputError(f"{path}: not a readable pickle of arrays ({_line(error)})") from None
    except Exception as error:  # what a broken pickle raises is not limited: numpy, memory, recursion
        raise InputError(f"{path}: broken or not a pickle ({type(error).__name__}: {_line(error)})") from None


def as_array(value: Any) -> ndarray:
    """The array in what `read_pickle` gave: an array itself, a chumpy value, a sparse matrix (made dense)."""
    if isinstance(value, PickledState):
        state = value.state
        if "x" in state:
            return as_array(state["x"])
        if "indptr" in state:
            shape = state.get("_shape", state.get("shape"))
            kind = sparse.csr_matrix if state.get("format") == "csr" else sparse.csc_matrix
            return np.asarray(kind((state["data"], state["indices"], state["indptr"]), shape=shape).toarray())
    return np.asarray(value)


def _encoded(text: str, encoding: str = "latin1") -> bytes:
    """How protocol 2 writes bytes."""
    if encoding not in ("latin1", "utf-8", "ascii"):
        raise pickle.UnpicklingError(f"it encodes text as {encoding!r}")
    return text.encode(encoding)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or "it ends too early"
