"""Writes arrays to npz with identical bytes in every Python 3.11, because stages identify files by hash.

`numpy.savez_compressed` requests headers for huge files (ZIP64), which Python before 3.11.4 wrote differently.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from numpy import ndarray
from numpy.lib import format as npy


def save_npz(path: Path, /, **arrays: ndarray | np.generic) -> None:
    """Write arrays by name, compressed, for `numpy.load`. Raises ValueError for objects, which would need pickles."""
    with ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            content = BytesIO()
            npy.write_array(content, np.asanyarray(array), allow_pickle=False)
            archive.writestr(ZipInfo(f"{name}.npy"), content.getbuffer(), ZIP_DEFLATED)
