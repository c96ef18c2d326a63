"""Retargeting of motion to another head: exact cases, least squares, errors."""

from dataclasses import replace
from pathlib import Path

import flame_file
import numpy as np
import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.head.flame import load_flame
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import expression_shape_names, motion_to_pose
from talkingeyes.head.retarget import expression_map


@pytest.fixture(scope="module")
def flame(tmp_path_factory: pytest.TempPathFactory) -> HeadModel:
    path: Path = tmp_path_factory.mktemp("flame") / "model.pkl"
    flame_file.write(path, flame_file.arrays())
    return load_flame(path)


def performance(head: HeadModel, frames: int = 6) -> Motion:
    """Random expressions of a head, with all other parts moving."""
    rng = np.random.default_rng(3)
    names = expression_shape_names(head)
    return Motion.of(
        25.0,
        rng.normal(0, 0.1, (frames, 3)),
        rng.normal(0, 0.1, (frames, 2, 3)),
        lid=rng.random((frames, 2)),
        jaw=rng.normal(0, 0.1, (frames, 3)),
        translation=rng.normal(0, 0.01, (frames, 3)),
        expression=rng.random((frames, len(names))) * (rng.random((frames, len(names))) < 0.2),
        expression_names=names,
        head_model=head.name,
    )


def another(head: HeadModel, scale: float, shift: np.ndarray) -> HeadModel:
    """The same face at another size and position, with blend shapes that span the same space, so the truth is known."""
    rng = np.random.default_rng(4)
    names = expression_shape_names(head)
    rows = [head.shape(name) for name in names]
    mixed = np.linalg.qr(rng.normal(size=(len(rows), len(rows))))[0] @ head.expression[rows].reshape(len(rows), -1)
    return replace(
        head,
        name="another",
        template=scale * head.template + shift,
        joints=scale * head.joints + shift,
        expression=scale * mixed.reshape(len(rows), *head.template.shape),
        expression_names=tuple(f"mixed_{number}" for number in range(len(rows))),
    )


def face(head: HeadModel, motion: Motion) -> np.ndarray:
    """Displacements of the skin by the expression alone, without lids and jaw."""
    rows = [head.shape(name) for name in motion.expression_names]
    moved = np.tensordot(motion.expression, head.expression[rows], axes=1)
    return np.asarray(moved[:, head.vertices_of("skin", "lips")])


def test_a_head_maps_to_itself_nearly_without_error():
    head = anny_head()
    motion = performance(head)
    mapping = expression_map(head, head)
    rest = np.abs(face(head, mapping.motion(motion)) - face(head, motion)).max()
    assert rest < 0.0004
    assert mapping.error_mm.max() < 0.1


def test_the_same_face_in_another_size_with_other_shapes_is_found():
    head = anny_head()
    target = another(head, 1.2, np.array([0.01, -0.3, 0.05]))
    mapping = expression_map(head, target)
    motion = performance(head)
    mapped = mapping.motion(motion)
    wanted = 1.2 * face(head, motion)
    error = np.sqrt(((face(target, mapped) - wanted) ** 2).sum(axis=-1).mean())
    assert error < 0.05 * np.sqrt((wanted**2).sum(axis=-1).mean())
    assert mapped.head_model == "another"
    motion_to_pose(target, mapped)  # can be used on the target head


def test_eyes_lids_jaw_and_head_are_carried_over_exactly(flame: HeadModel):
    head = anny_head()
    for source, target in ((head, flame), (flame, head)):
        motion = performance(source)
        mapped = expression_map(source, target).motion(motion)
        for name in ("head", "translation", "gaze", "lid", "jaw", "valid"):
            np.testing.assert_array_equal(getattr(mapped, name), getattr(motion, name))
        assert mapped.expression_names == expression_shape_names(target)
        assert mapped.head_model == target.name
        assert np.isfinite(motion_to_pose(target, mapped).expression).all()


def test_the_error_is_that_of_what_is_shown(flame: HeadModel):
    """Random shapes with FLAME's layout cannot represent a face: the map must report a low accuracy."""
    mapping = expression_map(anny_head(), flame)
    assert mapping.points > 300
    assert len(mapping.error_mm) == len(expression_shape_names(anny_head()))
    assert np.all(mapping.error_mm <= mapping.requested_mm * 1.001)
    assert mapping.error_mm.sum() > 0.5 * mapping.requested_mm.sum()  # random shapes represent smiles badly


def test_a_motion_of_another_expression_space_is_refused(flame: HeadModel):
    mapping = expression_map(anny_head(), flame)
    with pytest.raises(InputError, match="should be of the head anny, got expression_000 of flame"):
        mapping.motion(performance(flame))


def test_faces_that_do_not_lie_on_each_other_are_refused():
    head = anny_head()
    behind = replace(head, name="behind", template=head.template * [1, 1, -1] + [0, 0, 1])
    with pytest.raises(InputError, match="at least 30 points"):
        expression_map(head, replace(behind, landmarks=replace(head.landmarks, names=("none",) * 33)))
