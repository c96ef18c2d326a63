"""`talkingeyes export`, `import` and `pack`: motion to and from other programs, and models as single files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.cli.head_options import Eyelid, Look

Joints = Annotated[
    list[str] | None,
    typer.Option(
        "--joint",
        metavar="JOINT=NAME",
        help="Name of a joint of a GLB: left_eye, right_eye, head, neck or jaw; repeatable. Default: found by name.",
    ),
]

AnimationName = Annotated[
    str | None,
    typer.Option("--animation", help="Name of an animation of a GLB. Default: the first that moves the face."),
]


def export_motion(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="A motion (.npz).")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The file to write.")],
    format: Annotated[
        str | None,
        typer.Option(
            "-f",
            "--format",
            help="flame, vhap, diffposetalk, livelink, arkit, glb, vrm, usd, vocaset, obj, ply, bvh, events or mp4.",
        ),
    ] = None,
    head: Annotated[
        str,
        typer.Option(
            help="Head of glb, usd, vocaset, obj, ply, mp4: anny (the open head) or flame; of ply and mp4, gaussians."
        ),
    ] = "anny",
    model: Annotated[
        Path | None,
        typer.Option(
            help="Your FLAME file: for --head flame, where a face must be retargeted, and for blinks of vhap; "
            "the folder of an avatar, for --head gaussians."
        ),
    ] = None,
    eyelid: Eyelid = None,
    look: Look = None,
    fps: Annotated[
        float | None, typer.Option(help="Frame rate of the output, 10 to 240. Default: that of the motion.")
    ] = None,
    eyes: Annotated[
        str,
        typer.Option(
            help="Forward axes of the eyes: visual (lines of sight, for avatars) or optical (for photographs)."
        ),
    ] = "visual",
    keys: Annotated[Path | None, typer.Option(help="Edited saccades and blinks (.events.json).")] = None,
    sound: Annotated[Path | None, typer.Option(help="The speech, for mp4.")] = None,
    frame: Annotated[int | None, typer.Option(help="Frame of obj and ply, from 0. Default: the first.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Write a motion for other programs (docs/formats.md)."""
    from talkingeyes.workflows.convert import export, format_of

    format = format or format_of(out)
    done = export(
        motion,
        out,
        format=format,
        head=head,
        model=model,
        eyelid=eyelid,
        look=look,
        fps=fps,
        eyes=eyes,
        keys=keys,
        sound=sound,
        frame=frame,
        force=force,
    )
    typer.echo(f"{out}: {format}, {done.seconds:.2f} s at {done.fps:g} fps")
    if format == "vhap" and model is None and done.lid.any():
        typer.echo(f"{out}: note: lids are in eyelids alone; --model moves them by the expression, too", err=True)


def import_motions(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Files of VHAP, metrical-tracker, OpenFace, Live Link, ..., or folders."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="NAME.npz, or a folder: new, or empty.")],
    mapping: Annotated[
        Path | None, typer.Option("--map", help="Meaning of the arrays of an npy or npz (YAML; docs/formats.md).")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frames per second of files that do not state it.")] = None,
    eyes: Annotated[
        str | None,
        typer.Option(help="Forward axes of the eyes in the files: visual or optical. Default: as the format has them."),
    ] = None,
    joint: Joints = None,
    animation: AnimationName = None,
    expression: Annotated[bool, typer.Option(help="Keep jaw and expression.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Read motion of other programs, so that it can be evaluated and rendered here."""
    from talkingeyes.formats.joint_names import parse_joints
    from talkingeyes.workflows.convert import import_files

    joints = parse_joints(joint or ())
    for done in import_files(
        files,
        out,
        fps=fps,
        mapping=mapping,
        eyes=eyes,
        joints=joints,
        animation=animation,
        expression=expression,
        force=force,
    ):
        motion = done.read.motion
        typer.echo(f"{done.name}: {done.read.format}, {motion.seconds:.2f} s at {motion.fps:g} fps")
        for note in done.read.notes:
            typer.echo(f"{done.name}: note: {note}", err=True)


def pack(
    models: Annotated[
        list[Path],
        typer.Argument(metavar="MODEL_DIR...", help="Folders of the train stage; `--model` means the first."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The file to write (.safetensors).")],
    face: Annotated[bool, typer.Option(help="Include the face model beside a single model.")] = True,
    half_precision: Annotated[
        bool, typer.Option("--half-precision", help="Store the weights in 16 bits: half the size.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Put trained models into one file, for `--model FILE` on another machine."""
    from talkingeyes.workflows.pack import pack as make

    done = make(models, out, face=face, half_precision=half_precision, force=force)
    typer.echo(f"{out}: {', '.join(done.models)}, {done.size_bytes / 1e6:.1f} MB")
    for note in done.notes:
        typer.echo(f"{out}: note: {note}", err=True)
