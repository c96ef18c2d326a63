"""Labelled curves of a person's eyes: the file that `talkingeyes eyelid fit` reads (docs/eyelid.md).

Elisei, Bailly & Casari (AVSP 2007), section 4.1: iris, upper and lower lid and the eyelid's anchor under the brow,
outlined in one to three views of each posture. Here a curve is a list of image points. Points of different views need
not correspond; lids run from the inner to the outer corner, which do.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
import yaml
from pydantic import Field, model_validator

from talkingeyes.core.containers import parse_json, read_text
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.head.calibrated_camera import CalibratedCamera, Point, Vector

SCHEMA = "talkingeyes.eyelid_labels/1"
MIN_LID_POINTS, MIN_IRIS_POINTS = 4, 5

Curve = Annotated[list[Point], Field(min_length=MIN_LID_POINTS, max_length=1000)]
Contour = Annotated[list[Point], Field(min_length=MIN_IRIS_POINTS, max_length=1000)]


class EyeCurves(Settings):
    """The curves of one eye in one image, points (x, y) in pixels; `iris` is null where the eye is shut.

    `upper`, `lower` and `anchor` run from the inner (nasal) to the outer end; `iris` is the visible part of the circle.
    """

    iris: Contour | None = None
    upper: Curve
    lower: Curve
    anchor: Curve


class LabelledView(Settings):
    """The curves of both eyes in the image of one camera: its index in `cameras`."""

    camera: Annotated[int, Field(ge=0)]
    left: EyeCurves
    right: EyeCurves


class LabelledPosture(Settings):
    """One posture: a gaze `held` with open eyes, `shut` eyes, or any of `speech`; the pose of the head, and its views.

    A point p of the head is at R p + t in the scene; without a pose, cameras are given in head coordinates.
    """

    name: str = ""
    kind: Literal["held", "shut", "speech"]
    rotation: Vector = (0.0, 0.0, 0.0)
    translation_m: Vector = (0.0, 0.0, 0.0)
    views: Annotated[list[LabelledView], Field(min_length=1, max_length=3)]

    @model_validator(mode="after")
    def _irises_are_seen(self) -> LabelledPosture:
        for side in ("left", "right"):
            if self.kind != "shut" and not any(getattr(view, side).iris for view in self.views):
                raise bounds_error(f"the {side} iris should be labelled in a view, or kind be shut", self.kind)
        return self


class EyelidLabels(Settings):
    """A file of labelled postures."""

    schema_: Literal["talkingeyes.eyelid_labels/1"] = Field(alias="schema")
    cameras: Annotated[list[CalibratedCamera], Field(min_length=1)]
    postures: Annotated[list[LabelledPosture], Field(min_length=1, max_length=1000)]


def load_labels(path: Path) -> EyelidLabels:
    """Read a file of labels. Raises InputError: one line with the line of the file, what it should be, and what is."""
    text = read_text(path, "file of labelled curves")
    try:
        labels = EyelidLabels.model_validate(parse_json(text))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}: not JSON ({error.msg})") from None
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        asked = first["msg"] if first["type"] in ("bounds", "missing") else f"{first['msg']}, got {first['input']!r}"
        raise _error(path, text, first["loc"], asked) from None
    except ValueError as error:
        raise InputError(f"{path}: not a file of labelled curves ({error})") from None
    for number, posture in enumerate(labels.postures):
        for index, view in enumerate(posture.views):
            if view.camera >= len(labels.cameras):
                place = ("postures", number, "views", index, "camera")
                raise _error(path, text, place, f"should be below {len(labels.cameras)}, got {view.camera}")
    return labels


def _error(path: Path, text: str, place: Sequence[str | int], said: str) -> InputError:
    """The error at a place of the content, with its line: JSON is YAML, whose parser knows the lines."""
    keys = ".".join(str(step) for step in place) or "the file"
    try:
        node: Any = yaml.compose(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.YAMLError:  # some escapes of JSON are none of YAML
        return InputError(f"{path}: {keys}: {said}")
    for step in place:
        if isinstance(node, yaml.MappingNode):
            found = next((value for key, value in node.value if key.value == step), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
            found = node.value[step] if step < len(node.value) else None
        else:
            found = None
        if found is None:
            break
        node = found
    return InputError(f"{path}:{node.start_mark.line + 1}: {keys}: {said}")
