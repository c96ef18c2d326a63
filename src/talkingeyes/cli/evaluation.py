"""`talkingeyes evaluate`: compare motion with a corpus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def evaluate(
    motions: Annotated[Path, typer.Argument(metavar="MOTION_DIR", help="Motion files (.npz), named as clips.")],
    reference: Annotated[Path, typer.Option(help="A corpus with true motion.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="A folder to write: new, or empty.")] = None,
    sound: Annotated[
        Path | None, typer.Option(help="Folder of sounds named as the motions, if these are not clips of the corpus.")
    ] = None,
    truth: Annotated[Path | None, typer.Option(help="Motion to use instead of the true motion of the corpus.")] = None,
    evaluators: Annotated[
        Path | None,
        typer.Option(help="Data folder of a finished pipeline: adds Corr. and all metrics that need its networks."),
    ] = None,
    n_resamples: Annotated[int, typer.Option(help="Bootstrap resamples for the intervals.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of the resamples.")] = 0,
    jobs: Annotated[int, typer.Option(help="Number of processes.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the output of an earlier run.")] = False,
) -> None:
    """Compare motions with a corpus: saccades, gaze, eyes and head, blinks, movement, with confidence intervals."""
    from talkingeyes.workflows.evaluate import benchmark_text
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
    typer.echo(benchmark_text(found))
