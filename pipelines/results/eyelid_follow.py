"""What following lids are worth to an observer: an automatic stand-in for the study `eyelid_follow` (docs/study.md).

The same motions (fixations of 0.3 to 0.9 s, up and down by 10 degrees (sd)) are rendered on the open head twice: with
lids that follow gaze, and with the study's static ones, which blink only. Three observers estimate gaze: `talkingeyes
capture`, LightGazeFit on MediaPipe's pupils (both in the head, without the median offset of a clip), and the place of
MediaPipe's iris between the eye corners, mapped to gaze by a line per axis that half of the frames fit and the other
half test. Errors are angles of both eyes' mean gaze, all frames counted.

Run     python -m pipelines.results.eyelid_follow [CLIPS]      (3 by default; extra `track`; three minutes)
Reads   the open head, conf/
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from PIL import Image

from talkingeyes.apps.study.films import static_lids
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze, gaze_to_angles
from talkingeyes.head.anny import anny_head
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.head.model import HeadModel
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing
from talkingeyes.tracking.face_mesh import FaceDetectionSettings, FaceMesh
from talkingeyes.workflows.capture import capture

FPS, FRAMES, SIZE_PX = 25.0, 100, 480
SPREAD_DEG = (8.0, 10.0)
LIMITS_DEG = np.array([[-20.0, -22.0], [20.0, 15.0]])


def sample_motion(seed: int) -> Motion:
    """Fixations, a still head, no blinks."""
    rng = np.random.default_rng(seed)
    onsets = np.cumsum(rng.uniform(0.3, 0.9, FRAMES))
    fixations = np.radians(np.clip(rng.normal(0.0, SPREAD_DEG, (FRAMES, 2)), *LIMITS_DEG))
    angles = fixations[np.searchsorted(onsets, np.arange(FRAMES) / FPS)]
    return Motion.of(FPS, np.zeros((FRAMES, 3)), angles_to_gaze(np.repeat(angles[:, None], 2, axis=1)))


def observed_deg(motion: Motion, head: HeadModel) -> dict[str, Float[ndarray, "T 2"]]:
    """Gaze of both eyes together by each observer; of the iris, its place."""
    view = Framing(0.285, (0.0, 0.030, 0.0)).view(SIZE_PX, SIZE_PX)
    images = list(HeadRenderer(head, view).draw(motion))
    with tempfile.TemporaryDirectory() as folder:
        for frame, image in enumerate(images):
            Image.fromarray(image).save(Path(folder) / f"{frame:04d}.png")
        found = capture([Path(folder)], fps=FPS)
    mesh = FaceMesh(FaceDetectionSettings.model_validate(compose()["track"]["face"]))
    places = []
    for frame, image in enumerate(images):
        face = mesh.detect(image, frame / FPS)
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
        "MediaPipe's iris": np.array(places),
    }


def errors_deg(name: str, seen: Float[ndarray, "T 2"], true: Float[ndarray, "T 2"]) -> Float[ndarray, "T 2"]:
    """Absolute errors of yaw and pitch of the tested frames."""
    known = np.isfinite(seen).all(axis=1)
    seen, true = seen[known], true[known]
    if name != "MediaPipe's iris":
        return np.asarray(np.abs(seen - true - np.median(seen - true, axis=0)))
    left = []
    for axis in range(2):
        slope, start = np.polyfit(seen[::2, axis], true[::2, axis], 1)
        left.append(np.abs(slope * seen[1::2, axis] + start - true[1::2, axis]))
    return np.stack(left, axis=1)


def main() -> None:
    """Print a row per observer and kind of lids."""
    clips = int(sys.argv[1]) if sys.argv[1:] else 3
    heads = {"following": anny_head(), "static": static_lids(anny_head())}
    print(f"{'observer':<22}{'lids':<12}{'yaw: median, 95 %':>18}{'pitch: median, 95 %':>22}{'looking down':>14}")
    motions = [sample_motion(seed) for seed in range(clips)]
    truths = [np.degrees(gaze_to_angles(motion.gaze[:, 0])) for motion in motions]
    seen = {name: [observed_deg(motion, head) for motion in motions] for name, head in heads.items()}
    for observer in ("Eyelid capture", "LightGazeFit", "MediaPipe's iris"):
        for name, clips_seen in seen.items():
            pairs = [(each[observer], true) for each, true in zip(clips_seen, truths, strict=True)]
            errors = np.concatenate([errors_deg(observer, found, true) for found, true in pairs])
            down = np.concatenate(
                [true[1::2, 1] if "iris" in observer else true[:, 1] for _, true in pairs]
            )  # every face is found
            numbers = [f"{np.percentile(errors[:, axis], share):9.2f}" for axis in range(2) for share in (50, 95)]
            print(f"{observer:<22}{name:<12}{''.join(numbers)}{np.median(errors[down < -10.0, 1]):14.2f}")


if __name__ == "__main__":
    run_command(main)
