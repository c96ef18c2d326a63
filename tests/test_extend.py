"""Follows docs/extend.md literally in a copy of the project: writes its files and runs its commands."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from toy_training import command, toy_training

FILE = re.compile(r"^`([\w./]+)`:\n\n```\w+\n(.*?)```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^```sh\n(.*?)```", re.MULTILINE | re.DOTALL)
NAMES = ("sway", "hopping", "crossings")


@pytest.fixture(scope="module")
def copy(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project with the files of the page: for each part one of code and one of configuration."""
    root = tmp_path_factory.mktemp("copy")
    for name in ("src", "conf", "pipelines", "tests"):
        shutil.copytree(repository / name, root / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ("pyproject.toml", "dvc.yaml", "params.yaml"):
        shutil.copy(repository / name, root / name)
    files = FILE.findall((repository / "docs/extend.md").read_text())
    assert [Path(path).suffix for path, _ in files] == [".py", ".yaml"] * len(NAMES)
    for path, text in files:
        assert not (root / path).exists(), f"{path} is there already"
        (root / path).write_text(text)
    return root


def commands(repository: Path, module: str) -> list[list[str]]:
    page = (repository / "docs/extend.md").read_text()
    found = [shlex.split(each) for each in COMMAND.findall(page)]
    return [[sys.executable, *each[1:]] for each in found if each[:3] == ["python", "-m", module]]


def run(arguments: list[str], root: Path, project: Path | None = None) -> str:
    project = project or root
    environment = os.environ | {"PYTHONPATH": f"{project / 'src'}:{project}"}
    ended = subprocess.run(
        arguments, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=550
    )
    assert ended.returncode == 0, (ended.stdout + ended.stderr)[-3000:]
    return ended.stdout + ended.stderr


@pytest.mark.long
def test_every_part_of_the_page_keeps_its_contract(repository: Path, copy: Path) -> None:
    """Run the commands of the page, in one process instead of three."""
    wanted = [each[each.index("-k") + 1] for each in commands(repository, "pytest")]
    assert tuple(wanted) == NAMES
    said = run([*commands(repository, "pytest")[0][:-1], " or ".join(NAMES)], copy)
    assert re.search(r"^7 passed", said, re.MULTILINE), said


@pytest.mark.long
def test_a_model_of_the_page_trains_and_animates(copy: Path, tmp_path: Path) -> None:
    """Train a model with both new generators on toy recordings, load it and sample from it."""
    workspace = toy_training(tmp_path, steps=4, validate_every=2, batch=4)
    joint = workspace.params["model"]["joint"]
    joint["tokenizer"] = None
    joint["head"] = {"kind": "talkingeyes.models.head.sway:SwayHead", "correlation_frames": 12}
    joint["gaze"] = {"kind": "talkingeyes.models.gaze.hopping:HoppingGaze", "hold_frames": 12}
    joint["weights"] = {"head_likelihood": 1.0, "gaze_likelihood": 1.0}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(dict(workspace.params)))
    run(command("train", "joint"), tmp_path, copy)
    sample = "import numpy as np; from pathlib import Path; "
    sample += "from talkingeyes.training.motion_generators import load_generator; "
    sample += "made = load_generator(Path('data/train/joint')).generate(np.zeros((30, 6), np.float32), [1, 2], 25.0); "
    sample += "print(made.head.shape, made.gaze.shape)"
    assert "(2, 30, 3) (2, 30, 2, 3)" in run([sys.executable, "-c", sample], tmp_path, copy)


@pytest.mark.slow
def test_the_experiments_of_the_page_run(repository: Path, copy: Path) -> None:
    for arguments in commands(repository, "pipelines.experiment"):
        run(arguments, copy)
    assert list((copy / "build/tiny/data/sample/sway").rglob("*.npz"))
