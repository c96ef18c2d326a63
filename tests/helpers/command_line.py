"""The command line in the process of the tests."""

from __future__ import annotations

import sys
from functools import cache

import pytest
import typer.main

from talkingeyes.cli import main as cli

get_command = cache(typer.main.get_command)  # it takes 0.2 s to build all commands


def call(*words: object) -> int:
    """Exit status of `talkingeyes` with these words."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as left:
        patch.setattr(sys, "argv", ["talkingeyes", *map(str, words)])
        patch.setattr(typer.main, "get_command", get_command)
        cli.main()
    return int(left.value.code or 0)
