"""Options of a performance, which `animate` and `add-eyes` share (docs/control.md)."""

from pathlib import Path
from typing import Annotated

import typer

Seed = Annotated[int, typer.Option(help="The same seed gives the same motions.")]
Blinks = Annotated[str, typer.Option(help="Blink rate profile: physiological, paper or corpus.")]
Target = Annotated[
    str | None, typer.Option(help="Gaze target: camera, listener, or a track (.json, .csv; docs/control.md).")
]
EyeContact = Annotated[float | None, typer.Option(help="Fraction of time with eye contact, 0 to 1.")]
HeadLiveliness = Annotated[float, typer.Option(help="Scale of head motion: 0 none, 1 as sampled, 2 double.")]
GazeLiveliness = Annotated[float, typer.Option(help="Scale of gaze: 0 none, 1 as sampled, 2 double.")]
BlinkLiveliness = Annotated[float, typer.Option(help="Scale of the blink rate: 0 none, 1 as in the profile, 2 double.")]
Partner = Annotated[Path | None, typer.Option(help="The sound of the conversation partner, synchronous.")]
Population = Annotated[str, typer.Option(help="Gaze while the partner speaks: face_to_face or remote_call.")]
States = Annotated[
    str | None, typer.Option(help="States of the speaker: auto, or a track (.json, .csv; docs/control.md).")
]
Style = Annotated[str | None, typer.Option(help="Motion style: a speaker of the model, or a motion (.npz).")]
Emotion = Annotated[
    str,
    typer.Option(
        help="Emotion of face and blinks, and of head and gaze if their model knows it: neutral, happy, sad, "
        "surprised, fear, disgusted, angry or contempt."
    ),
]
Intensity = Annotated[int | None, typer.Option(help="Intensity of the emotion: 1, 2 or 3.")]
ModelFile = Annotated[
    Path | None,
    typer.Option(
        help="A model: a folder of the train stage, a file of `pack`, or talkingeyes_remote_call (packaged: gaze of "
        "people in remote calls). Default: data/train/talkingeyes_events (of `make repro`), else the packaged one."
    ),
]
