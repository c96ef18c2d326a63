"""Table VIII by the paper's procedure, on real videos: MediaPipe at full size as truth, then scaled to 224 lines.

The video is scaled to 224 lines and re-encoded (H.264, CRF 35, as small as VoxCeleb2's). MediaPipe runs on both, and
each fit uses its output for the small one. Error: distance of a fitted pupil to the pupil at full size, pixels of the
standard crop. Speed and saccade peaks: of a pupil relative to its eye's centre, for all methods under the head pose of
the large video, whose frame-by-frame fit is the truth; frames without blinks. Left and right yaw are correlated over
frames with moving gaze: within half a second it spans 2 degrees or more. `moving px`: the error without the mean offset
of each eye, because a prior on the axes of the eyes moves the pupils of a whole clip. After the tables of the videos,
the medians over videos, each video with the same weight.

Run     python -m pipelines.results.table8_video VIDEO...      (extra `track`)
Reads   conf/
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.fitting.accuracy import FitReference
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.head.landmarks import head_to_scene, pupil_centres
from talkingeyes.head.observation import Observation
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.tracking.cropping import CropSettings, crop_camera, face_crop
from talkingeyes.tracking.face_mesh import FaceDetectionSettings, FaceMesh
from talkingeyes.tracking.video import open_video, read_frames

LINES, CRF, MOST_FRAMES = 224, 35, 250
MOVES_RAD = np.radians(2.0)
TRUTH = ["fit=paper", "fit/smoothing=none", "fit.lightgazefit.solver=newton"]
VARIANTS = {
    "paper, unsmoothed": ["fit=paper", "fit/smoothing=none"],
    "paper": ["fit=paper"],
    "default": ["fit=default"],
    "video": ["fit=video"],
}


def main() -> None:
    """Print a table for each video, and the medians over videos."""
    if not sys.argv[1:]:  # make bench
        print("table8_video: no video given, nothing to measure")
        return
    tables = [table(path) for path in map(Path, sys.argv[1:])]
    print(f"medians over {len(tables)} videos")
    print_rows({name: np.nanmedian([each[name] for each in tables], axis=0) for name in tables[0]})


def table(path: Path) -> dict[str, Float[ndarray, " 7"]]:
    """Print and return the rows of one video."""
    section = compose()["track"]
    crop_settings = CropSettings.model_validate(section["crop"])
    face_settings = FaceDetectionSettings.model_validate(section["face"])
    with open_video(path) as container:
        fps = float(container.streams.video[0].average_rate or 25)
    pictures = [frame.image for frame, _ in zip(read_frames(path, 60.0), range(MOST_FRAMES), strict=False)]
    height = pictures[0].shape[0]
    full = detect_landmarks(pictures, fps, face_settings) * (LINES / height)
    small = detect_landmarks(list(degrade(pictures, fps)), fps, face_settings)
    known = np.isfinite(full).all(axis=(1, 2)) & np.isfinite(small).all(axis=(1, 2))
    if known.mean() < 0.5:
        raise InputError(f"{path}: should show a face in half of its frames at least, got {known.mean():.0%}")
    crop, camera = face_crop(full[known][:, :-2], crop_settings), crop_camera(crop_settings)
    full, small = crop.to_crop(full), crop.to_crop(small)
    large, little = (
        Observation(fps, each[:, :-2], each[:, -2:], known.astype(np.float64), camera) for each in (full, small)
    )
    settings = {name: FitSettings.model_validate(compose(each)["fit"]) for name, each in VARIANTS.items()}
    truth = fit_clip(large, FitSettings.model_validate(compose(TRUTH)["fit"]))
    fits = {"full size": truth} | {name: fit_clip(little, each) for name, each in settings.items()}
    frame_mask = known & ~truth.lids.blinking
    reference = FitReference(large.pupils, camera, frame_mask, truth.motion, truth.motion)
    print(f"{path.name}: {len(full)} frames at {height} lines and at {LINES}, {frame_mask.sum()} counted")
    apart = np.linalg.norm(small[:, -2:] - full[:, -2:], axis=-1)[frame_mask].mean()
    print(f"MediaPipe's pupils at the small and at the full size differ by {apart:.3f} px")
    best, rows = reference.error_sums(truth.motion), {}
    for name, fit in fits.items():
        error_sums = reference.error_sums(fit.motion)
        rows[name] = np.array(
            [
                error_sums.input_distance_px / error_sums.input_distances,
                moving_error(reference, fit.motion),
                error_sums.speed_px_s / error_sums.speeds,
                error_sums.speed_px_s / best.speed_px_s,
                error_sums.peak_px_s / best.peak_px_s if best.peak_px_s else np.nan,
                *gaze_correlations(fit.motion, fit.per_frame, frame_mask),
            ]
        )
    print_rows(rows)
    return rows


def print_rows(rows: dict[str, Float[ndarray, " 7"]]) -> None:
    """Print a header and a line a method."""
    columns = (
        f"{'error px':>9}{'moving px':>11}{'px/s':>8}{'ratio':>7}{'peaks':>7}{'left-right':>12}{'eye on head':>13}"
    )
    print(f"{'method':<20}{columns}")
    for name, (error, moving, speed, ratio, peaks, together, against) in rows.items():
        correlations = f"{together:>12.2f}{against:>13.2f}"
        print(f"{name:<20}{error:>9.3f}{moving:>11.3f}{speed:>8.2f}{ratio:>7.2f}{peaks:>7.2f}{correlations}")


def moving_error(reference: FitReference, motion: Motion) -> float:
    """Mean distance to the pupils at full size, without the mean offset of each eye, pixels."""
    off = (
        reference.camera.project(head_to_scene(pupil_centres(motion.gaze), motion.head, motion.translation))
        - reference.pupils
    )[reference.frame_mask]
    return float(np.linalg.norm(off - off.mean(axis=0), axis=-1).mean())


def gaze_correlations(motion: Motion, per_frame: Motion, frame_mask: ndarray) -> tuple[float, float]:
    """Correlation of left and right yaw in the per-frame fit, and of eye and head yaw after smoothing."""
    yaw = gaze_to_angles(per_frame.gaze)[..., 0]
    width = round(0.5 * motion.fps)
    span = maximum_filter1d(yaw.mean(axis=1), width) - minimum_filter1d(yaw.mean(axis=1), width)
    moves = frame_mask & (span >= MOVES_RAD)
    together = np.corrcoef(yaw[moves].T)[0, 1] if moves.sum() > 2 else np.nan
    against = np.corrcoef(gaze_to_angles(motion.gaze)[frame_mask, :, 0].mean(axis=1), motion.head[frame_mask, 1])[0, 1]
    return float(together), float(against)


def detect_landmarks(
    pictures: list[UInt8[ndarray, "H W 3"]], fps: float, settings: FaceDetectionSettings
) -> Float[ndarray, "T L 2"]:
    """Landmarks and the two pupils of every image, NaN where no face was found."""
    mesh = FaceMesh(settings)
    looks = [mesh.detect(image, index / fps) for index, image in enumerate(pictures)]
    mesh.close()
    empty = np.full((47, 2), np.nan)
    return np.stack([empty if face is None else np.concatenate([face.landmarks, face.pupils]) for face in looks])


def degrade(pictures: list[UInt8[ndarray, "H W 3"]], fps: float) -> Iterator[UInt8[ndarray, "H W 3"]]:
    """The images at LINES lines after H.264 with CRF."""
    import av
    import cv2

    height, width = pictures[0].shape[:2]
    size = (round(width * LINES / height / 2) * 2, LINES)
    with io.BytesIO() as memory:
        with av.open(memory, "w", format="mp4") as container:
            stream = container.add_stream("libx264", rate=round(fps), options={"crf": str(CRF)})
            stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
            for image in pictures:
                small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(small, format="rgb24")))
            container.mux(stream.encode())
        memory.seek(0)
        with av.open(memory, "r") as coded:
            for frame in coded.decode(video=0):
                yield frame.to_ndarray(format="rgb24")


if __name__ == "__main__":
    run_command(main)
