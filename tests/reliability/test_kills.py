"""Servers that are killed: nothing that they acknowledged is lost, and nothing of them stays."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from test_study import a_study
from toy_model import sound_file

from talkingeyes.apps.study.design import load_design
from talkingeyes.core.atomic_file import temporary_folder

PROGRAM = "from talkingeyes.cli.main import main; main()"


@contextlib.contextmanager
def running(*words: str, temporary: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server, with its address; it is killed at the end, if it still runs."""
    command = [sys.executable, "-c", PROGRAM, *words, "--port", "0"]
    environment = {**os.environ, "TMPDIR": str(temporary)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().split()[0].rstrip("/")
        finally:
            process.kill()


def ask(address: str, content: object = None) -> Any:
    """The JSON that a server answers; bytes are posted as they are."""
    sent = content if isinstance(content, bytes) or content is None else json.dumps(content).encode()
    request = urllib.request.Request(address, sent, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.loads(answer.read())


@pytest.mark.long
def test_answers_that_a_study_accepted_survive_its_end(tmp_path: Path) -> None:
    study = a_study(tmp_path / "study", load_design("eyelid_follow"))
    questions = [each.name for each in load_design("eyelid_follow").questions]
    accepted, token = 0, ""
    for seconds in np.random.default_rng(5).uniform(0.1, 0.5, 4):
        with running("study", "run", str(study.root), temporary=tmp_path) as (server, address):
            token = token or ask(f"{address}/api/begin", b"")["token"]
            place = f"{address}/api/state/{token}"
            threading.Timer(seconds, server.kill).start()
            with contextlib.suppress(OSError, http.client.HTTPException):
                while not (state := ask(place))["done"]:
                    sent = {"trial_index": state["trial_index"], "answers": dict.fromkeys(questions, "left")}
                    accepted = ask(place, sent)["trial_index"]
            server.wait(60)
        (participant,) = study.answers.participants()
        assert accepted <= participant.trial_index <= accepted + 1
        accepted = participant.trial_index
    assert accepted > 2


@pytest.mark.long
def test_workers_and_files_of_a_killed_service_do_not_stay(tmp_path: Path) -> None:
    sound_file(tmp_path / "a.wav", 20.0)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    with running("serve", temporary=temporary) as (server, address):
        workers: list[psutil.Process] = []

        def kill() -> None:
            workers.extend(psutil.Process(server.pid).children(recursive=True))
            server.kill()

        threading.Timer(1.0, kill).start()
        with pytest.raises((OSError, http.client.HTTPException)):
            ask(f"{address}/performances", (tmp_path / "a.wav").read_bytes())
        server.wait(60)
    assert workers and not psutil.wait_procs(workers, timeout=120)[1]
    assert len(list(temporary.iterdir())) == 1
    with running("serve", temporary=temporary) as (server, _):
        server.send_signal(signal.SIGTERM)
        server.wait(120)
    assert not list(temporary.iterdir())


def test_temporary_folders_of_killed_processes_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import os; from talkingeyes.core.atomic_file import temporary_folder\n"
    code += "with temporary_folder() as folder: (folder / 'a').touch(); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "TMPDIR": str(tmp_path)}, check=False)
    (left,) = tmp_path.iterdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with temporary_folder() as own, temporary_folder() as other:
        assert {*tmp_path.iterdir()} == {own, other} and left not in (own, other)
    assert not list(tmp_path.iterdir())
