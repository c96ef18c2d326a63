"""Runs a program of the docs with smaller settings: python docs_program.py BIN PROGRAM WORDS... runs BIN/PROGRAM.

SMALL has the changes: commands that take minutes or hours get the settings of `experiment=tiny`. SERVERS run until they
answer and are then interrupted, unless a port is given. Other commands run unchanged.
tests/test_docs_run.py puts this program on the path.
"""

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.request

FINE_TUNED = r"model.\3"
FEW = "{0}.loop.steps=4 {0}.loop.validate_every=2"
STEPS = FEW + " {0}.loop.batch=4"
# Parts of a command line and their replacements; all that match are applied, in this order.
SUBSTITUTIONS = [
    (r"^(python -m pipelines\.params\b.*)", r"\1 experiment=tiny"),
    (r"^(python -m pipelines\.experiment -m\b.*)", r"\1 experiment=smoke_test"),
    (r"^(python -m pipelines\.experiment .*\bsweep=.*)", r"\1 hydra.sweeper.n_trials=2"),
    (r"^(python -m pipelines\.experiment(?!.*\bexperiment=).*)", r"\1 experiment=tiny workspace=build/experiment"),
    (
        r"^(python -m pipelines\.experiment .*\bsweep=loss_weights\b.*)",
        rf"\1 {STEPS.format('pretrain.gaze_frames')} {STEPS.format('model.talkingeyes_paper')}",
    ),
    (r"\bexperiment=posegan\b", "experiment=posegan_tiny workspace=build/posegan"),
    (r"^(python -m pipelines\.results\.posegan_table) --seeds [0-9,]+", r"\1 --seeds 0 experiment=posegan_tiny"),
    (
        r"\bexperiment=probtalk3d_table\b",
        f"experiment=[probtalk3d_table,tiny] {STEPS.format('pretrain.face_vae')} {STEPS.format('model.face_vae')}",
    ),
    (r"^python -m pytest -n 2( --maxfail 10)?( -m .*)?$", "python -m pytest -n 0 -q tests/test_layers.py"),
    (r"^(talkingeyes animate (?=.*two_cities\.wav).*)", r"\1 --no-previews"),
    (r"^(talkingeyes animate (?!.*--samples).*)", r"\1 --samples 1"),
    (r"^(talkingeyes study make .*)", r"\1 --allow-fewer --size 64 --condition ours=ONE_CLIP"),
    (
        r"^(talkingeyes study make eyelid_follow .*)--corpus build/corpus (.*)--condition ours=ONE_CLIP",
        r"\1\2--condition following=ONE_CLIP --condition static=ONE_CLIP",
    ),
    (r"^(talkingeyes .*)--jobs 8", r"\1--jobs 2"),
    (r"^(talkingeyes (?:export|pack) .*)", r"\1 --force"),  # two pages write the same file
    (r"^(talkingeyes animate .*--(?:person|style) )s0004\b", r"\1s0000"),  # speakers of the tiny corpus
    (r"^(talkingeyes animate .*),s0008\b", r"\1,s0001"),
    (
        r"^(python -m pipelines\.experiment) experiment=wav2vec2_finetuning machine=gpu "
        r"(.*\bmodel\.(\w+)\.(\S+)\.checkpoint.*)",
        rf"\1 experiment=[wav2vec2_finetuning,tiny] workspace=build/experiment \2 model.\3.\4.trainable_layers=1"
        rf" {FEW.format('pretrain.gaze_literal')} {FEW.format(FINE_TUNED)} {FINE_TUNED}.validation_clips=2",
    ),
    (r"^(python -m pipelines\.experiment .*\bobjective\.metrics=.*)", r"\1 objective.model=talkingeyes_events"),
    (r"^(python -m pipelines\.results\.detectors)$", r"\1 4"),
]
# A server with a port is used by the next lines and ended by them; `make ui` gives MLflow its port. `view --page` ends.
SERVERS = r"^(talkingeyes (view|serve|study run)\b(?!.*--(port|page))|mlflow ui\b)"
TIMEOUT_S = 120


def shortened(line: str) -> str:
    """The command line that is run instead of this one."""
    for pattern, instead in SUBSTITUTIONS:
        line = re.sub(pattern, instead, line)
    return line


def run_server(words: list[str]) -> int:
    """Run a server on a free port until its page answers, then interrupt it. Returns 0 if it answered."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen([*words, "--port", str(port)], start_new_session=True)
    answered, until = False, time.monotonic() + TIMEOUT_S
    while not answered and server.poll() is None and time.monotonic() < until:
        time.sleep(0.2)
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5) as page:
                answered = page.status == 200
        except OSError:
            continue
    for sign in (signal.SIGINT, signal.SIGKILL):
        if server.poll() is None:
            os.killpg(server.pid, sign)
            try:
                server.wait(20)
            except subprocess.TimeoutExpired:
                continue
    return 0 if answered else 1


def main() -> None:
    """Run the program given by the arguments."""
    programs, name, *given = sys.argv[1:]
    line = shlex.join([name, *given])
    words = shlex.split(shortened(line))
    words[0] = os.path.join(programs, name)
    if re.match(SERVERS, line):
        sys.exit(run_server(words))
    os.execv(words[0], words)


if __name__ == "__main__":
    main()
