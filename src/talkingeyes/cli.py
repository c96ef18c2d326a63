"""The command line: every word that follows `talkingeyes`, and the function in commands/ that it calls.

A command is a function there with its options as annotated arguments, and a line here; what it does stands elsewhere.
A mistake is one line on stderr and exit status 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import typer

from talkingeyes.commands import corpora, files, measures, pages, performances, pictures
from talkingeyes.run import shell

COMMANDS: Mapping[str, Callable[..., None]] = {
    "animate": performances.animate,
    "evaluate": measures.evaluate,
    "render": pictures.render,
    "head": pictures.picture_of_head,
    "export": files.export_motion,
    "import": files.import_motions,
    "pack": files.pack,
    "track": corpora.track,
    "view": pages.view,
    "serve": pages.serve,
}

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Speech in; eye gaze, head motion and blinks out.",
)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)
app.add_typer(pages.study, name="study")


def main() -> None:
    """The entry point of the console script."""
    shell(app)


if __name__ == "__main__":
    main()
