"""`talkingeyes view`, `study` and `serve`: local web pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.cli.head_options import Eyelid, Look

Host = Annotated[str, typer.Option(help="Address to listen on; any but 127.0.0.1 allows access from other machines.")]
Port = Annotated[int, typer.Option(help="Port; 0 selects a free one.")]


def view(
    motions: Annotated[
        list[Path], typer.Argument(metavar="MOTION...", help="Motions (.npz), or files of the stage `sample`.")
    ],
    truth: Annotated[Path | None, typer.Option(help="The true motion, shown beside them.")] = None,
    sound: Annotated[
        Path | None, typer.Option(help="The speech; default: that of MOTION.mp4 beside the first motion.")
    ] = None,
    annotation: Annotated[Path | None, typer.Option(help="An annotation (.json) with the spoken words.")] = None,
    corpus: Annotated[
        Path | None, typer.Option(help="A corpus with a clip named as the first motion: its sound, words and truth.")
    ] = None,
    head: Annotated[str, typer.Option(help="anny (the open head) or flame.")] = "anny",
    model: Annotated[Path | None, typer.Option(help="Your own FLAME file, for --head flame.")] = None,
    eyelid: Eyelid = None,
    look: Look = None,
    page: Annotated[
        Path | None, typer.Option(help="Write a page (.html) that opens without a server, instead of serving one.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing page.")] = False,
    host: Host = "127.0.0.1",
    port: Port = 8010,
) -> None:
    """Play motions side by side in the browser, with sound, traces, gaze rays and words."""
    from talkingeyes.workflows.view import view as show
    from talkingeyes.workflows.view import write_page

    if page is not None:
        write_page(
            motions,
            page,
            truth=truth,
            sound=sound,
            words=annotation,
            corpus=corpus,
            head=head,
            model=model,
            eyelid=eyelid,
            look=look,
            force=force,
        )
        typer.echo(f"{page}: {page.stat().st_size / 1e6:.1f} MB, opens in any browser")
        return
    show(
        motions,
        truth=truth,
        sound=sound,
        words=annotation,
        corpus=corpus,
        head=head,
        model=model,
        eyelid=eyelid,
        look=look,
        host=host,
        port=port,
        on_start=lambda address: typer.echo(f"{address} serves the motions; press Ctrl-C to stop"),
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
    data: Annotated[Path, typer.Option(help="The data folder of a finished pipeline.")] = Path("data"),
    corpus: Annotated[Path | None, typer.Option(help="The corpus; default: synthesize in the data folder.")] = None,
    condition: Annotated[
        list[str] | None, typer.Option(help="NAME=DIR: motions or films (.mp4) named as clips, for this condition.")
    ] = None,
    without: Annotated[list[str] | None, typer.Option(help="A condition to leave out, with its comparisons.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the choice of clips and of the assignment.")] = 0,
    size: Annotated[int, typer.Option(help="Pixels of the films, 16 to 1080.")] = 384,
    allow_fewer: Annotated[
        bool, typer.Option("--allow-fewer", help="Accept fewer clips than the design asks for.")
    ] = False,
    eyelid: Eyelid = None,
    look: Look = None,
    jobs: Annotated[int, typer.Option(help="Number of processes.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier study, answers included.")] = False,
) -> None:
    """Choose clips and render the films of a study."""
    from talkingeyes.core.errors import InputError
    from talkingeyes.workflows.study import make_study

    folders = {}
    for each in condition or []:
        name, equals, folder = each.partition("=")
        if not equals:
            raise InputError(f"condition: should be NAME=DIR, got {each!r}")
        folders[name] = folder
    made = make_study(
        design,
        out,
        data=data,
        corpus=corpus,
        conditions=folders,
        without=without or (),
        seed=seed,
        size=size,
        allow_fewer=allow_fewer,
        eyelid=eyelid,
        look=look,
        jobs=jobs,
        force=force,
    )
    typer.echo(f"{out}: {len(made.films)} films, {len(made.pairs(0))} pairs per participant")


@study.command("run")
def run_study(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A folder that `study make` wrote.")],
    host: Host = "127.0.0.1",
    port: Port = 8020,
) -> None:
    """Serve a study to participants and store their answers, until interrupted."""
    from talkingeyes.workflows.study import run_study

    run_study(
        folder,
        host=host,
        port=port,
        on_start=lambda address: typer.echo(f"{address} serves the study; press Ctrl-C to stop"),
    )


@study.command("results")
def results_of_study(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A folder that `study make` wrote.")],
) -> None:
    """Print the table of the paper; p-values and intervals are also written to results.json."""
    from talkingeyes.workflows.study import study_results

    found = study_results(folder)
    typer.echo(found.table, nl=False)
    typer.echo(
        f"{found.participant_count} started, {found.finished} finished and are counted,"
        f" {found.failed} failed the attention check"
    )


def serve(
    model: Annotated[
        Path | None,
        typer.Option(help="The model for files; default: data/train/talkingeyes_events, else the packaged one."),
    ] = None,
    live_model: Annotated[
        Path | None,
        typer.Option(help="Model for live streams; default: talkingeyes_live beside --model, else the packaged one."),
    ] = None,
    eyelid: Eyelid = None,
    look: Look = None,
    streams: Annotated[
        int, typer.Option(min=1, max=1000, help="Maximum number of concurrent streams; fewer if they would be late.")
    ] = 200,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes for live streams.")] = 2,
    files: Annotated[int, typer.Option(min=1, max=256, help="Files processed at once.")] = 1,
    max_seconds: Annotated[float, typer.Option(min=1, max=3600, help="Maximum duration of a file.")] = 60.0,
    max_megabytes: Annotated[int, typer.Option(min=1, max=1024, help="Maximum size of a file.")] = 32,
    origin: Annotated[
        list[str] | None,
        typer.Option(help="http://HOST:PORT of another server whose pages may open live streams; repeatable."),
    ] = None,
    host: Host = "127.0.0.1",
    port: Port = 8030,
) -> None:
    """Live preview: speak into the microphone and watch the avatar; a service for files and streams (docs/live.md)."""
    from dataclasses import replace

    from talkingeyes.animation.model_file import find_model, model_title, parts_title
    from talkingeyes.workflows.serve import LIMITS, find_live_model, run_service

    def on_start(address: str) -> None:
        files_model = find_model(model)
        used = f"{parts_title(files_model)}, streams: {model_title(find_live_model(files_model, live_model))}"
        typer.echo(f"{address} is ready ({used}); press Ctrl-C to stop")

    limits = replace(
        LIMITS, streams=streams, files=files, max_speech_s=max_seconds, max_upload_bytes=max_megabytes << 20
    )
    run_service(
        model=model,
        live=live_model,
        eyelid=eyelid,
        look=look,
        host=host,
        port=port,
        limits=limits,
        jobs=jobs,
        stream_origins=origin or (),
        on_start=on_start,
    )
