"""Training with two processes under torchrun equals that with one; bfloat16; a missing GPU.

Tolerance: the losses of every validation agree to a relative error of 1e-4, weights to a relative or absolute error of
1e-4. The only difference is the order in which float32 numbers are added.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
import torch
import yaml
from test_training import NORMALISER, codebook, loop, translation
from toy import recordings
from toy_training import RUN, toy_training

from pipelines import pretrain
from pipelines import train as train_stage
from talkingeyes.core.errors import InputError
from talkingeyes.models.layers import distributed
from talkingeyes.training.execution import ExecutionContext
from talkingeyes.training.loop import train
from talkingeyes.training.motion_task import MotionTask

STEPS = {"steps": 8, "validate_every": 4, "batch": 4}
TOLERANCE = 1e-4


def torchrun(root: Path, world_size: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(world_size)]
    return subprocess.run([*command, *arguments], cwd=root, capture_output=True, text=True, check=False, timeout=240)


def stage_script(root: Path, stage: str) -> str:
    """A script for torchrun that runs the stage without logging to MLflow."""
    path = root / f"run_{stage}.py"
    path.write_text(RUN.format(stage=stage))
    return str(path)


def result(root: Path, *names: str) -> tuple[list[dict[str, float]], dict[str, np.ndarray]]:
    folder = (root / "data").joinpath(*names)
    return json.loads((folder / "history.json").read_text()), safetensors.numpy.load_file(folder / "model.safetensors")


def assert_agree(one: Path, two: Path, *names: str) -> None:
    (history, weights), (shared_history, shared_weights) = result(one, *names), result(two, *names)
    assert len(history) == len(shared_history) > 0
    for row, shared in zip(history, shared_history, strict=True):
        assert row.keys() == shared.keys()
        for name in row:
            if name.startswith("loss/"):
                assert shared[name] == pytest.approx(row[name], rel=TOLERANCE), name
    for name, value in weights.items():
        np.testing.assert_allclose(shared_weights[name], value, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name)


@pytest.mark.long
def test_two_processes_equal_one_with_dropout_and_sampling(tmp_path: Path) -> None:
    """Covers moving averages and restarts of the codebook, masked means, dropout and sampling of latent codes."""
    one, two = (toy_training(tmp_path / name, dropout=0.1, **STEPS) for name in ("one", "two"))
    pretrain.run(one, "codes")
    train_stage.run(one, "joint")
    for stage, name in (("pretrain", "codes"), ("train", "joint")):
        ended = torchrun(two.root, 2, stage_script(tmp_path, stage), name)
        assert ended.returncode == 0, ended.stderr[-3000:]
        assert_agree(one.root, two.root, stage, name)
    assert sorted(path.name for path in (two.root / "data").iterdir()) == [
        "embed", "fit", "pretrain", "synthesize", "train",
    ]  # fmt: skip


def test_noise_is_that_of_the_whole_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each process has its rows of the noise of a single process; under no_grad all processes have the same noise."""
    rows, modules = torch.ones(6, 5, 7), [torch.nn.Dropout(0.5), torch.nn.Dropout1d(0.5)]

    def drawn(x: torch.Tensor) -> list[torch.Tensor]:
        torch.manual_seed(0)
        made = [module(x) for module in modules]
        made.append(modules[0](x.transpose(1, 2)))  # another memory layout
        return [*made, torch.randn_like(x), torch.rand(len(x)), torch.rand(x.shape[:2]), torch.rand_like(x)]

    whole = drawn(rows)
    monkeypatch.setattr(distributed, "world_size", lambda: 2)
    for rank in (0, 1):
        monkeypatch.setattr(distributed, "rank", lambda rank=rank: rank)
        with distributed.BatchNoiseMode():
            parts = drawn(rows[:3])
            torch.manual_seed(0)
            with torch.no_grad():
                alike = torch.rand(4)
        for part, all_rows in zip(parts, whole, strict=True):
            assert torch.equal(part, all_rows[3 * rank : 3 * rank + 3])
        torch.manual_seed(0)
        assert torch.equal(alike, torch.rand(4))


def test_indivisible_batch_and_unsupported_stage_are_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distributed, "world_size", lambda: 3)
    context = ExecutionContext(torch.device("cpu"), "float32")
    with pytest.raises(InputError, match=r"^loop.batch: should be a multiple of the 3 processes, got 8$"):
        context.distribute(torch.nn.Linear(1, 1), lambda step: {}, 8)
    monkeypatch.setitem(os.environ, "WORLD_SIZE", "3")
    with pytest.raises(InputError, match=r"^torchrun: .*single process.*got 3$"):
        ExecutionContext.single_process({"device": "cpu", "precision": "float32"})


@pytest.mark.long
@pytest.mark.parametrize("kind", ["categorical", "regression", "vae"])
def test_bfloat16_learns_and_keeps_float32_weights(kind: str) -> None:
    book = codebook(kind)
    histories = {}
    for precision in ("float32", "bfloat16"):
        task = MotionTask(
            translation(kind), 0, recordings(4, seed=1, frames=90), recordings(1, seed=2, frames=60), NORMALISER, book
        )
        settings = loop(steps=8, batch=4, validate_every=8)
        histories[precision] = train(
            task, settings, precision, context=ExecutionContext(torch.device("cpu"), precision)
        )
        assert {weight.dtype for weight in task.module.parameters()} == {torch.float32}
    whole, half = (histories[precision][-1]["loss/total"] for precision in ("float32", "bfloat16"))
    assert half == pytest.approx(whole, rel=0.05)
    assert half != whole, "nothing was computed in bfloat16"


@pytest.mark.long
@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a card")
def test_machine_gpu_without_gpu_is_one_line_error(tmp_path: Path) -> None:
    workspace = toy_training(tmp_path, **STEPS)
    params = dict(workspace.params) | {"machine": workspace.params["machine"] | {"device": "cuda"}}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    ended = subprocess.run(
        [sys.executable, "-m", "pipelines.train", "joint"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2
    assert ended.stderr == "error: machine.device: should be cpu or have 1 GPU(s) usable by torch, got cuda with 0\n"


@pytest.mark.gpu
def test_gpu_training_equals_cpu_training(tmp_path: Path) -> None:
    """Equal within the float32 accuracy of different devices; then bfloat16."""
    results: list[Any] = []
    for device, precision in (("cpu", "float32"), ("cuda", "float32"), ("cuda", "bfloat16")):
        workspace = toy_training(tmp_path / f"{device}-{precision}", **STEPS)
        workspace.params["machine"].update(device=device, precision=precision)  # type: ignore[index]
        pretrain.run(workspace, "codes")
        train_stage.run(workspace, "joint")
        results.append(result(workspace.root, "pretrain", "codes")[0][0]["loss/reconstruction"])
    assert results[1] == pytest.approx(results[0], rel=1e-2)
    assert results[2] == pytest.approx(results[0], rel=1e-1)
