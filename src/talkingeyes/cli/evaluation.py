"""`talkingeyes evaluate` and `benchmark-corpus`: compare motion with a corpus, such as that of the package."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.core.errors import InputError


def _print_schema(wanted: bool) -> bool:
    if wanted:
        from talkingeyes.evaluation.benchmark.registry import json_schema

        typer.echo(json.dumps(json_schema(), indent=1))
        raise typer.Exit
    return wanted


def evaluate(
    motions: Annotated[Path, typer.Argument(metavar="MOTION_DIR", help="Motion files (.npz), named as clips.")],
    reference: Annotated[Path | None, typer.Option(help="A corpus with true motion.")] = None,
    people: Annotated[
        Path | None, typer.Option(help="Table of recorded people (CSV): compare gaze with them instead of the corpus.")
    ] = None,
    turns: Annotated[
        Path | None,
        typer.Option(help="Table of who speaks (CSV), with --people a table of looks at the partner: compare timing."),
    ] = None,
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
    schema: Annotated[
        bool,
        typer.Option(
            "--schema", help="Print the JSON Schema of benchmark.json.", is_eager=True, callback=_print_schema
        ),
    ] = False,
) -> None:
    """Compare motions with a corpus (--reference) or recorded people (--people), with confidence intervals."""
    if people is not None:
        given = [name for name, value in (("--truth", truth), ("--evaluators", evaluators)) if value is not None]
        if given:
            raise InputError(f"{' and '.join(given)}: should not be given with --people")
        if turns is not None:
            from talkingeyes.workflows.evaluate_timing import evaluate_timing, timing_text

            timing = evaluate_timing(
                motions,
                people,
                turns,
                out,
                reference=reference,
                sound=sound,
                n_resamples=n_resamples,
                seed=seed,
                force=force,
            )
            typer.echo(timing_text(timing))
            return
        from talkingeyes.workflows.evaluate_people import evaluate_people, people_text

        found = evaluate_people(
            motions, people, out, reference=reference, sound=sound, n_resamples=n_resamples, seed=seed, force=force
        )
        typer.echo(people_text(found))
        return
    if turns is not None:
        raise InputError("--turns: should come with --people, the table of looks at the partner, got none")
    if reference is None:
        raise InputError(
            "evaluate: needs --reference CORPUS (`talkingeyes benchmark-corpus CORPUS` writes one), or --people DATA"
        )
    from talkingeyes.workflows.evaluate import benchmark_text
    from talkingeyes.workflows.evaluate import evaluate as measure

    measured = measure(
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
    typer.echo(benchmark_text(measured))


def benchmark_corpus(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="A folder to write: new, or empty.")],
) -> None:
    """Write the corpus that comes with the package: sounds to animate, and their true motion for `evaluate`."""
    from talkingeyes.corpus.packed import PACKAGED, unpack_corpus

    clips = unpack_corpus(PACKAGED, out).clips
    typer.echo(f"{out}: {len({clip.sound for clip in clips})} sounds in speech/, {len(clips)} true motions")
