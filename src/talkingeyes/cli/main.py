"""Entry point of the command line: the commands and their functions.

A command is a function of this package, with its options as annotated arguments, and a line in COMMANDS; its work is in
workflows/. Invalid input prints one line on stderr, with exit status 2.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping

import typer
from typer.exceptions import TyperException

from talkingeyes.cli import adding_eyes, animation, conversion, evaluation, eyelid, rendering, servers, tracking
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.run import run_command

COMMANDS: Mapping[str, Callable[..., None]] = {
    "animate": animation.animate,
    "add-eyes": adding_eyes.add_eyes,
    "evaluate": evaluation.evaluate,
    "benchmark-corpus": evaluation.benchmark_corpus,
    "render": rendering.render,
    "head": rendering.render_head,
    "avatar": rendering.make_avatar,
    "export": conversion.export_motion,
    "import": conversion.import_motions,
    "pack": conversion.pack,
    "track": tracking.track,
    "capture": tracking.capture,
    "view": servers.view,
    "serve": servers.serve,
}

# Libraries that a command can lack in the base installation, and the extra that brings each.
EXTRA_OF_LIBRARY: Mapping[str, str] = {"torch": "torch", "fastapi": "web", "starlette": "web", "uvicorn": "web"}

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Speech in; eye gaze, head motion and blinks out.",
)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)
app.add_typer(servers.study, name="study")
app.add_typer(eyelid.eyelid, name="eyelid")


def main() -> None:
    """Entry point of the console script."""
    run_command(_run)


def _run() -> None:
    """Run the command line; usage errors of typer become one line, too."""
    try:
        status = app(prog_name="talkingeyes", standalone_mode=False)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        where = context.command_path if context else "talkingeyes"
        said = error.format_message() if hasattr(error, "format_message") else str(error)
        raise InputError(f"{said.rstrip('.')} (see `{where} --help`)") from None
    except ModuleNotFoundError as error:
        extra = EXTRA_OF_LIBRARY.get(error.name or "")
        if extra is None:
            raise
        needed = f"pip install 'talkingeyes[{extra}]'"
        raise InputError(f"{error.name}: should be installed for this ({needed}), got none") from None
    except typer.Abort:
        raise KeyboardInterrupt from None
    if status:
        sys.exit(status)


if __name__ == "__main__":
    main()
