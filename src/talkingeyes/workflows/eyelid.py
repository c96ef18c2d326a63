"""`talkingeyes eyelid`: the Eyelid model of a person from labelled curves, and an example of such labels."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from talkingeyes.core.atomic_file import atomic_write, writing
from talkingeyes.head.eyelid.example_labels import example_labels
from talkingeyes.head.eyelid.labels import load_labels
from talkingeyes.head.eyelid.person import SIDES, fit_person
from talkingeyes.workflows.render import check_output_file


def fit(labels: Path, out: Path, *, force: bool = False) -> Iterator[str]:
    """Build the model of both eyes from a file of labels; yields a line per eye. Raises InputError (one line)."""
    target = check_output_file(out, ".npz", force)
    read = load_labels(labels)
    person, variances = fit_person(read)
    with writing(out):
        person.save(target)
    for side, eye, variance in zip(SIDES, person.eyes, variances, strict=True):
        one, rest, both = variance.stage_one, variance.of_residual, variance.both_stages
        yield (
            f"{side}: {len(read.postures)} postures, iris radius {1000 * eye.iris_radius_m:.2f} mm; "
            f"variance explained: {one:.3f} by gaze, {rest:.3f} of the rest, {both:.3f} in all"
        )


def write_example(out: Path, *, force: bool = False) -> int:
    """Write labels of the open head; returns the number of postures. Raises InputError (one line)."""
    target = check_output_file(out, ".json", force)
    content = example_labels()
    head = ",\n".join(f'"{key}": {json.dumps(content[key])}' for key in ("schema", "cameras"))
    postures = ",\n".join(json.dumps(posture) for posture in content["postures"])
    with writing(out), atomic_write(target) as partial:
        partial.write_text(f'{{{head},\n"postures": [\n{postures}\n]}}\n')
    return len(content["postures"])
