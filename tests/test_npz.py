"""NPZ files: readable by numpy, with bytes that do not depend on the patch release of Python."""

import zipfile

import numpy as np
import pytest

from talkingeyes.core.containers import npz_names, read_npy, read_npz
from talkingeyes.core.motion import Motion
from talkingeyes.core.npz import save_npz

ZIP64_VERSION = 45  # bytes of the headers that differ before Python 3.11.4


def test_numpy_reads_what_was_written(tmp_path):
    arrays = {"fps": np.float64(25.0), "name": np.str_("é"), "path": np.arange(6.0).reshape(2, 3), "none": np.zeros(0)}
    save_npz(tmp_path / "a.npz", **arrays)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as read:
        assert set(read.files) == set(arrays)
        for name, array in arrays.items():
            assert read[name].dtype == array.dtype
            np.testing.assert_array_equal(read[name], array)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed, save_npz])
def test_arrays_are_read_as_numpy_reads_them(tmp_path, save):
    arrays = {
        "columns": np.asfortranarray(np.arange(6.0, dtype=np.float32).reshape(2, 3)),
        "none": np.zeros((0, 3)),
        "scalar": np.float64(25.0),
        "texts": np.array(["", "é"]),
        "big_endian": np.arange(3, dtype=">i4"),
        "unneeded": np.zeros(3),
    }
    save(tmp_path / "a.npz", **arrays)
    assert set(npz_names(tmp_path / "a.npz", "npz")) == set(arrays)
    read = read_npz(tmp_path / "a.npz", {*arrays, "absent"} - {"unneeded"}, "npz")
    assert set(read) == set(arrays) - {"unneeded"}
    for name, array in read.items():
        assert array.dtype == arrays[name].dtype
        assert array.flags.writeable
        np.testing.assert_array_equal(array, arrays[name])
    np.save(tmp_path / "a.npy", arrays["columns"])
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy", "npy"), arrays["columns"])


def test_objects_are_refused(tmp_path):
    with pytest.raises(ValueError, match="allow_pickle=False"):
        save_npz(tmp_path / "a.npz", a=np.array([{}], object))


def test_motion_files_are_the_same_bytes_by_every_python(tmp_path):
    motion = Motion.of(25.0, np.zeros((50, 3)), np.zeros((50, 2, 3)))
    motion.save(tmp_path / "a.npz")
    motion.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        assert all(each.extract_version < ZIP64_VERSION for each in archive.infolist())
        assert {each.date_time for each in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
