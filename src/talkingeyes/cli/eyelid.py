"""`talkingeyes eyelid`: lids of a person, from labelled curves (docs/eyelid.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

eyelid = typer.Typer(help="The Eyelid model of a person, from labelled curves.", rich_markup_mode=None)


@eyelid.command()
def fit(
    labels: Annotated[Path, typer.Argument(metavar="LABELS", help="Labelled curves (.json; docs/eyelid.md).")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The model to write (.npz), for --eyelid.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Build the model of a person's lids."""
    from talkingeyes.workflows.eyelid import fit as make

    for line in make(labels, out, force=force):
        typer.echo(line)


@eyelid.command()
def example(
    out: Annotated[Path, typer.Option("-o", "--out", help="The labels to write (.json).")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Write labels of the open head: an example of the format."""
    from talkingeyes.workflows.eyelid import write_example

    postures = write_example(out, force=force)
    typer.echo(f"{out}: {postures} postures of both eyes, seen by three cameras")
