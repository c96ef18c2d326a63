"""The command line: `talkingeyes animate`, `evaluate`, `render`, `head`, `export`, `import`, `track`.

A mistake is one line on stderr and exit status 2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.run import shell

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Speech in; eye gaze, head motion and blinks out.",
)


@app.callback()
def _talkingeyes() -> None:
    """Keeps `animate` a word of its own, beside the commands to come."""


@app.command()
def animate(
    speech: Annotated[
        Path, typer.Argument(metavar="SPEECH", help="A sound file: wav, flac, ogg, mp3, m4a; 0.3 s to an hour.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The folder to write: new, or empty.")],
    samples: Annotated[int, typer.Option(help="How many motions to draw for the speech.")] = 3,
    seed: Annotated[int, typer.Option(help="The same seed gives the same motions.")] = 0,
    fps: Annotated[float, typer.Option(help="Frames a second, 10 to 240.")] = 25.0,
    blinks: Annotated[str, typer.Option(help="Rate of blinks: physio, paper or corpus.")] = "physio",
    model: Annotated[Path, typer.Option(help="A trained model; `make repro` makes this one.")] = Path(
        "data/train/talkingeyes"
    ),
    formats: Annotated[
        list[str] | None, typer.Option("-f", "--format", help="Another format for each motion, as `export` has them.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the output of an earlier call.")] = False,
) -> None:
    """Draw motions for speech: npz, events, a small video with sound for each, and a plot of all."""
    from talkingeyes.animation import animate as make

    motions = make(
        speech, out, samples=samples, seed=seed, fps=fps, blinks=blinks, model=model, formats=formats or (), force=force
    )
    count = "1 motion" if samples == 1 else f"{samples} motions"
    typer.echo(f"{out}: {count} of {motions[0].seconds:.2f} s at {fps:g} frames a second")


@app.command()
def evaluate(
    motions: Annotated[Path, typer.Argument(metavar="MOTION_DIR", help="Motion files (.npz), named as clips.")],
    reference: Annotated[Path, typer.Option(help="A corpus with true motion.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="A folder to write: new, or empty.")] = None,
    sound: Annotated[Path | None, typer.Option(help="Sounds named as the motions, where they are no clips.")] = None,
    truth: Annotated[Path | None, typer.Option(help="Motion in the place of the corpus's true motion.")] = None,
    judges: Annotated[
        Path | None, typer.Option(help="The data folder of a finished chain: adds Corr. and what needs its networks.")
    ] = None,
    draws: Annotated[int, typer.Option(help="Resamples of the clips for the intervals.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the resamples.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Replace the output of an earlier call.")] = False,
) -> None:
    """Measure motions against a corpus: saccades, looking, eyes and head, blinks, movement, with intervals."""
    from talkingeyes.evaluation import describe
    from talkingeyes.evaluation import evaluate as measure

    found = measure(
        motions,
        reference,
        out,
        sound=sound,
        truth=truth,
        judges=judges,
        draws=draws,
        seed=seed,
        jobs=jobs,
        force=force,
    )
    typer.echo(describe(found))


@app.command()
def render(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="A motion (.npz), as `animate` writes it.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The film to write (.mp4).")],
    head: Annotated[str, typer.Option(help="anny (the open head) or flame.")] = "anny",
    model: Annotated[Path | None, typer.Option(help="Your own FLAME file, for --head flame.")] = None,
    camera: Annotated[
        str,
        typer.Option(help="head, face, eyes, left or right; or yaw=, pitch= (degrees), distance=, height= (metres)."),
    ] = "head",
    sound: Annotated[Path | None, typer.Option(help="The speech to hear.")] = None,
    size: Annotated[int, typer.Option(help="Pixels, 16 to 4096.")] = 512,
    keys: Annotated[
        Path | None, typer.Option(help="Its saccades and blinks as edited: the file of `export -f events`.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Film a motion on a head, with sound, at the motion's own frame rate."""
    from talkingeyes.film import render as make

    done = make(motion, out, head=head, model=model, camera=camera, sound=sound, size=size, keys=keys, force=force)
    typer.echo(f"{out}: {done.seconds:.2f} s at {done.fps:g} frames a second")


@app.command("head")
def picture_of_head(
    out: Annotated[Path, typer.Option("-o", "--out", help="The picture to write (.png).")],
    head: Annotated[str, typer.Option(help="anny (the open head) or flame.")] = "anny",
    model: Annotated[Path | None, typer.Option(help="Your own FLAME file, for --head flame.")] = None,
    size: Annotated[int, typer.Option(help="Width in pixels.")] = 1400,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Draw a head: gaze in nine directions, lids at five openings."""
    from talkingeyes.film import picture

    picture(out, head=head, model=model, size=size, force=force)
    typer.echo(f"{out}: gaze in nine directions, lids at five openings")


@app.command("export")
def export_motion(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="A motion (.npz).")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The file to write.")],
    format: Annotated[
        str,
        typer.Option(
            "-f",
            "--format",
            help="flame, vhap, diffposetalk, livelink, arkit, glb, vrm, usd, vocaset, bvh, events or mp4.",
        ),
    ],
    head: Annotated[str, typer.Option(help="Of glb, usd, vocaset and mp4: anny (the open head) or flame.")] = "anny",
    model: Annotated[
        Path | None, typer.Option(help="Your own FLAME file: for --head flame, and where a face must be mapped.")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Another frame rate, 10 to 240.")] = None,
    sound: Annotated[Path | None, typer.Option(help="The speech to hear, in mp4.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a motion for other programs (docs/formats.md)."""
    from talkingeyes.conversion import export

    done = export(motion, out, format=format, head=head, model=model, fps=fps, sound=sound, force=force)
    typer.echo(f"{out}: {format}, {done.seconds:.2f} s at {done.fps:g} frames a second")


@app.command("import")
def import_motions(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Files of VHAP, metrical-tracker, OpenFace, Live Link, ..., or folders."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="NAME.npz, or a folder: new, or empty.")],
    mapping: Annotated[
        Path | None, typer.Option("--map", help="What the arrays of an npy or npz mean (YAML; docs/formats.md).")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frames a second, where a file does not say.")] = None,
    expression: Annotated[bool, typer.Option(help="Keep jaw and expression.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
) -> None:
    """Read motion of other programs, so that it can be evaluated and rendered here."""
    from talkingeyes.conversion import read_all

    for done in read_all(files, out, fps=fps, mapping=mapping, expression=expression, force=force):
        motion = done.read.motion
        typer.echo(f"{done.name}: {done.read.format}, {motion.seconds:.2f} s at {motion.fps:g} frames a second")
        for note in done.read.notes:
            typer.echo(f"{done.name}: note: {note}", err=True)


@app.command()
def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO_OR_FOLDER...", help="Videos, or folders of them.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The corpus to write, or to go on with.")],
    speakers: Annotated[Path | None, typer.Option(help="Who speaks: a CSV with the columns video, speaker.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; a video each.")] = 1,
    plan: Annotated[bool, typer.Option("--plan", help="Only say how long it takes and what it writes.")] = False,
    silent: Annotated[bool, typer.Option("--silent", help="Keep clips without a voice too.")] = False,
    thumbnails: Annotated[bool, typer.Option(help="Small pictures of the faces, and a page of them.")] = True,
    overlay: Annotated[bool, typer.Option("--overlay", help="Film the fitted head beside each clip.")] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="A value of conf/track, such as keep.least_s=2.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Begin anew; forget what was tracked before.")] = False,
) -> None:
    """Make a corpus of videos: landmarks, pupils and speech of every clip with one visible, speaking face."""
    from talkingeyes.footage import command

    changes = ["fit=video", *(f"track.{each}" for each in setting or [])]
    changes += ["track.keep.voice=false"] * silent + ["track.thumbnails=false"] * (not thumbnails)
    for line in command(
        videos, out, changes, speakers=speakers, jobs=jobs, only_plan=plan, overlay=overlay, force=force
    ):
        typer.echo(line)


def main() -> None:
    """The entry point of the console script."""
    shell(app)


if __name__ == "__main__":
    main()
