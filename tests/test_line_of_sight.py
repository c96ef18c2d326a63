"""Eyes that look at you: forward axes of written, read and shown eyes meet at what the motion looks at."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import av
import numpy as np
import pytest
from command_line import call
from jaxtyping import Float
from model_conf import compose
from numpy import ndarray
from scipy.spatial.transform import Rotation
from toy_model import sound_file, toy_model

import talkingeyes as te
from talkingeyes.animation import line_of_sight
from talkingeyes.animation.line_of_sight import BETWEEN_EYES_M, EYES_M, from_forward_axes, to_forward_axes
from talkingeyes.apps.study.films import FilmContent, write_film
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.read_motion import read_motion
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyeball import APEX_M
from talkingeyes.head.eyelid.gaze_controller import homogeneous
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.physiology.vergence import HALF_INTERPUPILLARY_M
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.workflows import convert
from talkingeyes.workflows.render import parse_camera, render

# Yaw and pitch (degrees) of points at 1 m, and the head (rotation vector, degrees) that looks there.
LOOKS = (
    ((0, 0), (0, 0, 0)),
    ((20, 8), (0, 0, 0)),
    ((-15, -10), (3, 0, 0)),
    ((0, 0), (-6, 20, 3)),
    ((25, 5), (4, 12, -2)),
)
ANGLES_RAD, HEAD = (np.radians([row[part] for row in LOOKS]) for part in (0, 1))
TARGETS_M = rotation.angles_to_direction(ANGLES_RAD)  # from between the eyes of the head at rest
FRAMES = np.arange(len(LOOKS))


def looking() -> Motion:
    """Both lines of sight meet at the targets."""
    axes = line_of_sight.optical_axes_rad(HEAD, homogeneous(TARGETS_M), "world")
    return Motion.of(25.0, HEAD, rotation.eye_in_head(HEAD, axes))


def missed_deg(axes: Float[ndarray, "T 2 3"], centres: Float[ndarray, "T 2 3"] | None = None) -> float:
    """Largest angle between forward axes in space and the targets, seen from the centres of the eyes."""
    if centres is None:
        centres = np.einsum("tij,ej->tei", rotation.rotvec_to_matrix(HEAD), BETWEEN_EYES_M + EYES_M)
    wanted = (TARGETS_M + BETWEEN_EYES_M)[:, None] - centres
    beside = np.linalg.norm(np.cross(axes, wanted), axis=-1)
    return float(np.degrees(np.arctan2(beside, (axes * wanted).sum(axis=-1))).max())


def in_space(eyes: Float[ndarray, "T 2 3"], head: Float[ndarray, "T 3"] = HEAD) -> Float[ndarray, "T 2 3"]:
    """Forward axes in space, of rotation vectors."""
    return np.einsum("tij,tej->tei", rotation.rotvec_to_matrix(head), rotation.rotvec_to_direction(eyes))


def of_live_link(path: Path) -> list[float]:
    """By the angles, and by the look coefficients."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))

    def column(name: str) -> ndarray:
        return np.array([float(row[name]) for row in rows])

    by_angle = [
        rotation.angles_to_direction(np.stack([-column(f"{side}EyeYaw"), -column(f"{side}EyePitch")], axis=-1))
        for side in ("Left", "Right")
    ]
    by_look = []
    for side, outward in (("Left", 1.0), ("Right", -1.0)):
        looks = {way: column(f"EyeLook{way}{side}") * arkit.LOOK_RANGE_RAD for way in ("In", "Out", "Up", "Down")}
        angles = np.stack([outward * (looks["Out"] - looks["In"]), looks["Up"] - looks["Down"]], axis=-1)
        by_look.append(rotation.angles_to_direction(angles))
    found = (np.einsum("tij,etj->tei", rotation.rotvec_to_matrix(HEAD), np.stack(each)) for each in (by_angle, by_look))
    return [missed_deg(axes) for axes in found]


def of_arkit(path: Path) -> list[float]:
    content = json.loads(path.read_text())
    assert (content["schema"], content["forward_axis"]) == ("talkingeyes.arkit/2", "visual")
    return [missed_deg(in_space(np.array(content["eyes"])))]


def of_flame(path: Path) -> list[float]:
    with np.load(path) as file:
        assert str(file["forward_axis"]) == "visual"
        pair = np.hstack([file["leye_pose"], file["reye_pose"]]) if "leye_pose" in file else file["eyes_pose"]
        return [missed_deg(in_space(pair.reshape(-1, 2, 3)))]


def of_bvh(path: Path) -> list[float]:
    text = path.read_text()
    rows = np.array([line.split() for line in text.split("Frame Time:")[1].splitlines()[1:]], float)
    head, left, right = (Rotation.from_euler("YXZ", rows[:, at : at + 3], degrees=True) for at in (3, 9, 12))
    return [missed_deg(np.stack([(head * eye).apply([0, 0, 1]) for eye in (left, right)], axis=1))]


def of_glb(path: Path) -> list[float]:
    """World transforms of the nodes of the eyes."""
    import pygltflib

    gltf = pygltflib.GLTF2().load(str(path))
    names = [node.name for node in gltf.nodes]
    parents = {child: index for index, node in enumerate(gltf.nodes) for child in node.children or ()}

    def values(number: int) -> ndarray:
        found = gltf.accessors[number]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[found.type]
        start = gltf.bufferViews[found.bufferView].byteOffset
        return np.frombuffer(gltf.binary_blob(), np.float32, found.count * width, start).reshape(-1, width)

    animation = gltf.animations[0]
    moved = {
        (each.target.node, each.target.path): values(animation.samplers[each.sampler].output)
        for each in animation.channels
    }

    def world(node: int, frame: int) -> ndarray:
        local = np.eye(4)
        local[:3, 3] = gltf.nodes[node].translation or (0, 0, 0)
        if (node, "translation") in moved:
            local[:3, 3] = moved[node, "translation"][frame]
        if (node, "rotation") in moved:
            local[:3, :3] = Rotation.from_quat(moved[node, "rotation"][frame]).as_matrix()
        return world(parents[node], frame) @ local if node in parents else local

    eyes = [names.index(name) for name in ("left_eye", "right_eye")]
    places = np.array([[world(eye, frame) for eye in eyes] for frame in FRAMES])
    return [missed_deg(places[..., :3, 2], places[..., :3, 3])]


def of_usd(path: Path) -> list[float]:
    """World transforms of the joints of the eyes."""
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    cache = UsdSkel.Cache()
    assert cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/Head")), Usd.PrimDefaultPredicate)
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Head/Skeleton"))
    query = cache.GetSkelQuery(skeleton)
    names = [str(name).rsplit("/", 1)[-1] for name in query.GetJointOrder()]
    eyes = [names.index(name) for name in ("left_eye", "right_eye")]
    above = np.array(UsdGeom.Xformable(skeleton).ComputeLocalToWorldTransform(0))
    places = np.array([np.array(query.ComputeJointSkelTransforms(int(frame)))[eyes] @ above for frame in FRAMES])
    return [missed_deg(places[..., 2, :3], places[..., 3, :3])]  # USD has row vectors


def pupils_and_centres(vertices: Float[ndarray, "T V 3"]) -> tuple[ndarray, ndarray]:
    """Pupils, and centres of the eyes, which move with the head alone."""
    head = anny_head()
    turned = np.einsum("tij,ej->tei", rotation.rotvec_to_matrix(HEAD), head.eye_centres - head.joints[1])
    return vertices[:, head.pupils].astype(np.float64), turned + head.joints[1]


def of_vocaset(path: Path) -> list[float]:
    pupils, centres = pupils_and_centres(np.load(path).reshape(len(FRAMES), -1, 3))
    return [missed_deg(pupils - centres, centres)]


def of_vrm(path: Path) -> list[float]:
    """One direction for both eyes, from between them."""
    read = read_motion(path, eyes="optical").motion
    assert np.array_equal(read.gaze[:, 0], read.gaze[:, 1])
    between = np.einsum("tij,j->ti", rotation.rotvec_to_matrix(HEAD), BETWEEN_EYES_M)[:, None]
    return [missed_deg(in_space(read.gaze), np.repeat(between, 2, axis=1))]


FOUND: dict[str, Callable[[Path], list[float]]] = {
    **dict.fromkeys(("flame", "vhap", "diffposetalk"), of_flame),
    "livelink": of_live_link,
    "arkit": of_arkit,
    "glb": of_glb,
    "vrm": of_vrm,
    "usd": of_usd,
    "vocaset": of_vocaset,
    "bvh": of_bvh,
}


STATING = ("flame", "vhap", "diffposetalk", "arkit", "glb", "vrm", "usd")


def test_every_format_with_eyes_is_tested() -> None:
    assert set(convert.FORMATS) - set(FOUND) == {"events", "mp4", "obj", "ply"}  # meshes: test_format_writers


@pytest.mark.parametrize("format", FOUND)
def test_eyes_meet_at_the_target(tmp_path: Path, format: str) -> None:
    out = tmp_path / f"out{convert.FORMATS[format].suffix}"
    convert.export(looking(), out, format=format)
    assert max(FOUND[format](out)) < 0.1
    back = read_motion(out, 25.0).motion  # and after reading back
    if format == "vrm":
        return
    assert np.degrees(line_of_sight.gaze_error_rad(back.head, back.gaze, homogeneous(TARGETS_M), "world")).max() < 0.1
    np.testing.assert_allclose(back.gaze, looking().gaze, atol=1e-5)


@pytest.mark.parametrize("format", [name for name in FOUND if name != "vrm"])
def test_optical_axes_are_written_and_read_on_request(tmp_path: Path, format: str) -> None:
    out = tmp_path / f"out{convert.FORMATS[format].suffix}"
    convert.export(looking(), out, format=format, eyes="optical")
    back = read_motion(out, 25.0, eyes="optical").motion
    np.testing.assert_allclose(back.gaze, looking().gaze, atol=1e-5)
    stated = format in STATING
    found = read_motion(out, 25.0)
    assert np.allclose(found.motion.gaze, looking().gaze, atol=1e-5) == stated
    assert any(("stated as optical axes" if stated else "taken as lines of sight") in note for note in found.notes)


@pytest.mark.parametrize("eyes", ["visual", "optical"])
@pytest.mark.parametrize("format", ["glb", "vrm", "usd"])
def test_scenes_state_their_forward_axes(tmp_path: Path, format: str, eyes: str) -> None:
    """Where other readers of glTF and USD find it; `import` says that the file states it."""
    out = tmp_path / f"out{convert.FORMATS[format].suffix}"
    convert.export(looking(), out, format=format, eyes=eyes)
    if format == "usd":
        from pxr import Usd

        stage = Usd.Stage.Open(str(out))
        stated = stage.GetRootLayer().customLayerData["forward_axis"]
    else:
        import pygltflib

        stated = pygltflib.GLTF2().load_binary(str(out)).asset.extras["forward_axis"]
    assert stated == eyes
    axes = {"visual": "lines of sight", "optical": "optical axes"}[eyes]
    assert any(f"eyes stated as {axes}" in note for note in read_motion(out).notes)
    asked = read_motion(out, eyes="optical")  # what the user says has precedence
    assert any("eyes taken as optical axes" in note for note in asked.notes)


def test_an_unknown_statement_is_one_line(tmp_path: Path) -> None:
    convert.export(looking(), tmp_path / "a.usda", format="usd")
    text = (tmp_path / "a.usda").read_text()
    (tmp_path / "a.usda").write_text(text.replace('forward_axis = "visual"', 'forward_axis = "aside"'))
    with pytest.raises(InputError, match=r"a\.usda: eyes: should be one of visual, optical, got 'aside'"):
        read_motion(tmp_path / "a.usda")


def test_animate_writes_optical_axes_on_request(tmp_path: Path) -> None:
    sound, model = str(sound_file(tmp_path / "a.wav")), str(toy_model(tmp_path / "model"))

    def animated(eyes: str) -> int:
        options = ("--model", model, "--samples", "1", "--no-previews", "-f", "arkit", "--eyes", eyes)
        return call("animate", sound, "-o", str(tmp_path / eyes), *options)

    for eyes in ("visual", "optical"):
        assert animated(eyes) == 0
        shown = to_forward_axes(Motion.load(tmp_path / eyes / "sample_00.npz"), eyes)
        content = json.loads((tmp_path / eyes / "sample_00.arkit.json").read_text())
        assert content["forward_axis"] == eyes
        np.testing.assert_allclose(content["eyes"], shown.gaze, atol=1e-6)
    assert animated("aside") == 2
    assert not (tmp_path / "aside").exists()


def test_files_of_trackers_hold_optical_axes(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("fps: 25\ngaze: {}\n")
    np.save(tmp_path / "a.npy", looking().gaze.reshape(-1, 6))
    convert.import_files([tmp_path / "a.npy"], tmp_path / "a.npz", mapping=tmp_path / "map.yaml")
    np.testing.assert_allclose(Motion.load(tmp_path / "a.npz").gaze, looking().gaze, atol=1e-6)
    (tmp_path / "old.json").write_text(
        json.dumps(
            {
                "schema": "talkingeyes.arkit/1",
                "fps": 25.0,
                "names": list(arkit.NAMES),
                "coefficients": np.zeros((5, 52)).tolist(),
                "eyes": looking().gaze.tolist(),
            }
        )
    )
    np.testing.assert_allclose(read_motion(tmp_path / "old.json").motion.gaze, looking().gaze, atol=1e-12)


def test_conversion_is_inverted_and_keeps_torsion() -> None:
    gaze = np.random.default_rng(0).normal(0, 0.3, (50, 2, 3))
    motion = Motion.of(25.0, np.zeros((50, 3)), gaze)
    back = from_forward_axes(to_forward_axes(motion), "visual")
    np.testing.assert_allclose(back.gaze, gaze, atol=1e-12)
    assert to_forward_axes(motion, "optical") is motion
    with pytest.raises(InputError, match="eyes: should be one of visual, optical, got 'sideways'"):
        to_forward_axes(motion, "sideways")


def test_eyes_at_rest_stay_at_rest() -> None:
    still = Motion.of(25.0, np.zeros((5, 3)), np.zeros((5, 2, 3)))
    assert not to_forward_axes(still).gaze.any()


def test_eyes_of_an_animation_converge(tmp_path: Path) -> None:
    """The mean difference of left and right yaw in a Live Link file is the vergence of the lines of sight."""
    spoken = te.speak("People look at each other when they talk, and now and then they look away to think.")
    apart = []
    for seed in range(3):
        motion = te.animate(spoken.sound, seed=seed).motion
        te.export(motion, tmp_path / f"{seed}.csv")
        with (tmp_path / f"{seed}.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        yaw = np.array([[-float(row[f"{side}EyeYaw"]) for side in ("Left", "Right")] for row in rows])
        apart.append(np.degrees(yaw[:, 0] - yaw[:, 1]).mean())
        optical = rotation.gaze_to_angles(motion.gaze)[..., 0]
        kappa = line_of_sight.MEAN_KAPPA_RAD[:, 0]
        vergence = ((optical[:, 1] - kappa[1]) - (optical[:, 0] - kappa[0])).mean()
        assert apart[-1] == pytest.approx(-np.degrees(vergence), abs=1e-4)
    nearest = np.degrees(2 * np.arctan(HALF_INTERPUPILLARY_M / 0.6))
    assert -nearest < min(apart) <= max(apart) < 0.0  # never wall-eyed, nor crossed nearer than 0.6 m
    assert -4.0 < np.mean(apart) < -1.5  # at a partner 1 m away: docs/results/reference_ranges.md


PUPIL_MOST = 120  # sum of the colours of a dark pixel
# From the place of the partner, 1 m before the eyes.
CAMERA, SIZE_PX, HEIGHT_MM = "distance=1,height=0.3", 768, 300.0  # the height 1 m away; eyes are nearer


def looking_at_the_camera(frames: int) -> Motion:
    points = np.tile(parse_camera(CAMERA).view(SIZE_PX, SIZE_PX).origin - BETWEEN_EYES_M, (frames, 1))
    axes = line_of_sight.optical_axes_rad(np.zeros((frames, 3)), homogeneous(points), "world")
    return Motion.of(25.0, np.zeros((frames, 3)), rotation.angles_to_gaze(axes))


def offsets_mm(pupils: ndarray, points: ndarray) -> Float[ndarray, " 2"]:
    """How far pupils lie to the temple of points (pixels); the subject's left is right in the picture."""
    return (pupils - points)[:, 0] * [1, -1] * HEIGHT_MM / SIZE_PX * (1 - BETWEEN_EYES_M[2])


@pytest.mark.parametrize(("eyes", "aside_mm"), [("visual", 0.0), ("optical", 1e3 * APEX_M * np.sin(np.radians(4.5)))])
def test_seen_by_the_partner_pupils_face_the_partner(eyes: str, aside_mm: float) -> None:
    """Pupils cover the centres of their eyes, and lie mirror-symmetric between the corners of the lids."""
    head = anny_head()
    pose = motion_to_pose(head, to_forward_axes(looking_at_the_camera(1), eyes))
    vertices = posed_vertices(head, pose).astype(np.float64)[0]
    view = parse_camera(CAMERA).view(SIZE_PX, SIZE_PX)
    pupils, centres = view.project(vertices[head.pupils]), view.project(head.eye_centres)
    np.testing.assert_allclose(offsets_mm(pupils, centres), aside_mm, atol=0.03)
    corners = [[f"{side}_eye_{corner}" for corner in ("outer", "inner")] for side in ("left", "right")]
    at = [[head.landmarks.names.index(name) for name in names] for names in corners]
    middles = view.project(head.landmarks.of(vertices))[at].mean(axis=1)
    left, right = offsets_mm(pupils, middles)
    assert left == pytest.approx(right, abs=0.05)


def pupils_in_picture(picture: ndarray, near: Float[ndarray, "2 2"], radius_px: float) -> Float[ndarray, "2 2"]:
    """Centre of the dark pixels around each point."""
    rows, columns = np.indices(picture.shape[:2]) + 0.5
    dark = picture.sum(axis=-1) < PUPIL_MOST
    found = []
    for x, y in near:
        inside = dark & (np.hypot(columns - x, rows - y) < radius_px)
        assert inside.sum() > 20  # an eye that is shut has no pupil
        found.append([columns[inside].mean(), rows[inside].mean()])
    return np.array(found)


@pytest.mark.parametrize("aside_deg", [0, 20, -20])
@pytest.mark.parametrize("eyes", ["visual", "optical"])
def test_a_picture_from_the_place_of_the_partner_shows_pupils_that_face_it(eyes: str, aside_deg: int) -> None:
    """The pixels: pupils lie over the centres of both eyes; optical axes lie mirror-symmetric beside them."""
    view = parse_camera(f"distance=1,height=0.13,yaw={aside_deg}").view(SIZE_PX, SIZE_PX)
    points = np.tile(view.origin - BETWEEN_EYES_M, (1, 1))
    axes = line_of_sight.optical_axes_rad(np.zeros((1, 3)), homogeneous(points), "world")
    motion = to_forward_axes(Motion.of(25.0, np.zeros((1, 3)), rotation.angles_to_gaze(axes)), eyes)
    picture = next(HeadRenderer(anny_head(), view).draw(motion)).astype(float)
    centres = view.project(anny_head().eye_centres)
    found = pupils_in_picture(picture, centres, 25)
    outward_px = (found - centres)[:, 0] * [1, -1]  # the subject's left is right in the picture
    if eyes == "visual":
        np.testing.assert_allclose(outward_px, 0.0, atol=0.5)
    else:
        assert outward_px.min() > 4.0
    if aside_deg == 0:
        assert outward_px[0] == pytest.approx(outward_px[1], abs=0.3)


def test_films_of_studies_look_at_the_viewer(tmp_path: Path) -> None:
    """The first frame of a film is the picture of lines of sight, not that of optical axes, but for compression."""
    view = parse_camera("eyes").view(480, 216)
    write_film(FilmContent(looking_at_the_camera(3), np.zeros(1920)), anny_head(), view, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as film:
        found = next(iter(film.decode(video=0))).to_ndarray(format="rgb24").astype(float)
    error = {
        eyes: np.abs(
            next(HeadRenderer(anny_head(), view).draw(to_forward_axes(looking_at_the_camera(1), eyes))) - found
        )
        for eyes in ("visual", "optical")
    }
    assert error["visual"].mean() < 0.7 * error["optical"].mean()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mediapipe") is None, reason="the package mediapipe is not installed")
@pytest.mark.parametrize(("eyes", "aside_mm"), [("visual", 0.0), ("optical", 1e3 * APEX_M * np.sin(np.radians(4.5)))])
def test_mediapipe_sees_the_irises_of_a_film_there(tmp_path: Path, eyes: str, aside_mm: float) -> None:
    from talkingeyes.tracking.face_mesh import FaceMesh

    looking_at_the_camera(6).save(tmp_path / "a.npz")
    render(tmp_path / "a.npz", tmp_path / "a.mp4", camera=CAMERA, size=SIZE_PX, eyes=eyes)
    mesh = FaceMesh(TrackSettings.model_validate(compose([])["track"]).face)
    with av.open(str(tmp_path / "a.mp4")) as film:
        faces = [mesh.detect(frame.to_ndarray(format="rgb24"), frame.time) for frame in film.decode(video=0)]
    mesh.close()
    centres = parse_camera(CAMERA).view(SIZE_PX, SIZE_PX).project(anny_head().eye_centres)
    assert faces[-1] is not None
    found = offsets_mm(faces[-1].pupils, centres)
    assert found.mean() == pytest.approx(aside_mm, abs=0.4)  # a pixel
