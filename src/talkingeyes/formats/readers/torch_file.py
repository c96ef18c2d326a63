"""Files saved by torch (.pt, .pth, metrical-tracker's .frame): arrays, read without executing code and without torch.

Such a file is a zip with a pickle, `*/data.pkl`, and the memory of each tensor, `*/data/<key>`. The pickle is read by
the restricted reader (head/restricted_pickle.py), which accepts only arrays and torch tensors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from talkingeyes.core.containers import MAX_ARRAY_BYTES, open_zip, read_member, reading
from talkingeyes.core.errors import InputError
from talkingeyes.head.restricted_pickle import read_tensors


def read_torch(path: Path) -> Any:
    """The content, with tensors as arrays. Raises InputError (one line) for any other file."""
    with reading(path, "file saved by torch"), open_zip(path) as archive:
        names = archive.namelist()
        pickled = [name for name in names if name.endswith("data.pkl")]
        if len(pickled) != 1:
            raise InputError(f"{path}: should be a file saved by torch, got a zip of {', '.join(names[:3])}")
        stem, left = pickled[0].removesuffix("data.pkl"), MAX_ARRAY_BYTES

        def read(name: str) -> bytes:  # a pickle can name one storage many times
            nonlocal left
            content = read_member(archive, archive.getinfo(name), left)
            left -= len(content)
            return content

        return read_tensors(path, read(pickled[0]), lambda key: read(f"{stem}data/{key}"))
