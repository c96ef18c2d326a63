"""What following lids are worth to an observer: an automatic stand-in for the study `eyelid_follow` (docs/study.md).

Eight motions of the packaged default, from a recording that comes with the package or from your sounds in turn, are
rendered on the open head twice: with lids that follow gaze, and with the study's static ones, which blink only. Three
observers estimate gaze in the head: `talkingeyes capture`, LightGazeFit on MediaPipe's pupils (both without the median
offset of a clip), and the place of MediaPipe's iris between the eye corners, mapped to gaze by a line per axis that
half of the frames fit and the other half test. Errors are angles of both eyes' mean gaze, in frames whose lids are less
than half shut: the median of a clip, then the mean over clips, and its difference with a 95 % bootstrap interval over
clips.

Run     python -m pipelines.results.eyelid_follow [SOUND...]      (extra `track`; twelve minutes)
Reads   the packaged model, the open head, conf/
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from PIL import Image

import talkingeyes as te
from talkingeyes.apps.study.films import static_lids
from talkingeyes.apps.study.results import BOOTSTRAP
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.evaluation.bootstrap import bootstrap, mean_statistic
from talkingeyes.head.anny import anny_head
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.head.model import HeadModel
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing
from talkingeyes.tracking.face_mesh import FaceDetectionSettings, FaceMesh
from talkingeyes.workflows.capture import capture

CLIPS, FRAMES, SIZE_PX = 8, slice(25, 125), 480
OPEN_LID = 0.5  # closure below which a frame counts
IRIS = "MediaPipe's iris"


def observed_deg(motion: Motion, head: HeadModel) -> dict[str, Float[ndarray, "T 2"]]:
    """Gaze of both eyes together by each observer; of the iris, its place."""
    view = Framing(0.285, (0.0, 0.030, 0.0)).view(SIZE_PX, SIZE_PX)
    images = list(HeadRenderer(head, view).draw(motion))
    with tempfile.TemporaryDirectory() as folder:
        for frame, image in enumerate(images):
            Image.fromarray(image).save(Path(folder) / f"{frame:04d}.png")
        found = capture([Path(folder)], fps=motion.fps)
    mesh = FaceMesh(FaceDetectionSettings.model_validate(compose()["track"]["face"]))
    places = []
    for frame, image in enumerate(images):
        face = mesh.detect(image, frame / motion.fps)
        if face is None:
            places.append(np.full(2, np.nan))
            continue
        corners = face.landmarks[EYE_LANDMARKS[:, [0, 3]]]
        width = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1, keepdims=True)
        places.append(((face.pupils - corners.mean(axis=1)) / width).mean(axis=0))
    mesh.close()
    return {
        "Eyelid capture": np.degrees(np.mean([track.angles_rad for track in found.tracks], axis=0)),
        "LightGazeFit": np.degrees(gaze_to_angles(found.views[0].fit.motion.gaze).mean(axis=1)),
        IRIS: np.array(places),
    }


def median_errors_deg(name: str, seen: Float[ndarray, "T 2"], motion: Motion) -> Float[ndarray, " 2"]:
    """Median absolute errors of yaw and pitch in the frames that count."""
    true = np.degrees(gaze_to_angles(motion.gaze).mean(axis=1))
    counts = np.isfinite(seen).all(axis=1) & (motion.lid.max(axis=1) < OPEN_LID)
    seen, true = seen[counts], true[counts]
    if name != IRIS:
        return np.asarray(np.median(np.abs(seen - true - np.median(seen - true, axis=0)), axis=0))
    lines = [np.polyfit(seen[::2, axis], true[::2, axis], 1) for axis in range(2)]
    mapped = np.stack([np.polyval(line, seen[1::2, axis]) for axis, line in enumerate(lines)], axis=1)
    return np.asarray(np.median(np.abs(mapped - true[1::2]), axis=0))


def main() -> None:
    """Print a row per observer and axis."""
    sounds = [Path(sound) for sound in sys.argv[1:]] or [package_file(EXAMPLE_SPEECH)]
    motions = [
        te.animate(sounds[seed % len(sounds)], seed=seed).motion.cut(FRAMES.start, FRAMES.stop) for seed in range(CLIPS)
    ]
    heads = {"following": anny_head(), "static": static_lids(anny_head())}
    seen = {name: [observed_deg(motion, head) for motion in motions] for name, head in heads.items()}
    angles = np.degrees(np.concatenate([gaze_to_angles(motion.gaze).mean(axis=1) for motion in motions]))
    print(f"{CLIPS} clips of {FRAMES.stop - FRAMES.start} frames; sd of gaze {angles.std(axis=0).round(1)} degrees")
    print(f"{'observer':<20}{'error of':<10}{'following':>10}{'static':>10}{'static - following':>26}{'worse':>8}")
    for observer in ("Eyelid capture", "LightGazeFit", IRIS):
        errors = {
            name: np.array(
                [
                    median_errors_deg(observer, each[observer], motion)
                    for each, motion in zip(clips, motions, strict=True)
                ]
            )
            for name, clips in seen.items()
        }
        more = errors["static"] - errors["following"]
        for axis, angle in enumerate(("yaw", "pitch")):
            found = bootstrap(mean_statistic(more[:, axis]), CLIPS, BOOTSTRAP)
            print(
                f"{observer:<20}{angle:<10}{errors['following'][:, axis].mean():10.2f}"
                f"{errors['static'][:, axis].mean():10.2f}{found.value:10.2f} ({found.low:5.2f} to {found.high:5.2f})"
                f"{np.sum(more[:, axis] > 0):4d} of {CLIPS}"
            )


if __name__ == "__main__":
    run_command(main)
