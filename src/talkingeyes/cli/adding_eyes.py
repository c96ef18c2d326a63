"""`talkingeyes add-eyes`: our eyes and head in a file of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.cli.conversion import AnimationName, Joints
from talkingeyes.cli.performance_options import (
    BlinkLiveliness,
    Blinks,
    Emotion,
    EyeContact,
    GazeLiveliness,
    HeadLiveliness,
    Intensity,
    ModelFile,
    Partner,
    Population,
    Seed,
    States,
    Style,
    Target,
)


def add_eyes(
    face: Annotated[
        Path,
        typer.Argument(
            metavar="FACE",
            help="Face motion of another program: ARKit or Live Link CSV, Audio2Face JSON, GLB, VRMA, FLAME npz.",
        ),
    ],
    speech: Annotated[Path, typer.Argument(metavar="SPEECH", help="The speech that the face says.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The file to write, with the ending of FACE.")],
    keep_head: Annotated[
        bool, typer.Option("--keep-head", help="Keep the head of the file; the eyes move on it.")
    ] = False,
    blend: Annotated[
        float, typer.Option(help="Share of ours in channels that the file has: 0 keeps them, 1 replaces them.")
    ] = 1.0,
    seed: Seed = 0,
    fps: Annotated[float | None, typer.Option(help="Frames per second of a file that does not state it.")] = None,
    eyes: Annotated[
        str | None,
        typer.Option(help="Forward axes of the eyes in the file: visual or optical. Default: as the format has them."),
    ] = None,
    joint: Joints = None,
    animation: AnimationName = None,
    blinks: Blinks = "physiological",
    target: Target = None,
    eye_contact: EyeContact = None,
    head_liveliness: HeadLiveliness = 1.0,
    gaze_liveliness: GazeLiveliness = 1.0,
    blink_liveliness: BlinkLiveliness = 1.0,
    partner: Partner = None,
    population: Population = "face_to_face",
    states: States = None,
    person: Annotated[
        str | None, typer.Option(help="Training speaker to imitate. Default: a random one, set by the seed.")
    ] = None,
    style: Style = None,
    emotion: Emotion = "neutral",
    intensity: Intensity = None,
    model: ModelFile = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Put eyes, lids and head motion for SPEECH into a copy of a face that already speaks (docs/add_eyes.md)."""
    from talkingeyes.animation.model_file import find_model, model_title
    from talkingeyes.formats.joint_names import parse_joints
    from talkingeyes.workflows.add_eyes import add_eyes as add
    from talkingeyes.workflows.direct import make_controls

    controls = make_controls(
        blinks=blinks,
        target=target,
        eye_contact=eye_contact,
        head=head_liveliness,
        gaze=gaze_liveliness,
        blinking=blink_liveliness,
        partner=partner,
        population=population,
        states=states,
        person=person,
        style=style,
        emotion=emotion,
        intensity=intensity,
    )
    done = add(
        face,
        speech,
        out,
        seed=seed,
        fps=fps,
        model=model,
        controls=controls,
        keep_head=keep_head,
        blend=blend,
        eyes=eyes,
        joints=parse_joints(joint or ()),
        animation=animation,
        force=force,
    )
    motion = done.animation.motion
    typer.echo(
        f"{out}: {done.format}, {motion.seconds:.2f} s at {motion.fps:g} fps, "
        f"{len(done.events.saccades)} saccades, {len(done.events.blinks)} blinks by {model_title(find_model(model))}"
    )
    for note in done.notes:
        typer.echo(f"{out}: note: {note}", err=True)
