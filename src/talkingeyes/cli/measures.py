"""`talkingeyes evaluate`: motion measured against a corpus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def evaluate(
    motions: Annotated[Path, typer.Argument(metavar="MOTION_DIR", help="Motion files (.npz), named as clips.")],
    reference: Annotated[Path, typer.Option(help="A corpus with true motion.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="A folder to write: new, or empty.")] = None,
    sound: Annotated[Path | None, typer.Option(help="Sounds named as the motions, where they are no clips.")] = None,
    truth: Annotated[Path | None, typer.Option(help="Motion in the place of the corpus's true motion.")] = None,
    evaluators: Annotated[
        Path | None, typer.Option(help="The data folder of a finished chain: adds Corr. and what needs its networks.")
    ] = None,
    n_resamples: Annotated[int, typer.Option(help="Resamples of the clips for the intervals.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the resamples.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Replace the output of an earlier call.")] = False,
) -> None:
    """Measure motions against a corpus: saccades, looking, eyes and head, blinks, movement, with intervals."""
    from talkingeyes.workflows.evaluate import describe
    from talkingeyes.workflows.evaluate import evaluate as measure

    found = measure(
        motions,
        reference,
        out,
        sound=sound,
        truth=truth,
        evaluators=evaluators,
        n_resamples=n_resamples,
        seed=seed,
        jobs=jobs,
        force=force,
    )
    typer.echo(describe(found))
