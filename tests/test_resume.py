"""Training that is killed resumes from its last validation and ends with bitwise identical weights."""

from __future__ import annotations

import contextlib
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_training import Line, loop
from toy_training import command, toy_training

from pipelines import critic, pretrain
from pipelines import train as train_stage
from talkingeyes.training.loop import train
from talkingeyes.training.resume import ResumeFile, TrainingState

STEPS = {"steps": 20, "validate_every": 4, "batch": 4}
STAGES = [("pretrain", "codes"), ("train", "joint"), ("critic",)]
RUN: dict[str, Any] = {"pretrain": pretrain.run, "train": train_stage.run, "critic": critic.run}


def finish(root: Path, *stage: str) -> str:
    """Run a stage to its end and return its output."""
    return subprocess.run(command(*stage), cwd=root, check=True, capture_output=True, text=True, timeout=120).stderr


def kill_halfway(root: Path, resume: str, *stage: str) -> None:
    """Start a stage and kill it as soon as it has written its progress."""
    with subprocess.Popen(command(*stage), cwd=root, stderr=subprocess.DEVNULL) as process:
        while not (root / "data" / resume).exists():
            assert process.poll() is None, "ended before anything could be killed"
            time.sleep(0.005)
        process.kill()
    assert process.returncode == -9


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of uninterrupted stages."""
    workspace = toy_training(tmp_path_factory.mktemp("whole"), **STEPS)
    for stage, *names in STAGES:
        RUN[stage](workspace, *names)
    assert not list((workspace.root / "data").glob(".*"))
    return workspace.root


@pytest.mark.long
@pytest.mark.parametrize("stage", STAGES, ids="-".join)
def test_a_killed_stage_ends_in_the_same_bytes(stage: tuple[str, ...], whole: Path, tmp_path: Path) -> None:
    toy_training(tmp_path, **STEPS)
    if stage[0] == "train":
        (tmp_path / "data" / "pretrain").symlink_to(whole / "data" / "pretrain")
    resume = f".{'-'.join(stage)}.resume" if len(stage) > 1 else ".critic-gaze_in_space.resume"
    kill_halfway(tmp_path, resume, *stage)
    assert not (tmp_path / "data").joinpath(*stage).exists()
    said = finish(tmp_path, *stage)
    assert f"{resume}: resuming from step" in said
    assert files((tmp_path / "data").joinpath(*stage)) == files((whole / "data").joinpath(*stage))
    assert not list((tmp_path / "data").glob(".*.resume*")), "nothing is left when the stage has ended"


class Stopped(Exception):
    """Simulates a kill."""


def stop_at(step: int) -> Any:
    def on_validation(now: int, figures: dict[str, float]) -> None:
        if now == step:
            raise Stopped

    return on_validation


class Noisy(Line):
    """The toy regression task with noise from both random generators."""

    def losses(self, step: int) -> dict[str, torch.Tensor]:
        error = super().losses(step)["total"]
        return {"total": error * (1 + 0.1 * float(self.rng.normal())) + 0.1 * torch.randn(()) * self.module.bias[0]}


def test_best_weights_history_and_generators_come_back(tmp_path: Path) -> None:
    settings = loop(steps=60, validate_every=20)
    whole, interrupted = Noisy(), Noisy()
    torch.manual_seed(1)
    expected = train(whole, settings, "whole")
    resume = ResumeFile.of(tmp_path / "p", ["a"], [])
    torch.manual_seed(1)
    with pytest.raises(Stopped):
        train(interrupted, settings, "first", stop_at(40), resume=resume)
    seen: list[int] = []
    again = Noisy()
    history = train(again, settings, "second", lambda step, figures: seen.append(step), resume=resume)
    assert history == expected
    assert seen == [20, 40, 60], "who watches hears of the validations before, too"
    assert torch.equal(again.module.weight, whole.module.weight)


def interrupted(path: Path, fingerprint: str) -> ResumeFile:
    """Progress file of a training of 60 steps at step 20."""
    resume = ResumeFile.of(path, [fingerprint], [])
    with contextlib.suppress(Stopped):
        train(Noisy(), loop(steps=60, validate_every=20), "first", stop_at(20), resume=resume)
    return resume


def restored(resume: ResumeFile) -> TrainingState:
    task = Noisy()
    return resume.restore(task.module, torch.optim.AdamW(task.module.parameters()), task.rng)


def test_progress_of_other_settings_is_not_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    resume = interrupted(tmp_path / "p", "a")
    assert restored(resume).step == 20
    assert "resuming from step 20" in capsys.readouterr().err
    assert restored(ResumeFile.of(tmp_path / "p", ["b"], [])).step == 0
    assert "other settings, data or code" in capsys.readouterr().err
    data = tmp_path / "data"
    data.write_text("1")
    before = ResumeFile.of(tmp_path / "p", ["a"], [data])
    data.write_text("2")
    assert before.fingerprint != ResumeFile.of(tmp_path / "p", ["a"], [data]).fingerprint


def test_other_code_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resume = interrupted(tmp_path / "p", "a")
    (tmp_path / "package" / "models").mkdir(parents=True)
    (tmp_path / "package" / "models" / "new.py").write_text("")
    monkeypatch.setattr("talkingeyes.training.resume.PACKAGE", tmp_path / "package")
    assert restored(resume).step == 0


@pytest.mark.parametrize("damage", [lambda content: content[: len(content) // 2], lambda content: b"", lambda _: b"no"])
def test_a_damaged_file_is_one_line_and_a_new_start(
    tmp_path: Path, damage: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    resume = interrupted(tmp_path / "p", "a")
    capsys.readouterr()
    resume.path.write_bytes(damage(resume.path.read_bytes()))
    assert restored(resume).step == 0
    assert capsys.readouterr().err == "p: is damaged; training restarts\n"


def test_partial_file_does_not_replace_the_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resume = interrupted(tmp_path / "p", "a")
    task = Noisy()

    def full(*_: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(OSError, match="no space"):
        resume.keep(
            TrainingState(40), task.module, torch.optim.AdamW(task.module.parameters()), np.random.default_rng(0)
        )
    monkeypatch.undo()
    assert restored(resume).step == 20
    assert [path.name for path in tmp_path.iterdir()] == ["p"]
