"""Files saved by torch (.pt, .pth, metrical-tracker's .frame): arrays, read without executing code and without torch.

Such a file is a zip with a pickle, `*/data.pkl`, and the memory of each tensor, `*/data/<key>`. The pickle is read by
the restricted reader (head/restricted_pickle.py), which accepts only arrays and torch tensors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import ZipFile

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import NPZ_READ_ERRORS
from talkingeyes.head.restricted_pickle import read_tensors


def read_torch(path: Path) -> Any:
    """The content, with tensors as arrays. Raises InputError (one line) for any other file."""
    try:
        with ZipFile(path) as archive:
            names = archive.namelist()
            pickled = [name for name in names if name.endswith("data.pkl")]
            if len(pickled) != 1:
                raise InputError(f"{path}: should be a file saved by torch, got a zip of {', '.join(names[:3])}")
            stem = pickled[0].removesuffix("data.pkl")
            return read_tensors(path, archive.read(pickled[0]), lambda key: archive.read(f"{stem}data/{key}"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except InputError:
        raise
    except (*NPZ_READ_ERRORS, KeyError) as error:
        raise InputError(f"{path}: not a file saved by torch ({' '.join(str(error).split())[:120]})") from None
