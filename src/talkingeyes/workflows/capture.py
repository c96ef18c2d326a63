"""`talkingeyes capture`: gaze and lids of a face in one to three synchronous views, by the Eyelid model.

Reads videos, or folders of images. Writes motion.npz, capture.csv (a row per frame and eye), summary.json, and with
`overlay` overlay.mp4: the first view with the model's curves. Head poses are those of `fit` on MediaPipe's landmarks.
"""

from __future__ import annotations

import csv
import json
import re
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.output_folder import atomic_folder, output_path
from talkingeyes.core.progress import progress_bar
from talkingeyes.core.rotation import angles_to_gaze, gaze_to_angles, matrix_to_rotvec, rotvec_to_matrix
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.fitting.clip import FitResult, FitSettings, fit_clip
from talkingeyes.fitting.eyelid_capture import (
    IMAGE_PX,
    PX_PER_M,
    EyeImages,
    EyeTrack,
    capture_eye,
    open_head_lids,
    opening_sizes,
    place_eye,
    project_curves,
)
from talkingeyes.fitting.gaps import interpolate_gaps
from talkingeyes.head.calibrated_camera import CalibratedCamera
from talkingeyes.head.camera import Camera
from talkingeyes.head.eyelid.anatomy import IRIS_RADIUS_M
from talkingeyes.head.eyelid.model import ANCHOR, LOWER, UPPER, EyelidModel
from talkingeyes.head.eyelid.person import EyelidPerson, load_person
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.observation import Observation
from talkingeyes.tracking.cropping import Crop, crop_camera, face_crop
from talkingeyes.tracking.eye_images import EyeImage, cut_eyes
from talkingeyes.tracking.face_mesh import FaceMesh
from talkingeyes.tracking.mesh_offsets import to_head_landmarks
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.video import read_frames

OWN_FILES = re.compile(r"motion\.npz|capture\.csv|summary\.json|overlay\.mp4")
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".webp")
COLUMNS = ("frame", "time_s", "eye", "yaw_deg", "pitch_deg", "closure", "blink_energy", "gaze_energy", "gaze_sd_deg",
           "trusted", "reason")  # fmt: skip
SIDES = ("left", "right")
MAX_FPS = 240.0
POSE_ROUNDS = 2  # the landmarks are moved to those of the head under the pose of the round before
CAMERA_DISTANCE_M = 1.0  # of calibrated views, from the origin of the fit
NO_FACE = "no face"
CURVE, LOST = (255, 225, 40), (255, 90, 60)  # colours of curves whose gaze is trusted, and is not


class Cameras(Settings):
    """A file of cameras, one per view."""

    schema_: Literal["talkingeyes.cameras/1"] = Field(alias="schema")
    cameras: Annotated[list[CalibratedCamera], Field(min_length=1, max_length=3)]


@dataclass(frozen=True)
class ViewCapture:
    """What one view shows: its fit, crop, both eyes as images, and their gaze and lids. Times in seconds."""

    times_s: Float[ndarray, " T"]
    fit: FitResult
    cuts: list[tuple[EyeImage, EyeImage]]
    images: tuple[EyeImages, EyeImages]
    tracks: tuple[EyeTrack, EyeTrack]


@dataclass(frozen=True)
class Capture:
    """The result: a motion, the fused tracks of both eyes, and the views. `seconds`: processing time on the CPU."""

    motion: Motion
    tracks: tuple[EyeTrack, EyeTrack]
    views: list[ViewCapture]
    seconds: float


def capture_command(
    views: Sequence[Path],
    out: Path,
    *,
    cameras: Path | None,
    eyelid: Path | None,
    fps: float,
    overlay: bool,
    force: bool,
) -> Iterator[str]:
    """`talkingeyes capture`; yields its output lines. Raises InputError (one line)."""
    folder = output_path(out, OWN_FILES, force=force)
    calibrated = None if cameras is None else read_cameras(cameras, len(views))
    person = None if eyelid is None else load_person(eyelid)
    found = capture(views, cameras=calibrated, person=person, fps=fps)
    with atomic_folder(folder) as target:
        found.motion.save(target / "motion.npz")
        _write_table(target / "capture.csv", found)
        summary = summarise(found)
        (target / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
        if overlay:
            from talkingeyes.rendering.video import write_video

            lids = _lids(person)
            write_video(
                target / "overlay.mp4", draw_overlay(views[0], found.views[0], lids, fps), found.motion.fps, None
            )
    yield f"{out}: {len(found.motion)} frames at {found.motion.fps:g} fps, {summary['frames_per_second']:.0f} a second"
    for side in SIDES:
        yield f"{side}: gaze trusted in {summary[side]['trusted']:.0%}; not: {summary[side]['reasons'] or 'none'}"


def read_cameras(path: Path, views: int) -> list[CalibratedCamera]:
    """Read the cameras of all views. Raises InputError (one line)."""
    found = validate_section(str(path), Cameras, read_json(path, "file of cameras")).cameras
    if len(found) != views:
        raise InputError(f"{path}: should have one camera per view, {views}, got {len(found)}")
    return found


def capture(
    views: Sequence[Path],
    *,
    cameras: Sequence[CalibratedCamera] | None = None,
    person: EyelidPerson | None = None,
    fps: float = 25.0,
) -> Capture:
    """Capture gaze and lids from one to three views. `fps` is the rate of images in folders.

    Raises InputError for views that cannot be read, differ in length, or show no face.
    """
    from talkingeyes.orchestration.config import compose

    if not 1 <= len(views) <= 3:
        raise InputError(f"views: should be one to three, got {len(views)}")
    params = compose(["fit=video"])
    track = validate_section("track", TrackSettings, params["track"])
    fit = validate_section("fit", FitSettings, params["fit"])
    start = time.process_time()
    found = [
        _capture_view(view, cameras[number] if cameras else None, person, fps, track, fit)
        for number, view in enumerate(views)
    ]
    frames = [len(each.times_s) for each in found]
    if len(set(frames)) > 1:
        raise InputError(f"views: should have the same number of frames, got {', '.join(map(str, frames))}")
    tracks = (fuse([each.tracks[0] for each in found]), fuse([each.tracks[1] for each in found]))
    motion = _motion(found[0], tracks, cameras[0] if cameras else None)
    return Capture(motion, tracks, found, time.process_time() - start)


def fuse(tracks: Sequence[EyeTrack]) -> EyeTrack:
    """One eye from several views: gaze of the views that are trusted, by their precision; closures alike."""
    if len(tracks) == 1:
        return tracks[0]
    trusted = np.stack([track.trusted for track in tracks])
    precision = np.stack([1.0 / np.maximum(track.sd_rad, 1e-4) ** 2 for track in tracks])
    weight = np.where(trusted | ~trusted.any(axis=0), precision, 0.0)
    weight /= weight.sum(axis=0)

    def mixed(name: str) -> ndarray:
        return np.asarray(np.einsum("vt,vt...->t...", weight, np.stack([getattr(track, name) for track in tracks])))

    reason = tuple(
        "" if any(row) else tracks[int(np.argmax(weight[:, frame]))].reason[frame]
        for frame, row in enumerate(trusted.T)
    )
    return replace(
        tracks[0],
        angles_rad=mixed("angles_rad"),
        closure=mixed("closure"),
        blink_energy=mixed("blink_energy"),
        gaze_energy=mixed("gaze_energy"),
        shift_m=mixed("shift_m"),
        sd_rad=1.0 / np.sqrt(np.where(trusted | ~trusted.any(axis=0), precision, 0.0).sum(axis=0)),
        reason=reason,
    )


def summarise(found: Capture) -> dict[str, Any]:
    """Counts of what was trusted and why not, sizes, speed."""
    summary: dict[str, Any] = {
        "frames": len(found.motion),
        "fps": found.motion.fps,
        "views": len(found.views),
        "frames_per_second": len(found.motion) / max(found.seconds, 1e-9),
    }
    for side, track in zip(SIDES, found.tracks, strict=True):
        counts = Counter(reason for reason in track.reason if reason)
        summary[side] = {
            "trusted": float(track.trusted.mean()),
            "reasons": ", ".join(f"{name} {count}" for name, count in counts.most_common()),
            "lid_size": track.lid_size,
            "iris_size": track.iris_size,
        }
    return summary


def draw_overlay(
    view: Path, found: ViewCapture, lids: tuple[EyelidModel, EyelidModel], fps: float
) -> Iterator[UInt8[ndarray, "H W 3"]]:
    """Frames of a view with the model's curves: eyelid anchor, lids, and the complete iris circle."""
    import cv2

    outlines = [project_curves(found.images[eye], eye, lids[eye], found.tracks[eye]) for eye in range(2)]
    for frame, (_, image) in enumerate(_frames(view, fps)):
        drawn = np.array(image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2])
        for eye, (curves, ring) in enumerate(outlines):
            track, cut = found.tracks[eye], found.cuts[frame][eye]
            if track.reason[frame] == NO_FACE:
                continue
            colour = CURVE if track.trusted[frame] else LOST
            shapes = [curves[frame, rows] for rows in (UPPER, LOWER, ANCHOR)]
            shapes += [ring[frame][[*range(len(ring[frame])), 0]]] if track.closure[frame] < 1.0 else []
            for shape in shapes:
                at = np.round(16.0 * (cut.corner - 0.5 + cut.scale * shape)).astype(np.int32)
                cv2.polylines(drawn, [at], False, colour, 1, cv2.LINE_AA, 4)
        yield drawn


def _capture_view(
    view: Path,
    calibrated: CalibratedCamera | None,
    person: EyelidPerson | None,
    fps: float,
    track: TrackSettings,
    fit: FitSettings,
) -> ViewCapture:
    mesh = FaceMesh(track.face)
    points: list[ndarray] = []
    times, cuts = [], []
    blank = EyeImage(np.zeros((IMAGE_PX[1], IMAGE_PX[0], 3), np.uint8), np.zeros(2), 1.0)
    for time_s, image in progress_bar(_frames(view, fps), f"faces of {view.name}"):
        face = mesh.detect(image, time_s)
        times.append(time_s)
        if face is None:
            points.append(np.full((len(LANDMARK_NAMES) + 2, 2), np.nan))
            cuts.append((blank, blank))
        else:
            points.append(np.concatenate([face.landmarks, face.pupils]))
            cuts.append(cut_eyes(image, face.landmarks, IMAGE_PX, PX_PER_M))
    mesh.close()
    detected = np.array(points)
    seen = np.isfinite(detected).all(axis=(1, 2))
    if not seen.any():
        raise InputError(f"{view}: should show a face, got none in {len(seen)} frames")
    crop = face_crop(detected[seen][:, :-2], track.crop)
    camera = crop_camera(track.crop) if calibrated is None else _cropped(calibrated, crop, track.crop.size_px)
    rate = fps if len(times) < 2 else (len(times) - 1) / (times[-1] - times[0])
    pixels = crop.to_crop(detected)
    observed = Observation(round(rate, 3), pixels[:, :-2], pixels[:, -2:], seen.astype(np.float64), camera)
    done = fit_clip(observed, fit)
    for _ in range(POSE_ROUNDS):
        moved = to_head_landmarks(pixels[:, :-2], done.pose.head, done.pose.translation, camera)
        observed = replace(observed, landmarks=moved)
        done = fit_clip(observed, fit)
    sizes = opening_sizes(observed.landmarks, done.pose.head, done.pose.translation, camera)
    images, tracks = [], []
    for eye in range(2):
        placed = place_eye([cut[eye] for cut in cuts], eye, done.pose.head, done.pose.translation, camera, crop)
        lids, lid_size, iris_size = _sizes(person, eye, float(sizes[eye]))
        start = gaze_to_angles(done.motion.gaze[:, eye])
        found = capture_eye(placed, eye, lids, start, done.motion.lid[:, eye], observed.fps, lid_size, iris_size)
        reason = tuple(why if shown else NO_FACE for why, shown in zip(found.reason, seen, strict=True))
        images.append(placed)
        tracks.append(replace(found, reason=reason))
    return ViewCapture(np.array(times), done, cuts, (images[0], images[1]), (tracks[0], tracks[1]))


def _lids(person: EyelidPerson | None) -> tuple[EyelidModel, EyelidModel]:
    return open_head_lids() if person is None else (person.eyes[0].lids, person.eyes[1].lids)


def _sizes(person: EyelidPerson | None, eye: int, width: float) -> tuple[EyelidModel, float, float | None]:
    """Lids, and sizes of opening and iris; those of a person are known up to the scale of the view."""
    lids = _lids(person)[eye]
    if person is None:
        return lids, width, None
    own, mean = (
        float(np.linalg.norm(each.rest[UPPER][-1] - each.rest[UPPER][0])) for each in (lids, open_head_lids()[eye])
    )
    scale = width * mean / own
    return lids, scale, scale * person.eyes[eye].iris_radius_m / IRIS_RADIUS_M


def _motion(view: ViewCapture, tracks: tuple[EyeTrack, EyeTrack], calibrated: CalibratedCamera | None) -> Motion:
    """The fitted motion with captured gaze, held where it cannot be trusted, and lids."""
    own = view.fit.motion
    gaze, known = [], np.zeros(len(own), bool)
    for eye, track in enumerate(tracks):
        trusted = track.trusted
        known |= trusted
        angles = interpolate_gaps(track.angles_rad, trusted) if trusted.any() else gaze_to_angles(own.gaze[:, eye])
        gaze.append(angles_to_gaze(angles))
    shut = np.all([track.closure > 0.5 for track in tracks], axis=0)
    head, translation = own.head, own.translation
    if calibrated is not None:  # from the camera's axes to the scene's
        to_scene = calibrated.turn.T @ np.diag([1.0, -1.0, -1.0])
        head = matrix_to_rotvec(to_scene @ rotvec_to_matrix(head))
        translation = calibrated.origin + (translation - [0.0, 0.0, CAMERA_DISTANCE_M]) @ to_scene.T
    lid = np.stack([track.closure for track in tracks], axis=1)
    return replace(
        own, head=head, translation=translation, gaze=np.stack(gaze, axis=1), lid=lid, valid=own.valid & (known | shut)
    )


def _cropped(calibrated: CalibratedCamera, crop: Crop, size_px: int) -> Camera:
    """A calibrated camera in pixels of the crop, at a distance that the head's translation makes up for."""
    x, y = crop.to_crop(np.array(calibrated.centre_px))
    return Camera(calibrated.focal_px * crop.zoom, (float(x), float(y)), CAMERA_DISTANCE_M, size_px, size_px)


def _frames(view: Path, fps: float) -> Iterator[tuple[float, UInt8[ndarray, "H W 3"]]]:
    """Times and images of a video, of a folder of images by name, or of one image. Raises InputError."""
    if view.is_dir() or view.suffix.lower() in IMAGE_SUFFIXES:
        from PIL import Image

        files = (
            sorted(each for each in view.iterdir() if each.suffix.lower() in IMAGE_SUFFIXES)
            if view.is_dir()
            else [view]
        )
        if not files:
            raise InputError(f"{view}: should hold images ({' '.join(IMAGE_SUFFIXES)}), got none")
        for index, file in enumerate(files):
            with reading(file, "image"), Image.open(file) as image:
                pixels = np.asarray(image.convert("RGB"))
            yield index / fps, pixels
        return
    if not view.is_file():
        raise InputError(f"{view}: should be a video, an image or a folder of images, got nothing there")
    for frame in read_frames(view, MAX_FPS):
        yield frame.time_s, frame.image


def _write_table(path: Path, found: Capture) -> None:
    """A row per frame and eye."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for frame, time_s in enumerate(found.views[0].times_s):
            for side, track in zip(SIDES, found.tracks, strict=True):
                yaw, pitch = np.degrees(track.angles_rad[frame])
                numbers = (yaw, pitch, track.closure[frame], track.blink_energy[frame], track.gaze_energy[frame],
                           np.degrees(track.sd_rad[frame]))  # fmt: skip
                writer.writerow([frame, f"{time_s:.4f}", side, *(f"{number:.5g}" for number in numbers),
                                 int(not track.reason[frame]), track.reason[frame]])  # fmt: skip
