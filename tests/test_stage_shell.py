"""The stage shell: errors, exit status, complete outputs."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.orchestration import run
from talkingeyes.orchestration.mlflow_logging import Report
from talkingeyes.orchestration.run import Workspace, main, run_command


def fails(error):
    def command():
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (InputError("fit.steps: wrong"), 2, "error: fit.steps: wrong\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "data/x"),
            2,
            "error: data/x: cannot be read or written (No space left on device)\n",
        ),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_user_error_is_one_line(error, status, line, capsys):
    with pytest.raises(SystemExit) as stop:
        run_command(fails(error))
    assert stop.value.code == status
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("error", [ZeroDivisionError(), OSError(errno.EBADF, "Bad file descriptor")])
def test_other_errors_keep_their_trace(error):
    with pytest.raises(type(error)):
        run_command(fails(error))


def test_only_the_report_of_a_release_reads_a_sealed_corpus(tmp_path):
    (tmp_path / run.SEAL).touch()
    with pytest.raises(InputError, match="is sealed for the reports of releases"):
        _ = Workspace(tmp_path, {"corpus": "."}).corpus
    assert Workspace(tmp_path, {"corpus": "."}, may_read_sealed=True).corpus == tmp_path


def test_the_environment_sets_the_number_of_processes(tmp_path, monkeypatch):
    workspace = Workspace(tmp_path, {"machine": {"jobs": 2}})
    assert workspace.jobs == 2
    monkeypatch.setenv("TALKINGEYES_JOBS", "1")
    assert workspace.jobs == 1
    monkeypatch.setenv("TALKINGEYES_JOBS", "0")
    with pytest.raises(InputError, match="TALKINGEYES_JOBS: should be a number of processes, got '0'"):
        _ = workspace.jobs


def a_stage(workspace, name):
    return Report()


def test_stage_without_item_is_an_error(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text("corpus: data/synthesize\n")
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as stop:
        main(a_stage)
    assert stop.value.code == 2
    assert capsys.readouterr().err == "error: test_stage_shell: should get name, got none\n"


@pytest.mark.parametrize("text", [None, "[1, 2]", "a: b: c"])
def test_a_workspace_needs_its_params(tmp_path, text):
    if text is not None:
        (tmp_path / "params.yaml").write_text(text)
    with pytest.raises(InputError, match="make params"):
        Workspace.open(tmp_path)


def test_output_is_atomic(tmp_path):
    workspace = Workspace(tmp_path, {})
    with workspace.output("fit") as folder:
        (folder / "a").write_text("old")
        assert not workspace.data("fit").exists()
    with pytest.raises(KeyboardInterrupt), workspace.output("fit") as folder:
        (folder / "a").write_text("half")
        raise KeyboardInterrupt
    assert [path.name for path in workspace.data().iterdir()] == ["fit"]
    assert workspace.data("fit", "a").read_text() == "old"


def test_an_output_has_one_writer(tmp_path):
    workspace = Workspace(tmp_path, {})
    with workspace.output("train") as folder:
        (folder / "x").write_text("1")
        with pytest.raises(InputError, match="another process is writing this output"), workspace.output("train"):
            pass
    assert (tmp_path / "data/train/x").read_text() == "1"
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["train"]


def test_an_output_lists_its_files_as_sha256sum_does(tmp_path):
    workspace = Workspace(tmp_path, {})
    with workspace.output("fit") as folder:
        (folder / "b").mkdir()
        (folder / "b" / "c").write_bytes(b"x" * 1000)
        (folder / "a").write_bytes(b"")
    check = subprocess.run(
        ["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=workspace.data("fit"), check=True, capture_output=True
    )
    assert check.stdout == b"a: OK\nb/c: OK\n"


def square(number):
    return number**2


def test_each_keeps_order_whatever_the_number_of_jobs():
    assert list(run.parallel_map(square, range(20), 2, "square")) == list(
        run.parallel_map(square, range(20), 1, "square")
    )


def dies(number):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_worker_is_one_line():
    with pytest.raises(InputError, match="squares: a process was killed"):
        list(run.parallel_map(dies, range(4), 2, "squares"))


def test_ctrl_c_while_a_stage_is_imported_is_one_line(repository, tmp_path):
    """Its module interrupts instead of importing torch."""
    (tmp_path / "torch.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(repository)])}
    command = [sys.executable, "-m", "pipelines.pretrain", "codes"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")
