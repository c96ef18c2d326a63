"""Names of shapes as programs spell them, in tables and JSON that are read and edited."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from face_files import weights
from toy_model import sound_file, toy_model

from talkingeyes.formats import arkit
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.formats.shape_names import STANDARD_NAMES, shape_names
from talkingeyes.formats.writers.arkit import timecode
from talkingeyes.workflows.add_eyes import add_eyes

pytestmark = pytest.mark.usefixtures("models_loaded_once")


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toy_model(tmp_path_factory.mktemp("toy") / "model")


def snake(name: str) -> str:
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name)


def short_side(name: str, form: str) -> str:
    """A name with its side as one letter: eyeBlink_L for the form "_L"."""
    for side in ("Left", "Right"):
        if name.endswith(side):
            letter = side[0] if form[-1].isupper() else side[0].lower()
            return name.removesuffix(side) + form[:-1] + letter
    return name


SPELLINGS: dict[str, Callable[[str], str]] = {
    "ARKit": str,
    "capital": lambda name: name[0].upper() + name[1:],
    "capitals": str.upper,
    "small": str.lower,
    "_L": lambda name: short_side(name, "_L"),
    "_l": lambda name: short_side(name, "_l"),
    ".L": lambda name: short_side(name, ".L"),
    "L": lambda name: short_side(name, "L"),
    "snake": snake,
    "words": lambda name: snake(name).replace("_", " "),
    "part": lambda name: f"blendShapes.{name}",
    "part and .L": lambda name: f"Face|head.{short_side(name, '.L')}",
    "prefix": lambda name: f"Face_{name}",
    "prefix and _L": lambda name: f"CTRL_expressions_{short_side(name, '_L')}",
    "prefix without separator": lambda name: f"Avatar{name[0].upper()}{name[1:]}",
    "numbers": lambda name: f"{arkit.NAMES.index(name):02d}_{name}",
    "side first": lambda name: (
        f"L_{name.removesuffix('Left')}" if name.endswith("Left") else name
    ),  # the right ones as ARKit
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_each_spelling_of_arkits_names_is_known(spelling: str) -> None:
    assert shape_names([SPELLINGS[spelling](name) for name in arkit.NAMES]) == arkit.NAMES


def test_standard_names_are_their_own() -> None:
    assert shape_names(STANDARD_NAMES) == STANDARD_NAMES
    assert len({name.lower() for name in STANDARD_NAMES}) == len(STANDARD_NAMES)


def test_other_names_stay_what_they_are() -> None:
    names = ["jawOpen", "eyeBlinkLeft", "jawOpen_mouthClose", "lowerMouthLeft", "viseme_aa", "Timecode", "gaze_yaw"]
    assert shape_names(names) == tuple(names)
    assert shape_names(["Face_jawOpen", "Face_tongueOut", "Face_wink", "jawOpen_mouthClose"])[2:] == (
        "wink",
        "jawOpen_mouthClose",
    )
    assert shape_names([]) == ()


def test_sides_of_audio2face_are_letters_or_words() -> None:
    names = ["eyesCloseL", "eyesClose_R", "squint_left", "EyesUpperLidRaiserRight", "eyesLookLeft"]
    assert shape_names(names) == ("eyesCloseL", "eyesCloseR", "squintL", "eyesUpperLidRaiserR", "eyesLookLeft")


def test_eyes_of_character_creator_and_mmd_are_arkits() -> None:
    looks = ["Eye_L_Look_L", "Eye_L_Look_R", "Eye_R_Look_L", "Eye_R_Look_R", "Eye_L_Look_Up", "Eye_R_Look_Down"]
    assert shape_names(looks) == (
        *("eyeLookOutLeft", "eyeLookInLeft", "eyeLookInRight", "eyeLookOutRight"),
        *("eyeLookUpLeft", "eyeLookDownRight"),
    )
    assert shape_names(["まばたき", "ウィンク", "ウィンク右", "ウィンク２", "ｳｨﾝｸ２右", "あ"]) == (
        *("eyesClosed", "eyeBlinkLeft", "eyeBlinkRight", "eyeBlinkLeft", "eyeBlinkRight", "あ"),
    )
    assert shape_names(["Face.M_まばたき", "Face.M_あ"])[0] == "eyesClosed"
    assert shape_names(["Fcl_ALL_Joy", "Fcl_EYE_Close", "Fcl_EYE_Close_L"])[1:] == ("eyesClosed", "eyeBlinkLeft")
    assert shape_names(["Blink", "Blink_L", "Eyes_Blink"]) == ("eyesClosed", "eyeBlinkLeft", "eyesClosed")


def written_json(path: Path, names: list[str], table: np.ndarray) -> Path:
    path.write_text(json.dumps({"exportFps": 30, "facsNames": names, "weightMat": table.tolist()}))
    return path


def written_csv(path: Path, names: list[str], table: np.ndarray) -> Path:
    rows = [",".join([timecode(frame, 30.0), *map(str, row)]) for frame, row in enumerate(table.tolist())]
    path.write_text("\n".join([",".join(["Timecode", *names]), *rows]) + "\n")
    return path


WRITERS = {"a.json": written_json, "a.csv": written_csv}


@pytest.mark.parametrize("file", WRITERS)
@pytest.mark.parametrize("spelling", ["_L", "capitals", "prefix and _L", "snake"])
def test_a_file_says_the_same_in_each_spelling(tmp_path: Path, file: str, spelling: str) -> None:
    table = weights(45, 52)
    (tmp_path / "other").mkdir()
    written = [
        WRITERS[file](folder / file, [SPELLINGS[each](name) for name in arkit.NAMES], table)
        for folder, each in ((tmp_path, "ARKit"), (tmp_path / "other", spelling))
    ]
    same, found = (read_motion(path).motion for path in written)
    assert np.abs(same.gaze).max() > 0.1
    for field in ("gaze", "lid", "jaw", "expression"):
        np.testing.assert_array_equal(getattr(found, field), getattr(same, field))


BOTH = ("eyesClosed", "eyesLookUp", "eyesLookDown")  # of Ready Player Me, beside ARKit's


@pytest.mark.parametrize("file", WRITERS)
def test_shapes_of_both_eyes_count_and_do_not_double_ours(model: Path, tmp_path: Path, file: str) -> None:
    table = np.zeros((45, 55))
    table[:, 52], table[:, 53] = weights(45, 2).T
    path, out = WRITERS[file](tmp_path / file, [*arkit.NAMES, *BOTH], table), tmp_path / f"out{Path(file).suffix}"
    read = read_motion(path, eyes="optical").motion
    np.testing.assert_allclose(read.lid, np.repeat(table[:, [52]], 2, axis=1), atol=1e-9)
    assert np.degrees(read.gaze[..., 0]).min() == pytest.approx(-37 * table[:, 53].max())
    done = add_eyes(path, sound_file(tmp_path / "speech.wav", seconds=1.5), out, model=model)
    np.testing.assert_allclose(read_motion(out).motion.lid, done.animation.motion.lid, atol=1e-6)
    content = out.read_text()
    shared = json.loads(content)["weightMat"] if file == "a.json" else [r.split(",")[1:] for r in content.split()[1:]]
    assert not np.array(shared, float)[:, 52:].any()


@pytest.mark.parametrize("file", WRITERS)
def test_eyes_are_put_under_the_names_of_the_file(model: Path, tmp_path: Path, file: str) -> None:
    names = [SPELLINGS["prefix and _L"](name) for name in arkit.NAMES]
    path = WRITERS[file](tmp_path / file, names, np.zeros((45, 52)))
    sound, out = sound_file(tmp_path / "speech.wav", seconds=1.5), tmp_path / f"out{path.suffix}"
    done = add_eyes(path, sound, out, seed=2, model=model)
    read = read_motion(out).motion
    np.testing.assert_allclose(read.lid, done.animation.motion.lid, atol=1e-6)
    assert np.abs(read.gaze).max() > 0.02


@pytest.mark.parametrize("file", WRITERS)
def test_shapes_without_a_place_are_named(tmp_path: Path, file: str) -> None:
    names = [*arkit.NAMES[:10], *(f"wrinkle{k}" for k in range(24))]
    path = WRITERS[file](tmp_path / file, names, weights(45, 34))
    assert read_motion(path).notes[0] == (
        "24 of 34 shapes have no place here: wrinkle0, wrinkle1, wrinkle2, wrinkle3, wrinkle4, wrinkle5, ..."
    )
    path = WRITERS[file](tmp_path / file, list(arkit.NAMES), weights(45, 52))
    assert not [note for note in read_motion(path).notes if "place" in note]
