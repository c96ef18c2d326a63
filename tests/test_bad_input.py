"""Bad input to every command: a one-line error on stderr, exit status 2, no partial output."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import toy_motions
from command_line import call
from toy_model import sound_file, toy_model

from talkingeyes.cli.main import COMMANDS
from talkingeyes.core.errors import InputError
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.workflows import convert


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with good and bad files of every kind."""
    root = tmp_path_factory.mktemp("bad")
    toy_motions.motion(seconds=1.0).save(root / "good.npz")
    toy_motions.flame_motion().save(root / "flame.npz")
    np.savez(root / "other.npz", a=np.zeros(3))
    np.savez(root / "pickled.npz", head=np.array([{}], object))
    (root / "cut.npz").write_bytes((root / "good.npz").read_bytes()[:700])
    (root / "text.txt").write_text("words")
    (root / "empty.npz").touch()
    (root / "list.json").write_text("[]")
    (root / "events.json").write_text('{"schema": "talkingeyes.events/2", "saccades": []}')
    (root / "bad.csv").write_text("a,b\n1,2\n")
    (root / "bad.glb").write_bytes(b"glTF" + bytes(20))
    (root / "bad.bvh").write_text("HIERARCHY\nROOT")
    (root / "bad.usda").write_text("#usda 1.0\n(")
    (root / "folder").mkdir()
    (root / "taken").mkdir()
    (root / "taken" / "letters.txt").touch()
    sound_file(root / "a.wav")
    toy_model(root / "model")
    return root


CASES = [
    ("", "Missing command"),
    ("dance", "No such command 'dance'"),
    ("animate --fly", "No such option: --fly"),
    ("animate a.wav -o out --seed one", "Invalid value for '--seed'"),
    ("animate a.wav -o out --model text.txt", "not a readable folder of the train stage or file"),
    ("animate a.wav -o out --model folder", "not a trained model"),
    ("animate text.txt -o out --model model", "not a sound that can be decoded"),
    ("animate folder -o out --model model", "folder: should hold sounds"),
    ("benchmark-corpus taken", "got one with letters.txt in it"),
    ("avatar -o taken --force", "got one with letters.txt in it"),
    ("render good.npz -o a.mp4 --head gaussians --model folder", "not a readable point cloud of Gaussians"),
    ("export good.npz -o a.ply --head gaussians --model folder", "not a readable point cloud of Gaussians"),
    ("export good.npz -o a.glb --head gaussians --model folder", "head: should be one of anny, flame"),
    ("animate a.wav -o taken --model model --force", "got one with letters.txt in it"),
    ("animate a.wav a.wav -o out --model model", "another sound is called a too"),
    ("animate a.wav text.txt -o taken --model model", "got letters.txt in it"),
    ("animate a.wav -o out --model model --target list.json", "schema should be"),
    ("animate a.wav -o out --model model --target bad.csv", "columns should be"),
    ("animate a.wav -o out --model model --eye-contact nan", "eye_contact: should be 0"),
    ("animate a.wav -o out --model model --style nobody", "style: should be one of"),
    ("animate a.wav -o out --model model --style cut.npz", "cut.npz: not a readable motion"),
    ("animate a.wav -o out --model model --emotion bored", "emotion: should be one of neutral, happy"),
    ("animate a.wav -o out --model model --emotion sad --intensity 9", "intensity: should be 1, 2 or 3"),
    ("animate a.wav -o out --model model --without nose", "parts: should be among head, gaze"),
    ("animate a.wav -o out --model model --replace head", "replace: should be PART=MOTION.npz"),
    ("animate a.wav -o out --model model --replace head=other.npz", "schema should be"),
    ("animate a.wav -o out --model model --dialogue", "a dialogue should have two channels"),
    ("animate a.wav a.wav -o out --model model --dialogue --partner a.wav", "without --partner"),
    ("animate a.wav a.wav -o out --model model --dialogue --person ann", "person: should be two in a dialogue (A,B)"),
    ("animate --text Hi -o out --model model --language xx", "language: should be one of en"),
    ("animate --text Hi -o out --model model --emotion bored", "emotion: should be one of neutral"),
    ("add-eyes bad.csv a.wav -o a.csv --model model", "bad.csv"),
    ("add-eyes bad.glb a.wav -o a.glb --model model", "bad.glb"),
    ("add-eyes list.json a.wav -o a.json --model model", "list.json"),
    ("add-eyes good.npz a.wav -o a.npz --model model", "got a motion"),
    ("add-eyes flame.npz a.wav -o a.glb", "should be a name that ends in .npz"),
    ("add-eyes bad.csv a.wav -o a.csv --blend 2", "blend: should be 0"),
    ("render cut.npz -o a.mp4", "cut.npz: not a readable motion"),
    ("render other.npz -o a.mp4", "schema should be talkingeyes.motion/1, got none"),
    ("render pickled.npz -o a.mp4", "pickled.npz: not a readable motion"),
    ("render empty.npz -o a.mp4", "empty.npz: not a readable motion"),
    ("render good.npz -o a.avi", "should be a name that ends in .mp4"),
    ("render good.npz -o none/a.mp4", "should be a file in a folder that exists"),
    ("render good.npz -o a.mp4 --keys list.json", "schema should be talkingeyes.events/2, got list"),
    ("render good.npz -o a.mp4 --keys events.json", "should hold the original keys too"),
    ("render good.npz -o a.mp4 --camera moon", "camera: should be head"),
    ("render good.npz -o a.mp4 --size 1", "size: should be 16 to 4096"),
    ("render good.npz -o a.mp4 --head flame", "model: should be the FLAME file"),
    ("render good.npz -o a.mp4 --head flame --model text.txt", "text.txt"),
    ("render good.npz -o a.mp4 --sound text.txt", "not a sound that can be decoded"),
    ("head -o a.jpg", "should be a name that ends in .png"),
    ("export good.npz -o a.npz", "format: should be given for a.npz, one of flame, vhap, diffposetalk"),
    ("export good.npz -o a.fbx", "format: should be given for a.fbx"),
    ("export good.npz -f fbx -o a.fbx", "format: should be one of flame"),
    ("export good.npz -f glb -o a.gltf", "should be a name that ends in .glb"),
    ("export good.npz -f glb -o a.glb --fps 1000", "fps: should be 10 to 240"),
    ("export good.npz -f glb -o a.glb --sound a.wav", "sound: should be used with mp4 only"),
    ("export good.npz -f glb -o a.glb --frame 1", "frame: should be used with obj and ply only, got glb"),
    ("export good.npz -o a.obj --frame -1", "frame: should be 0 to"),
    ("export good.npz -f bvh -o a.bvh --keys list.json", "schema should be talkingeyes.events/2"),
    ("export good.npz -f vhap -o a.npz", "model: should be your FLAME file"),
    ("export flame.npz -f livelink -o a.csv", "model: should be your FLAME file"),
    ("export none.npz -f bvh -o a.bvh", "none.npz: not a readable motion"),
    ("import bad.csv -o out", "bad.csv"),
    ("import bad.glb -o out", "bad.glb"),
    ("import bad.bvh -o out", "bad.bvh"),
    ("import bad.usda -o out", "bad.usda"),
    ("import list.json -o out", "list.json"),
    ("import other.npz -o out", "other.npz"),
    ("import pickled.npz -o out", "pickled.npz"),
    ("import folder -o out", "folder: should hold files that end in"),
    ("import good.npz flame.npz -o out.npz", "should be a folder for 2 files"),
    ("pack folder -o a.safetensors", "should be a trained model"),
    ("pack model -o a.bin", "should be a name that ends in .safetensors"),
    ("pack model model -o a.safetensors", "folders of different names"),
    ("evaluate folder --reference folder", "folder"),
    ("track none.mp4 -o out", "none.mp4"),
    ("capture none.mp4 -o out", "none.mp4"),
    ("view none.npz", "none.npz"),
]


@pytest.mark.parametrize(("words", "message"), CASES)
def test_bad_input_is_one_line_error_without_output(
    place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: str, message: str
) -> None:
    monkeypatch.chdir(place)
    before = {path: path.stat().st_mtime_ns for path in place.rglob("*")}
    status = call(*words.split())
    said = capfd.readouterr()
    lines = [line for line in said.err.splitlines() if "it/s]" not in line and line.strip()]
    assert status == 2, said
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    assert message in lines[0]
    assert said.out == ""
    assert {path: path.stat().st_mtime_ns for path in place.rglob("*")} == before


@pytest.mark.parametrize("format", ["flame", "livelink", "arkit", "glb", "vrm", "bvh", "obj", "ply", "motion"])
def test_damaged_files_are_read_or_one_line_errors(tmp_path: Path, format: str) -> None:
    """Truncated, or with some bytes changed."""
    good = tmp_path / f"good{'.npz' if format == 'motion' else convert.FORMATS[format].suffix}"
    shown = toy_motions.flame_motion().cut(0, 12) if format == "flame" else toy_motions.motion().cut(0, 12)
    shown.save(good) if format == "motion" else convert.write_motion(shown, None, format, good)
    content, rng = good.read_bytes(), np.random.default_rng(0)
    bad, refused = good.with_stem("bad"), 0
    for index in range(24):
        damaged = bytearray(content[: rng.integers(len(content))] if index % 3 == 0 else content)
        for _ in range(index % 3 * 2):
            damaged[rng.integers(min(len(damaged), 3000))] = rng.integers(256)
        bad.write_bytes(damaged)
        try:
            read_motion(bad)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error), error
    assert refused > 4


def test_all_commands_are_covered() -> None:
    tried = {words.split()[0] for words, _ in CASES if words}
    assert set(COMMANDS) - tried <= {"serve"}  # which reports errors over its connection (test_service)
