"""The stages as commands. One thread per process and no telemetry, set before heavy packages are imported."""

from talkingeyes.orchestration.run import configure_environment

configure_environment()
