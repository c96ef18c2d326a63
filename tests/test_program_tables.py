"""Tables in the forms in which programs and spreadsheets write them: cells, encodings, times, rows without a face."""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
import toy_motions
from face_files import weights

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.editors.channels import AddedEyes
from talkingeyes.formats.editors.face_file import open_face_file
from talkingeyes.formats.readers.clock import row_timing
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.writers.arkit import timecode

NAMES = [name[0].upper() + name[1:] for name in arkit.NAMES]
FRAMES = 45


def take(fps: float = 30.0, frames: int = FRAMES) -> list[list[str]]:
    """The cells of a take in which face and eyes move, with a note in the last column."""
    table = weights(frames, len(NAMES))
    rows = [[timecode(k, fps), "61", *(f"{value:.6f}" for value in row), f"b{k}"] for k, row in enumerate(table)]
    return [["Timecode", "BlendShapeCount", *NAMES, "Note"], *rows]


def written(rows: list[list[str]], delimiter: str = ",", decimal: str = ".", end: str = "\n", quoting: int = 0) -> str:
    text = io.StringIO()
    csv.writer(text, delimiter=delimiter, lineterminator=end, quoting=quoting).writerows(  # type: ignore[arg-type]
        [[cell.replace(".", decimal) if cell[:2] in ("0.", "1.") else cell for cell in row] for row in rows]
    )
    return text.getvalue()


def accented(rows: list[list[str]]) -> list[list[str]]:
    return [[*row[:-1], "Müller"] for row in rows]


FORMS: dict[str, Callable[[list[list[str]]], bytes]] = {
    "plain": lambda rows: written(rows).encode(),
    "quoted": lambda rows: written(rows, quoting=csv.QUOTE_ALL, end="\r\n").encode(),
    "spaces": lambda rows: written([[f" {cell}" for cell in row] for row in rows]).encode(),
    "semicolon, decimal comma": lambda rows: written(rows, ";", ",").encode(),
    "semicolon, decimal point": lambda rows: written(rows, ";").encode(),
    "comma, decimal comma": lambda rows: written(rows, ",", ",").encode(),
    "tabs": lambda rows: written(rows, "\t", end="\r\n").encode(),
    "sep=": lambda rows: ("sep=;\r\n" + written(rows, ";", ",", "\r\n")).encode(),
    "UTF-8 with a mark": lambda rows: written(accented(rows)).encode("utf-8-sig"),
    "UTF-16": lambda rows: b"\xff\xfe" + written(rows, "\t", ",", "\r\n").encode("utf-16-le"),
    "UTF-16 of another order": lambda rows: b"\xfe\xff" + written(rows).encode("utf-16-be"),
    "UTF-16 without a mark": lambda rows: written(rows).encode("utf-16-le"),
    "Latin-1": lambda rows: written(accented(rows), ";").encode("latin-1"),
    "no end of the last line": lambda rows: written(rows).rstrip("\n").encode(),
    "a delimiter at the ends of rows": lambda rows: written(rows).replace("\n", ",\n").replace(",\n", "\n", 1).encode(),
    "a delimiter at all ends": lambda rows: written(rows, ";").replace("\n", ";\n").encode(),
    "empty lines": lambda rows: written(rows).replace("\n", "\n\n").encode(),
    "a title and a comment": lambda rows: ("Take 3, Anna\n# 30 fps\n\n" + written(rows, ";", ",")).encode(),
    "names after #": lambda rows: ("# " + written(rows)).encode(),
    "rows of empty cells at the end": lambda rows: (written(rows, ";") + 2 * (";" * 54 + "\r\n")).encode(),
}


def edited(path: Path, motion: Motion | None = None) -> bytes:
    """The file with the eyes and the head of a motion."""
    file = open_face_file(path)
    made = toy_motions.motion(file.motion.fps, len(file.motion) / file.motion.fps) if motion is None else motion
    return file.editor.edited(AddedEyes(made, True, 1.0))


@pytest.mark.parametrize("form", FORMS)
def test_a_table_is_read_and_edited_in_its_form(tmp_path: Path, form: str) -> None:
    plain, path = tmp_path / "plain.csv", tmp_path / "other.csv"
    plain.write_bytes(FORMS["plain"](take()))
    path.write_bytes(FORMS[form](take()))
    same, found = (read_motion(each).motion for each in (plain, path))
    assert (len(found), found.fps) == (FRAMES, 30.0)
    for field in ("gaze", "lid", "jaw", "expression"):
        np.testing.assert_array_equal(getattr(found, field), getattr(same, field))
    new = edited(path)
    path.write_bytes(new)
    plain.write_bytes(edited(plain))
    own, changed = read_motion(plain).motion, read_motion(path).motion
    np.testing.assert_allclose(changed.gaze, own.gaze, atol=1e-6)
    np.testing.assert_array_equal(changed.jaw, same.jaw)
    assert np.abs(changed.gaze - same.gaze).max() > 0.1
    old = FORMS[form](take())
    assert new[:40] == old[:40]  # mark, quotes and delimiters of the names
    for sign in (b'"', b"\r", b"\n", b";", b"\t"):
        assert new.count(sign) == old.count(sign), sign
    assert len(new) - len(old) == FRAMES * 14 * (2 if "UTF-16" in form else 1)  # our numbers have a digit more


def test_a_gzipped_table_is_edited_in_its_form(tmp_path: Path) -> None:
    path = tmp_path / "take.csv.gz"
    path.write_bytes(gzip.compress(FORMS["sep="](take())))
    assert gzip.decompress(edited(path)).startswith(b"sep=;\r\nTimecode;")


def test_a_table_of_lips_is_read_and_has_no_place_for_eyes(tmp_path: Path) -> None:
    lips = [k for k, name in enumerate(take()[0]) if not name.startswith("Eye")]
    path = tmp_path / "lips.csv"
    path.write_text(written([[row[k] for k in lips] for row in take()]))
    assert read_motion(path).motion.jaw[:, 0].max() > 0.1
    with pytest.raises(InputError, match=r"lips\.csv: should have columns of eyes \(EyeBlinkLeft, \.\.\.\), got Timec"):
        open_face_file(path)


def test_a_cell_with_a_quote_inside_is_a_one_line_error(tmp_path: Path) -> None:
    text = written(take(), quoting=csv.QUOTE_ALL)
    (tmp_path / "a.csv").write_text(text.replace('"0.', '"0."', 1))
    with pytest.raises(InputError, match=r"a\.csv: cells should hold numbers, got"):
        edited(tmp_path / "a.csv")


def test_a_column_that_starts_with_zeros_may_hold_fractions(tmp_path: Path) -> None:
    """Types are not guessed from the first rows."""
    rows = take(60.0, 6000)
    tongue = rows[0].index("TongueOut")
    for k, row in enumerate(rows[1:]):
        row[tongue] = "0" if k < 5000 else "0.5"
    path = tmp_path / "long.csv"
    path.write_text(written(rows))
    assert read_motion(path).motion.expression[-1, arkit.EXPRESSION.index("tongueOut")] == 0.5


# Times.


def rounded(fps: float, digits: int, frames: int = 150, unit: float = 1.0) -> list[str]:
    return [f"{unit * k / fps:.{digits}f}" for k in range(frames)]


def clock(fps: float, frames: int = 90) -> list[str]:
    return [f"18:48:{59 + k / fps:06.3f}" if k < fps else f"18:49:{k / fps - 1:06.3f}" for k in range(frames)]


def landmark_link(fps: float, frames: int) -> list[str]:
    """Face_Landmark_Link: frames of a second from 1, and thousandths that count all frames."""
    count = range(1, frames + 1)
    return [f"00:{int(k / fps) // 60:02d}:{int(k / fps) % 60:02d}:{int(k % fps):02d}.{k % 1000:03d}" for k in count]


def codes(base: int, frames: range, separator: str = ":") -> list[str]:
    return [f"18:48:{50 + k // base:02d}{separator}{k % base:02d}" for k in frames]


TIMES: dict[str, tuple[list[str], float]] = {
    "24 in ms": (rounded(24.0, 3), 24.0),
    "25 in ms": (rounded(25.0, 3), 25.0),
    "30 in ms": (rounded(30.0, 3), 30.0),
    "29.97 in ms": (rounded(30 * 1000 / 1001, 3), 30 * 1000 / 1001),
    "23.976 in ms": (rounded(24 * 1000 / 1001, 3), 24 * 1000 / 1001),
    "60 in ms": (rounded(60.0, 3), 60.0),
    "59.94 in ms": (rounded(60 * 1000 / 1001, 3), 60 * 1000 / 1001),
    "120 in ms": (rounded(120.0, 3), 120.0),
    "60 in hundredths": (rounded(60.0, 2), 60.0),
    "30 as ms": (rounded(30.0, 0, unit=1e3), 30.0),
    "30 as us": (rounded(30.0, 0, unit=1e6), 30.0),
    "30 in decimal commas": ([code.replace(".", ",") for code in rounded(30.0, 3)], 30.0),
    "15 in ms": (rounded(15.0, 3), 15.0),
    "12.5 in ms": (rounded(12.5, 3), 12.5),
    "an own rate": (rounded(27.3, 4), 27.3),
    "clock 30": (clock(30.0), 30.0),
    "clock 25": (clock(25.0), 25.0),
    "dates": ([f"2026-05-01T12:{k // 1500:02d}:{k / 25 % 60:06.3f}Z" for k in range(90)], 25.0),
    "German dates": ([f"01.05.2026 12:00:{k / 25:06.3f}" for k in range(90)], 25.0),
    "American dates": ([f"5/1/2026, 12:00:{k / 25:06.3f}" for k in range(90)], 25.0),
    "durations of Python": ([str(timedelta(microseconds=round(k * 1e6 / 30))) for k in range(90)], 30.0),
    "whole seconds": ([f"12:00:{k // 30:02d}" for k in range(300)], 30.0),
    "code 25": (codes(25, range(60)), 25.0),
    "code 24": (codes(24, range(5, 90)), 24.0),
    "code 30": (codes(30, range(90)), 30.0),
    "code 60": (codes(60, range(130)), 60.0),
    "drop-frame": (codes(30, range(90), ";"), 30 * 1000 / 1001),
    "drop-frame 59.94": (codes(60, range(130), ";"), 60 * 1000 / 1001),
    "drop-frame over a minute": ([*codes(30, range(280, 300), ";"), "18:49:00;02", "18:49:00;03"], 30 * 1000 / 1001),
    "landmark link 25": (landmark_link(25.0, 100), 25.0),
    "landmark link 24": (landmark_link(24.0, 100), 24.0),
    "landmark link 30": (landmark_link(30.0, 1200), 30.0),
    "landmark link 60": (landmark_link(60.0, 130), 60.0),
    "ours at 29.97": ([timecode(k, 30 * 1000 / 1001) for k in range(100)], 30 * 1000 / 1001),
    "repeated codes": (codes(30, range(0, 90, 2)) * 2, 30.0),
    "60 in codes of 30": (codes(30, range(60)) * 2, 60.0),
}
for twice in ("repeated codes", "60 in codes of 30"):
    TIMES[twice] = (sorted(TIMES[twice][0]), TIMES[twice][1])


@pytest.mark.parametrize("times", TIMES)
def test_the_rate_follows_from_times_and_rows_are_frames(times: str) -> None:
    written_times, rate = TIMES[times]
    timing = row_timing(written_times, len(written_times), None)
    assert timing.fps == pytest.approx(rate, rel=1e-9)
    np.testing.assert_array_equal(timing.frames, np.arange(len(written_times)))


def test_uneven_times_of_a_camera_are_frames_in_order() -> None:
    rng = np.random.default_rng(0)
    times = np.arange(300) / 30 + rng.uniform(-0.012, 0.012, 300)
    timing = row_timing([f"{time - times[0]:.4f}" for time in times], 300, None)
    assert timing.fps == 30.0
    np.testing.assert_array_equal(timing.frames, np.arange(300))


@pytest.mark.parametrize("times", ["30 in ms", "60 in ms", "clock 25", "code 30", "drop-frame"])
def test_missing_rows_leave_their_frames(times: str) -> None:
    written_times, rate = TIMES[times]
    kept = [*range(20), *range(21, 40), *range(46, len(written_times))]
    timing = row_timing([written_times[k] for k in kept], len(kept), None)
    assert timing.fps == pytest.approx(rate, rel=1e-9)
    np.testing.assert_array_equal(timing.frames, kept)


def test_with_fps_rows_are_frames() -> None:
    for times in (["12:00:00:00"] * 9, ["x"] * 9, [], TIMES["repeated codes"][0][:9]):
        timing = row_timing(times, 9, 50.0)
        assert timing.fps == 50.0
        np.testing.assert_array_equal(timing.frames, np.arange(9))


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([], "should contain time codes, got none; set --fps"),
        (["soon"] * 9, "should hold time codes like 18:48:59:39.473 or seconds, got 'soon'; set --fps"),
        (["5"] * 9, "times should rise"),
        ([str(9 - k / 30) for k in range(9)], "times should rise"),
        ([str(k) for k in range(9)], "should give a rate of 5 to 400 fps, got 1; set --fps"),
        ([f"00:00:{k:02d}" for k in range(9)], "should give a rate of 5 to 400 fps, got 1; set --fps"),
        (codes(30, range(9)), "the rate should follow from time codes of more than a second; set --fps"),
        (["00:00:00:500", "00:00:01:600"], "time codes should count at most 240 frames a second, got 600"),
    ],
)
def test_times_that_say_no_rate_are_one_line_errors(times: list[str], message: str) -> None:
    with pytest.raises(InputError) as error:
        row_timing(times, 9 if not times else len(times), None)
    assert message in str(error.value)


# Rows without a face.


def without_face(rows: list[list[str]], lost: range, form: str) -> list[list[str]]:
    """The rows in which a program has lost the face: no cells, empty ones, no number, or zeros of 0 shapes."""
    cells = {"short": [], "empty": [""] * 53, "nan": ["nan", "#N/A"] * 26 + [""], "none": ["0.0"] * 52 + [""]}[form]
    return [[row[0], "0", *cells] if k in lost else row for k, row in enumerate(rows, -1)]


@pytest.mark.parametrize("form", ["short", "empty", "nan", "none", "missing"])
def test_rows_without_a_face_are_gaps(tmp_path: Path, form: str) -> None:
    lost, rows = range(32, 42), take()
    held = [row for k, row in enumerate(rows, -1) if k not in lost]
    path = tmp_path / "lost.csv"
    path.write_text(written(held if form == "missing" else without_face(rows, lost, form)))
    motion = read_motion(path).motion
    whole = tmp_path / "whole.csv"
    whole.write_text(written(rows))
    same = read_motion(whole).motion
    assert (len(motion), motion.fps) == (FRAMES, 30.0)
    assert [k for k in range(FRAMES) if not motion.valid[k]] == list(lost)
    np.testing.assert_array_equal(motion.jaw[motion.valid], same.jaw[motion.valid])
    np.testing.assert_allclose(motion.lid[36], motion.lid[31] + 5 / 11 * (motion.lid[42] - motion.lid[31]))
    before, after = path.read_text().splitlines(), edited(path).decode().splitlines()
    if form != "missing":
        assert before[33:43] == after[33:43]
    assert before[32] != after[32]


def test_single_cells_without_a_number_are_filled(tmp_path: Path) -> None:
    rows = take()
    column = rows[0].index("JawOpen")
    rows[10][column] = ""
    path = tmp_path / "a.csv"
    path.write_text(written(rows))
    motion = read_motion(path).motion
    assert motion.valid.all()
    assert motion.jaw[9, 0] == pytest.approx((motion.jaw[8, 0] + motion.jaw[10, 0]) / 2)


def test_a_table_without_any_value_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(written(without_face(take(), range(FRAMES), "empty")))
    with pytest.raises(InputError, match="should have rows with values, got none"):
        read_motion(path)


@pytest.mark.parametrize(
    ("name", "unit"), [("Time (s)", 1.0), ("time_ms", 1e3), ("timestamp_s", 1.0), ("Seconds", 1.0)]
)
def test_a_column_of_times_may_name_its_unit(tmp_path: Path, name: str, unit: float) -> None:
    rows = [[name, "Timecode", "Unnamed: 0", *NAMES]]
    rows += [[f"{unit * k / 50:.4f}", "", str(k), *row[2:-1]] for k, row in enumerate(take()[1:])]
    path = tmp_path / "a.csv"
    path.write_text(written(rows))
    read = read_motion(path)
    assert (len(read.motion), read.motion.fps) == (FRAMES, 50.0)
    assert not [note for note in read.notes if "place" in note]


def test_percent_is_refused_as_percent(tmp_path: Path) -> None:
    rows = take()
    path = tmp_path / "a.csv"
    path.write_text(
        written([rows[0], *([*row[:2], *(str(100 * float(v)) for v in row[2:-1]), ""] for row in rows[1:])])
    )
    with pytest.raises(
        InputError, match=r"a\.csv: coefficients should be 0 to 1, got (9\d|100).*; divide percent by 100$"
    ):
        read_motion(path)


def test_the_place_of_an_iris_is_no_angle(tmp_path: Path) -> None:
    """Face_Landmark_Link writes the place of an iris in the picture where Live Link Face has angles."""
    rows, rng = take(), np.random.default_rng(1)
    place = rng.normal(0.5, 0.01, (FRAMES, 2))
    angles = [f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll")]
    rows[0] += angles
    for row, (x, y) in zip(rows[1:], place, strict=True):
        row.extend(["0"] * 3 + [f"{x:.6f}", f"{y:.6f}", "0"] * 2)
    path, plain = tmp_path / "a.csv", tmp_path / "plain.csv"
    path.write_text(written(rows))
    plain.write_text(written(take()))
    np.testing.assert_array_equal(read_motion(path).motion.gaze, read_motion(plain).motion.gaze)


def openface(path: Path, fps: float, lost: tuple[int, ...] = (), delimiter: str = ", ", cell: str = "0") -> Path:
    names = ["frame", "face_id", "timestamp", "confidence", "success", "gaze_angle_x", "gaze_angle_y"]
    names += [f"pose_{kind}{axis}" for kind in "RT" for axis in "xyz"]
    rows = [names]
    for k in range(150):
        values = [cell] * 8 if k in lost else ["0.1", "0.05", "0.02", f"{0.002 * k:.3f}", "0", "1", "2", "400"]
        rows.append([str(k + 1), "0", f"{k / fps:.3f}", *(["0.0", "0"] if k in lost else ["0.98", "1"]), *values])
    path.write_text("\n".join(delimiter.join(row) for row in rows) + "\n")
    return path


@pytest.mark.parametrize("fps", [24.0, 25.0, 29.97002997, 30.0, 50.0, 60.0, 120.0])
def test_openface_has_a_frame_a_row(tmp_path: Path, fps: float) -> None:
    motion = read_motion(openface(tmp_path / "a.csv", fps)).motion
    assert motion.fps == pytest.approx(fps, rel=1e-6)
    assert (len(motion), motion.valid.all()) == (150, True)
    assert len(read_motion(tmp_path / "a.csv", 48.0).motion) == 150


@pytest.mark.parametrize("cell", ["0", "", "nan", "-nan(ind)"])
def test_openface_may_lose_the_face(tmp_path: Path, cell: str) -> None:
    motion = read_motion(openface(tmp_path / "a.csv", 30.0, (5, 6, 7), cell=cell)).motion
    assert np.flatnonzero(~motion.valid).tolist() == [5, 6, 7]
    assert "3 of 150 frames have no face: filled in, not valid" in read_motion(tmp_path / "a.csv").notes
    np.testing.assert_array_equal(motion.head[5:8], motion.head[[4, 4, 4]])


def test_openface_names_the_action_units_that_are_lost(tmp_path: Path) -> None:
    path = openface(tmp_path / "a.csv", 30.0)
    names, *rows = path.read_text().splitlines()
    path.write_text("\n".join([f"{names}, AU12_r, AU45_r, AU45_c", *(f"{row}, 1.5, 2.5, 1" for row in rows)]))
    read = read_motion(path)
    assert read.notes[0] == "1 of 3 action units has no place here: AU12_r"
    assert (read.motion.lid == 0.5).all()


def test_openface_of_two_faces_is_refused(tmp_path: Path) -> None:
    path = openface(tmp_path / "a.csv", 30.0)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, "1, 1, 0.000, 0.98, 1, 0, 0, 0, 0, 0, 0, 0, 400"]))
    with pytest.raises(InputError, match="should hold one face, got those of face_id 0, 1"):
        read_motion(path)


def test_pyfeat_may_lose_the_face(tmp_path: Path) -> None:
    names = ["frame", "FaceScore", "Yaw", "Pitch", "Roll", "gaze_yaw", "gaze_pitch", "eyeBlinkLeft", "eyeBlinkRight"]
    rows = [[str(2 * k), "0.99", "0.1", f"{k / 100}", "0", "0.1", "0", "0.2", "0.2"] for k in range(40)]
    rows[10][1:] = [""] * 8
    del rows[20]
    path = tmp_path / "a.csv"
    path.write_text(written([names, *rows]))
    motion = read_motion(path, 30.0).motion
    assert (len(motion), motion.fps) == (40, 15.0)
    assert np.flatnonzero(~motion.valid).tolist() == [10, 20]
    new = open_face_file(path, 30.0).editor.edited(AddedEyes(toy_motions.motion(15.0, 40 / 15), True, 1.0))
    assert new.decode().splitlines()[11] == "20,,,,,,,,"
