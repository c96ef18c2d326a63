"""The stages as commands. One thread a process and no telemetry, set before anything heavy is imported."""

from talkingeyes.orchestration.run import configure_environment

configure_environment()
