"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Eyelid = Annotated[
    Path | None, typer.Option(help="Lids of a person: a model (.npz) that `talkingeyes eyelid fit` writes.")
]
Look = Annotated[str | None, typer.Option(help="Look of the open head: ada (default), ben or chi.")]
