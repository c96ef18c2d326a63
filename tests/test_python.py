"""The Python API: lazy names, an animation that is saved and exported, and the examples of the docs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from toy_model import sound_file, toy_model

import talkingeyes as te


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with a sound, and a model at the default location."""
    monkeypatch.chdir(tmp_path)
    toy_model(tmp_path / "data" / "train" / "talkingeyes_events")
    for name in ("speech", "partner"):
        sound_file(tmp_path / f"{name}.wav", 3.0)
    return tmp_path


def test_minimal_example_in_four_lines(place: Path) -> None:
    m = te.animate("speech.wav", seed=1)
    m.save("speech.npz")
    te.export(m, "out.glb")
    te.export(m, "again.glb")  # the module `export` is imported now, and te.export is still the function
    assert (place / "out.glb").read_bytes() == (place / "again.glb").read_bytes()
    assert (place / "out.glb").read_bytes()[:4] == b"glTF"
    np.testing.assert_allclose(te.Motion.load(Path("speech.npz")).gaze, m.motion.gaze, atol=1e-6)
    assert len(te.Events.load(Path("speech.events.json")).saccades) == len(m.events.saccades)


def test_animate_is_the_first_sample(place: Path) -> None:
    one, many = te.animate("speech.wav", seed=2), te.animate_samples("speech.wav", 6, seed=2)
    np.testing.assert_array_equal(one.motion.gaze, many[0].motion.gaze)
    assert any(not np.array_equal(many[0].motion.head, other.motion.head) for other in many[1:])


def test_names_are_found_on_first_use_and_stay_what_they_are() -> None:
    from talkingeyes.formats.writers import glb  # noqa: F401

    for name in te.__all__:
        assert callable(getattr(te, name)), name
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        te.nothing  # noqa: B018


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import sys, talkingeyes; print([m for m in ('torch', 'numpy', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ})
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["out.npz", "out.json", "out.xyz"])
def test_an_ending_that_says_no_format_is_one_line(place: Path, name: str) -> None:
    with pytest.raises(te.InputError, match="format: should be given for out"):
        te.export(te.Motion.of(25.0, np.zeros((9, 3)), np.zeros((9, 2, 3))), name)


def test_the_examples_of_the_page_run(place: Path, repository: Path) -> None:
    """All Python blocks of docs/python.md, in order, in one process."""
    blocks = re.findall(r"```python\n(.*?)```", (repository / "docs" / "python.md").read_text(), re.DOTALL)
    assert len(blocks) >= 4
    space: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), space)


@pytest.mark.long
def test_the_examples_of_the_page_are_typed(repository: Path, tmp_path: Path) -> None:
    """The examples pass mypy --strict, so the type annotations of the package are sufficient for users."""
    blocks = re.findall(r"```python\n(.*?)```", (repository / "docs" / "python.md").read_text(), re.DOTALL)
    (tmp_path / "examples.py").write_text("\n".join(blocks))
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", str(repository / "pyproject.toml")]
    environment = {**os.environ, "MYPYPATH": str(repository / "src")}
    done = subprocess.run(
        [*command, "--cache-dir", str(repository / ".mypy_cache"), str(tmp_path / "examples.py")],
        cwd=repository,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert "examples.py" not in done.stdout, done.stdout
