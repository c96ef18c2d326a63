"""What all tests share: one thread, no telemetry, no display, examples of hypothesis that repeat."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

from talkingeyes.run import quiet

quiet()
os.environ["MPLBACKEND"] = "Agg"
os.environ["HF_HUB_OFFLINE"] = "1"

settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the repository."""
    return Path(__file__).resolve().parents[1]
