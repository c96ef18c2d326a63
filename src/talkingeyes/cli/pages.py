"""`talkingeyes view`, `study` and `serve`: pages on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Host = Annotated[str, typer.Option(help="The address to listen at; anything but 127.0.0.1 lets others in.")]
Port = Annotated[int, typer.Option(help="The port; 0 takes a free one.")]


def view(
    motions: Annotated[
        list[Path], typer.Argument(metavar="MOTION...", help="Motions (.npz), or files of the stage `sample`.")
    ],
    truth: Annotated[Path | None, typer.Option(help="The true motion, to stand beside them.")] = None,
    sound: Annotated[Path | None, typer.Option(help="The speech; else that of MOTION.mp4 beside the first.")] = None,
    words: Annotated[Path | None, typer.Option(help="An annotation (.json) with the words that are said.")] = None,
    corpus: Annotated[
        Path | None, typer.Option(help="A corpus with a clip named as the first motion: its sound, words and truth.")
    ] = None,
    head: Annotated[str, typer.Option(help="anny (the open head) or flame.")] = "anny",
    model: Annotated[Path | None, typer.Option(help="Your own FLAME file, for --head flame.")] = None,
    host: Host = "127.0.0.1",
    port: Port = 8010,
) -> None:
    """Show motions side by side in the browser, in step, with sound, traces, gaze rays and words."""
    from talkingeyes.workflows.view import view as show

    show(
        motions,
        truth=truth,
        sound=sound,
        words=words,
        corpus=corpus,
        head=head,
        model=model,
        host=host,
        port=port,
        on_start=lambda address: typer.echo(f"{address} shows the motions; end with Ctrl-C"),
    )


study = typer.Typer(
    help="Perception studies: films in pairs as a local page, answers, preference rates.", rich_markup_mode=None
)


@study.command("make")
def make_study(
    design: Annotated[
        str,
        typer.Argument(
            metavar="DESIGN",
            help="talkingeyes_table4, probtalk3d_table2, posegan_table4, posegan_shape, eyelid_follow, or a file.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The folder to write: new, or empty.")],
    data: Annotated[Path, typer.Option(help="The data folder of a finished chain.")] = Path("data"),
    corpus: Annotated[Path | None, typer.Option(help="The corpus; else synthesize in the data folder.")] = None,
    condition: Annotated[
        list[str] | None, typer.Option(help="NAME=DIR: motions or films (.mp4) named as clips, for this condition.")
    ] = None,
    without: Annotated[list[str] | None, typer.Option(help="A condition to leave out, with its comparisons.")] = None,
    seed: Annotated[int, typer.Option(help="Of the clips, and of who sees what.")] = 0,
    size: Annotated[int, typer.Option(help="Pixels of the films, 16 to 1080.")] = 384,
    allow_fewer: Annotated[bool, typer.Option("--fewer", help="Take as many clips as there are.")] = False,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier study, answers included.")] = False,
) -> None:
    """Choose clips and draw the films of a study."""
    from talkingeyes.core.errors import InputError
    from talkingeyes.workflows.study import make

    folders = {}
    for each in condition or []:
        name, equals, folder = each.partition("=")
        if not equals:
            raise InputError(f"condition: should be NAME=DIR, got {each!r}")
        folders[name] = folder
    made = make(
        design,
        out,
        data=data,
        corpus=corpus,
        conditions=folders,
        without=without or (),
        seed=seed,
        size=size,
        allow_fewer=allow_fewer,
        jobs=jobs,
        force=force,
    )
    typer.echo(f"{out}: {len(made.films)} films, {len(made.pairs(0))} pairs a participant")


@study.command("run")
def run_study(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A folder that `study make` wrote.")],
    host: Host = "127.0.0.1",
    port: Port = 8020,
) -> None:
    """Show a study to participants and keep their answers, until interrupted."""
    from talkingeyes.workflows.study import run

    run(
        folder,
        host=host,
        port=port,
        on_start=lambda address: typer.echo(f"{address} shows the study; end with Ctrl-C"),
    )


@study.command("results")
def results_of_study(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A folder that `study make` wrote.")],
) -> None:
    """Print the table of the paper; p-values and intervals also go into results.json."""
    from talkingeyes.workflows.study import results

    found = results(folder)
    typer.echo(found.table, nl=False)
    typer.echo(
        f"{found.participant_count} began, {found.finished} finished and count,"
        f" {found.failed} failed the check of attention"
    )


def serve(
    model: Annotated[Path, typer.Option(help="The trained model for files.")] = Path("data/train/talkingeyes"),
    live: Annotated[
        Path | None, typer.Option(help="The model for streams; else talkingeyes_live beside the other, if it is there.")
    ] = None,
    streams: Annotated[int, typer.Option(min=1, max=1000, help="Most streams at once; more are refused.")] = 10,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes that work on streams.")] = 2,
    files: Annotated[int, typer.Option(min=1, max=256, help="Files that are worked on at once.")] = 1,
    seconds: Annotated[float, typer.Option(min=1, max=3600, help="Longest sound of a file.")] = 60.0,
    megabytes: Annotated[int, typer.Option(min=1, max=1024, help="Largest file.")] = 32,
    host: Host = "127.0.0.1",
    port: Port = 8030,
) -> None:
    """Speak, and see the head speak: a page and a service for files and live streams (docs/live.md)."""
    from dataclasses import replace

    from talkingeyes.workflows.serve import LIMITS, run_service

    limits = replace(LIMITS, streams=streams, files=files, max_speech_s=seconds, max_upload_bytes=megabytes << 20)
    run_service(
        model=model,
        live=live,
        host=host,
        port=port,
        limits=limits,
        jobs=jobs,
        on_start=lambda address: typer.echo(f"{address} listens; end with Ctrl-C"),
    )
