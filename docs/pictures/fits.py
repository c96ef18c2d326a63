"""Draws fits-face.webp and fits-gaze.webp: fits beside the video that they were made of (TalkingEyes, Fig. 8, 9).

Run     PYTHONPATH=. python docs/pictures/fits.py CORPUS [FOLDER]     (a synthetic corpus, as data/synthesize)
Writes  both pictures; prints the errors of gaze

The video is a rendered clip of 224 pixels, so that no real face is shown; it is as coarse as VoxCeleb2
(pipelines/results/table8.py). Fits get the landmarks and pupils of the simulated detector.
"""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from PIL import Image

from pipelines.results.table8 import QUALITY, RESOLUTION_FACTOR, head_with_identity
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_to_angles, rotvec_to_direction, rotvec_to_matrix
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.clip import FitResult, FitSettings, fit_clip
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import EYE_CENTRES, head_to_scene
from talkingeyes.head.model import HeadModel
from talkingeyes.head.observation import Observation
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS, OrbitCamera

COLUMNS, QUALITY_OUT = 5, 85
FINER = 2  # pixels of a fit's picture for one of the video
RAY_M = 0.15  # from the centre of an eye
EYES_PX = (110, 46)  # of the video, around both eyes
LEAST_S, OPEN_LID = 6.0, 0.2
FITS = {"LightGazeFit, default": "fit=default", "paper's fit": "fit=paper"}
RAY_COLOURS = {"truth": "white", "LightGazeFit, default": "#21d04b", "paper's fit": "#ff7f0e"}


@dataclass(frozen=True)
class Scene:
    """A clip with its video, and frames in which the eyes are open and look to different places."""

    observation: Observation
    truth: Motion
    head: HeadModel
    frames: list[int]

    @property
    def camera(self) -> Camera:
        return self.observation.camera


def read_scene(corpus: Corpus) -> Scene:
    """The clip of the test split whose error by the default fit is the median."""
    clips = [clip for clip in corpus.select("test", take=0) if clip.seconds >= LEAST_S]
    errors = []
    for clip in clips:
        truth, fit = corpus.truth(clip), fitted(corpus.observation(clip), "fit=default")
        errors.append(angle_deg(fit.motion, truth)[truth.lid.max(axis=1) < OPEN_LID].mean())
    clip = clips[int(np.argsort(errors)[len(errors) // 2])]
    print(f"clip {clip.id}, {np.median(errors):.1f} degrees; {len(clips)} clips, mean {np.mean(errors):.1f}")
    observation, truth = corpus.observation(clip), corpus.truth(clip)
    angles, able = gaze_to_angles(truth.gaze).mean(axis=1), np.flatnonzero(truth.lid.max(axis=1) < OPEN_LID)
    chosen = [int(able[np.linalg.norm(angles[able], axis=1).argmax()])]
    while len(chosen) < COLUMNS:
        away = np.linalg.norm(angles[able][:, None] - angles[chosen], axis=-1).min(axis=1)
        chosen.append(int(able[away.argmax()]))
    return Scene(observation, truth, head_with_identity(observation.identity), sorted(chosen))


def fitted(observation: Observation, variant: str) -> FitResult:
    """The fit of a variant of conf/fit/."""
    return fit_clip(observation, FitSettings.model_validate(compose([variant])["fit"]))


def render(head: HeadModel, motion: Motion, frames: list[int], view: OrbitCamera) -> list[np.ndarray]:
    """Pictures of single frames."""
    renderer = HeadRenderer(head, view)
    return [next(renderer.draw(motion.cut(frame, frame + 1))) for frame in frames]


def coarse(picture: np.ndarray) -> np.ndarray:
    """A picture as VoxCeleb2 has it: few pixels, compressed."""
    full = Image.fromarray(picture)
    small = full.resize([round(RESOLUTION_FACTOR * side) for side in full.size], Image.Resampling.BOX)
    with io.BytesIO() as stored:
        small.save(stored, "JPEG", quality=QUALITY)
        return np.asarray(Image.open(stored).convert("RGB").resize(full.size, Image.Resampling.BILINEAR))


def finer(camera: Camera) -> Camera:
    """The same view with more pixels."""
    middle = tuple(FINER * np.asarray(camera.centre_px))
    return replace(
        camera,
        focal_px=FINER * camera.focal_px,
        centre_px=middle,
        width=FINER * camera.width,
        height=FINER * camera.height,
    )


def rays(motion: Motion, frame: int, camera: Camera) -> np.ndarray:
    """Both optical axes as lines of the picture: eye, ends, (x, y)."""
    here = motion.cut(frame, frame + 1)
    start = head_to_scene(EYE_CENTRES[None], here.head, here.translation)[0]
    ahead = rotvec_to_direction(here.gaze)[0] @ rotvec_to_matrix(here.head)[0].T
    return camera.project(np.stack([start, start + RAY_M * ahead], axis=1))


def draw_faces(scene: Scene, video: list[np.ndarray], fit: FitResult, out: Path) -> None:
    """The video with what the detector saw, and the fit from the front and from the side."""
    head, camera = head_with_identity(tuple(fit.face_identity.identity)), finer(scene.camera)
    side = FRAMINGS["left"].centred_on(head.eye_centres).view(camera.width, camera.height)
    rows = {
        "video, detections": video,
        "fit": render(head, fit.motion, scene.frames, OrbitCamera(camera)),
        "fit, from the side": render(head, fit.motion, scene.frames, side),
    }
    figure, axes = _grid(len(rows), 1.0)
    for row, (name, pictures) in zip(axes, rows.items(), strict=True):
        row[0].set_ylabel(name)
        for axis, picture in zip(row, pictures, strict=True):
            axis.imshow(picture)
    for axis, frame in zip(axes[0], scene.frames, strict=True):
        axis.set_title(f"{frame / scene.truth.fps:.2f} s")
        axis.scatter(*scene.observation.landmarks[frame].T, s=2.5, color="#00a0ff")
        axis.scatter(*scene.observation.pupils[frame].T, s=5, color="#ff2020")
    figure.savefig(out, dpi=100, pil_kwargs={"quality": QUALITY_OUT})


def draw_gaze(scene: Scene, video: list[np.ndarray], fits: dict[str, FitResult], out: Path) -> None:
    """The eyes of the video, of the truth and of the fits, with their optical axes and the angle to the truth."""
    motions = {"truth": scene.truth, **{name: fit.motion for name, fit in fits.items()}}
    camera, fine = scene.camera, finer(scene.camera)
    figure, axes = _grid(len(motions) + 1, EYES_PX[1] / EYES_PX[0])
    axes[0, 0].set_ylabel("video")
    for axis, frame, picture in zip(axes[0], scene.frames, video, strict=True):
        axis.imshow(picture, extent=(0, camera.width, camera.height, 0))
        axis.set_title(f"{frame / scene.truth.fps:.2f} s")
    for row, (name, motion) in zip(axes[1:], motions.items(), strict=True):
        row[0].set_ylabel(name.replace(", ", ",\n"))
        pictures = render(scene.head, motion, scene.frames, OrbitCamera(fine))
        degrees = angle_deg(motion, scene.truth)
        for axis, frame, picture in zip(row, scene.frames, pictures, strict=True):
            axis.imshow(picture, extent=(0, camera.width, camera.height, 0))
            for shown in dict.fromkeys(("truth", name)):
                for line in rays(motions[shown], frame, camera):
                    axis.plot(*line.T, color=RAY_COLOURS[shown], linewidth=1.8 if shown == "truth" else 1.2)
            if name != "truth":
                axis.set_xlabel(f"{degrees[frame].mean():.1f}°", labelpad=1, fontsize=9)
    for column, frame in enumerate(scene.frames):
        middle = rays(scene.truth, frame, camera)[:, 0].mean(axis=0)
        for axis in axes[:, column]:
            axis.set(xlim=middle[0] + np.array([-0.5, 0.5]) * EYES_PX[0])
            axis.set(ylim=middle[1] + np.array([0.5, -0.5]) * EYES_PX[1])
    figure.savefig(out, dpi=100, pil_kwargs={"quality": QUALITY_OUT})


def angle_deg(motion: Motion, truth: Motion) -> np.ndarray:
    """Angle between the axes of both in the head, per frame and eye."""
    cosine = np.sum(rotvec_to_direction(motion.gaze) * rotvec_to_direction(truth.gaze), axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _grid(rows: int, aspect: float) -> tuple[plt.Figure, np.ndarray]:
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(11, 0.4 + rows * (0.2 + 10.5 / COLUMNS * aspect)), layout="constrained", squeeze=False
    )
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
    return figure, axes


def main() -> None:
    """Both pictures."""
    folder = Path(sys.argv[2]) if sys.argv[2:] else Path(__file__).resolve().parent
    scene = read_scene(Corpus(Path(sys.argv[1])))
    fits = {name: fitted(scene.observation, variant) for name, variant in FITS.items()}
    video = [coarse(each) for each in render(scene.head, scene.truth, scene.frames, OrbitCamera(scene.camera))]
    draw_faces(scene, video, fits["LightGazeFit, default"], folder / "fits-face.webp")
    draw_gaze(scene, video, fits, folder / "fits-gaze.webp")
    open_eyes = scene.truth.lid.max(axis=1) < OPEN_LID
    for name, fit in fits.items():
        degrees = angle_deg(fit.motion, scene.truth)
        print(
            f"{name}: {degrees[open_eyes].mean():.1f} degrees, in the frames shown {degrees[scene.frames].mean():.1f}"
        )


if __name__ == "__main__":
    configure_environment()
    main()
