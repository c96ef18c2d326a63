"""The stages as commands. One thread per process and no telemetry, set before heavy packages are imported."""

import os
import signal
import sys

from talkingeyes.orchestration.run import configure_environment


def _interrupted(*_: object) -> None:
    os.write(sys.stderr.fileno(), b"interrupted\n")
    os._exit(130)


configure_environment()
if sys.argv[0] == "-m":  # a stage that is being imported, until `run_command`: nothing is written yet
    signal.signal(signal.SIGINT, _interrupted)
