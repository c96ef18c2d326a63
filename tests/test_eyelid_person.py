"""The lids of a person: labels of curves, their errors by line, the model, and heads that wear it."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import flame_file
import numpy as np
import pytest
from command_line import call

from talkingeyes.animation.animator import Animator
from talkingeyes.animation.streaming import LiveModel
from talkingeyes.apps.service import app
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.head.anny import anny_head
from talkingeyes.head.calibrated_camera import CalibratedCamera
from talkingeyes.head.camera import Camera
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES
from talkingeyes.head.eyelid.example_labels import example_labels
from talkingeyes.head.eyelid.labels import load_labels
from talkingeyes.head.eyelid.model import lid_opening_m
from talkingeyes.head.eyelid.person import EyelidPerson, fit_person, load_person
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.workflows import serve
from talkingeyes.workflows.animate import AnimationOptions
from talkingeyes.workflows.render import load_head


@pytest.fixture(scope="module")
def content() -> dict[str, Any]:
    """The nine held gazes and the closed lids; two views."""
    labels = example_labels()
    labels["postures"] = labels["postures"][:10]
    for posture in labels["postures"]:
        posture["views"] = posture["views"][:2]
    return labels


@pytest.fixture(scope="module")
def model(content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("person")
    (folder / "labels.json").write_text(json.dumps(content))
    person, _ = fit_person(load_labels(folder / "labels.json"))
    person.save(folder / "model.npz")
    return folder / "model.npz"


def test_eyes_and_lids_of_the_labelled_head_are_found(model: Path):
    for eye, found in enumerate(load_person(model).eyes):
        np.testing.assert_allclose(found.centre, anny_head().eye_centres[eye], atol=0.0005)
        assert found.iris_radius_m == pytest.approx(0.0059, abs=0.0001)
        ahead, down, shut = (
            lid_opening_m(found.lids.curves(np.radians(angles), np.array(lid)))
            for angles, lid in (((0, 0), 0.0), ((0, -20), 0.0), ((0, 0), 1.0))
        )
        assert 0.005 < ahead < 0.012
        assert down < 0.9 * ahead
        assert shut == pytest.approx(0.0, abs=1e-6)


def test_labels_without_held_postures_are_an_error(content: dict[str, Any], tmp_path: Path):
    postures = [{**each, "kind": "speech", "views": each["views"][:1]} for each in content["postures"][:3]]
    (tmp_path / "labels.json").write_text(json.dumps({**content, "postures": postures}))
    with pytest.raises(InputError, match=r"held gazes and shut lids.*the left eye"):
        fit_person(load_labels(tmp_path / "labels.json"))


@pytest.mark.parametrize("name", ["anny", "flame"])
def test_a_head_wears_the_lids_of_a_person(model: Path, tmp_path: Path, name: str):
    flame = None
    if name == "flame":
        flame_file.write(flame := tmp_path / "model.pkl", flame_file.arrays())
    plain, head = load_head(name, flame), load_head(name, flame, model)
    assert head.expression_names == plain.expression_names
    first = head.shape(LID_SHAPES[0])
    assert np.abs(head.expression[:first] - plain.expression[:first]).max() == 0
    assert np.abs(head.expression[first:] - plain.expression[first:]).max() > 1e-4
    gaze = angles_to_gaze(np.radians([[[0, -15], [0, -15]]]))
    for lid in (0.0, 1.0):
        pose = motion_to_pose(head, Motion.of(25.0, np.zeros((1, 3)), gaze, lid=np.full((1, 2), lid)))
        points = head.landmarks.of(head.template + np.tensordot(pose.expression[0], head.expression, axes=1))
        heights = dict(zip(head.landmarks.names, points[:, 1], strict=True))
        places = [f"right_eye_{lid_name}_{at}" for lid_name in ("upper", "lower") for at in ("outer", "inner")]
        upper, lower = np.array([heights[place] for place in places]).reshape(2, 2).mean(axis=1)
        assert (upper - lower > 0.002) if lid == 0 else (abs(upper - lower) < 1e-6)


def test_the_service_shows_the_lids_of_a_person(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """On the head of its page, and in exported files that pose a head."""
    asked, heads = {}, []
    monkeypatch.setattr(Animator, "load", lambda _: SimpleNamespace(persons=()))
    monkeypatch.setattr(LiveModel, "load", lambda _: None)
    monkeypatch.setattr(serve.convert, "export", lambda *_, format, eyelid, **__: asked.update({format: eyelid}))
    monkeypatch.setattr(app, "service_app", lambda resources, *_: heads.append(resources.head))
    monkeypatch.setattr(serve, "serve", lambda *_: None)
    monkeypatch.setattr(serve.signal, "signal", lambda *_: None)
    export = serve.file_workers("model", "ada", str(model))
    for name in ("glb", "mp4", "arkit"):
        export(("export", tmp_path, name, tmp_path / "file"))
    assert asked == {"glb": str(model), "mp4": str(model), "arkit": None}
    for eyelid in (None, model):
        serve.run_service(eyelid=eyelid, on_start=print)
    assert heads[0] != heads[1]
    with pytest.raises(InputError, match="not a readable Eyelid model"):
        serve.run_service(eyelid=tmp_path, on_start=print)


def lines_of(content: dict[str, Any]) -> list[str]:
    return json.dumps(content, indent=1).splitlines()


@pytest.mark.parametrize(
    ("change", "key", "says"),
    [
        (lambda c: c["postures"][2].update(kind="looking"), '"kind": "looking"', "postures.2.kind: Input should be"),
        (lambda c: c["postures"][1]["views"][0].update(camera=7), '"camera": 7', "should be below 3, got 7"),
        (lambda c: c["cameras"][0].update(focal_px=-1.0), '"focal_px": -1.0', "greater than or equal to 1, got -1.0"),
        (lambda c: c.update(schema="other"), '"schema": "other"', "schema: Input should be"),
        (lambda c: c.pop("cameras"), "{", "cameras: Field required"),
        (lambda c: c["postures"][0]["views"][1]["left"].update(uppr=[]), '"uppr": []', "left.uppr: Extra inputs"),
    ],
)
def test_errors_name_the_line(content: dict[str, Any], tmp_path: Path, change: Any, key: str, says: str):
    changed = json.loads(json.dumps(content))
    change(changed)
    lines = lines_of(changed)
    path = tmp_path / "labels.json"
    path.write_text("\n".join(lines))
    expected = 1 + next(number for number, line in enumerate(lines) if line.strip().startswith(key))
    with pytest.raises(InputError, match=says) as caught:
        load_labels(path)
    assert str(caught.value).startswith(f"{path}:{expected}: ")
    assert "\n" not in str(caught.value)


def test_what_is_no_file_of_labels_or_no_model_is_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "labels.json").write_text('{"schema": 1,\n"cameras": [}')
    with pytest.raises(InputError, match=r"labels\.json:2: not JSON"):
        load_labels(tmp_path / "labels.json")
    np.savez(tmp_path / "other.npz", left_rest=np.zeros(3))
    assert call("head", "-o", str(tmp_path / "a.png"), "--eyelid", str(tmp_path / "other.npz")) == 2
    assert "should be a model of `talkingeyes eyelid fit`" in capsys.readouterr().err
    assert not (tmp_path / "a.png").exists()
    with pytest.raises(InputError, match="should be a model of `talkingeyes eyelid fit`"):
        AnimationOptions(eyelid=tmp_path / "other.npz")


def test_a_calibrated_camera_agrees_with_the_camera_of_the_project():
    plain = Camera(800.0, (100.0, 90.0), 0.7, 200, 180)
    camera = CalibratedCamera(
        focal_px=800.0, centre_px=(100.0, 90.0), rotation=(np.pi, 0.0, 0.0), translation_m=(0.0, 0.0, 0.7)
    )
    points = np.random.default_rng(0).normal(0.0, 0.05, (9, 3))
    pixels = camera.project(points)
    np.testing.assert_allclose(pixels, plain.project(points), atol=1e-9)
    np.testing.assert_allclose(camera.origin, [0.0, 0.0, 0.7], atol=1e-12)
    away = points - camera.origin
    np.testing.assert_allclose(camera.rays(pixels), away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-9)


def test_the_model_is_read_back_as_written(model: Path, tmp_path: Path):
    person = load_person(model)
    person.save(tmp_path / "again.npz")
    again: EyelidPerson = load_person(tmp_path / "again.npz")
    np.testing.assert_array_equal(again.eyes[1].lids.weights, person.eyes[1].lids.weights)
