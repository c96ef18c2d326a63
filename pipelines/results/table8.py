"""Table VIII on a synthetic corpus: pupils, gaze, saccades and blinks of three methods against the truth.

Rows    ground truth; `appearance`, a small network trained here on rendered eyes of other heads; `paper`, LightGazeFit
        and a temporal convolution as printed (fit=paper), and the same unsmoothed; `default`, with the temporal terms,
        priors and constraints of conf/fit/default.yaml; both fits with the noise of an image of 0.6 of the resolution.
All methods run at 224 x 224 and use the same head poses, except for distances (each method's own). The images for
`appearance` are degraded like those of VoxCeleb2: 0.6 of the pixels per side, JPEG of quality 35. It is given the true
head pose and eye positions, and its training eyes differ from the clip's in skin and shape only, so it is an upper
bound for its kind.

Run     python -m pipelines.results.table8 [CORPUS [SPLIT [CLIPS]]]      about two minutes of one core for 4 clips
Reads   a corpus with truth (data/synthesize), conf/
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.core.rotation import angles_to_gaze, direction_to_rotvec, rotvec_to_direction, rotvec_to_matrix
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.accuracy import ErrorSums, FitReference
from talkingeyes.fitting.clip import FitResult, FitSettings, fit_clip
from talkingeyes.fitting.comparison import BlinkMatches, blink_frames, match_blinks
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import EYE_CENTRES, head_to_scene
from talkingeyes.head.model import HeadModel
from talkingeyes.head.observation import Observation
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import OrbitCamera
from talkingeyes.synthesis.detector_noise import NoiseSettings
from talkingeyes.synthesis.observations import observe

STRIP = (96, 176)  # rows and columns of an image around both eyes
EYE = (32, 48)  # of the network's input for one eye
RESOLUTION_FACTOR, QUALITY = 0.6, 35  # like VoxCeleb2: fraction of the pixels per side, JPEG quality
HEADS, FRAMES_A_HEAD, EPOCHS = 10, 60, 30


@dataclass(frozen=True)
class Case:
    """A clip with its ground truth."""

    observation: Observation
    motion: Motion
    events: Events

    @property
    def without_blinks(self) -> Bool[ndarray, " T"]:
        """The frames outside true blinks."""
        return ~blink_frames(self.events, len(self.motion), self.motion.fps)


def read_cases(arguments: list[str]) -> list[Case]:
    """Clips by [CORPUS [SPLIT [CLIPS]]]; none, with a message, if there is no default corpus."""
    root, split, count = [*arguments[:3], *("data/synthesize", "val", "4")[len(arguments) :]]
    if not arguments and not Path(root).exists():  # make bench
        print(f"no corpus in {root} (make repro), nothing to measure")
        return []
    corpus = Corpus(Path(root))
    clips = corpus.select(split, take=0)[: int(count)]
    if not corpus.has_truth or not clips:
        raise InputError(f"{root}: should have truth and clips of {split}, got {len(clips)} clips")
    print(f"{len(clips)} clips of {split}; frames without blinks")
    return [Case(corpus.observation(clip), corpus.truth(clip), corpus.truth_events(clip)) for clip in clips]


def main() -> None:
    """Print the table."""
    cases = read_cases(sys.argv[1:])
    if not cases:
        return
    network = train()
    noise = NoiseSettings.model_validate(compose()["synthesize"]["noise"])
    coarse = [reobserved(case, noise, index) for index, case in enumerate(cases)]
    methods: dict[str, Callable[[], list[FitResult | Motion]]] = {
        "ground truth": lambda: [case.motion for case in cases],
        "appearance": lambda: [predict_gaze(network, case) for case in cases],
        "paper, unsmoothed": lambda: fitted(cases, "fit=paper", "fit/smoothing=none"),
        "paper": lambda: fitted(cases, "fit=paper"),
        "default": lambda: fitted(cases, "fit=default"),
        "paper, coarse": lambda: fitted(coarse, "fit=paper"),
        "default, coarse": lambda: fitted(coarse, "fit=default"),
    }
    print(
        f"{'method':<22}{'error px':>9}{'px/s':>7}{'ratio':>7}{'degrees':>9}{'peaks':>7}{'blinks: precision, recall':>28}"  # noqa: E501
    )
    truth = None
    for name, made in methods.items():
        results = made()
        row = score_method(cases, results)
        truth = truth or row
        print(line(name, row, truth, results, cases))


@dataclass(frozen=True)
class Score:
    """Error sums and mean gaze error, pooled over clips."""

    error_sums: ErrorSums
    degrees: float


def score_method(cases: list[Case], results: list[FitResult | Motion]) -> Score:
    """Distances, speeds and peaks, and the mean angle between fitted and true gaze in the head."""
    total, angles = ErrorSums(), []
    for case, result in zip(cases, results, strict=True):
        motion = result.motion if isinstance(result, FitResult) else result
        frame_mask = case.without_blinks
        pupils_px = case.observation.pupils
        total += FitReference(pupils_px, case.observation.camera, frame_mask, case.motion, case.motion).error_sums(
            motion
        )
        cosine = np.sum(rotvec_to_direction(motion.gaze) * rotvec_to_direction(case.motion.gaze), axis=-1)[frame_mask]
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))).ravel())
    return Score(total, float(np.concatenate(angles).mean()))


def line(name: str, row: Score, truth: Score, results: list[FitResult | Motion], cases: list[Case]) -> str:
    """A row of the table."""
    error_sums, best = row.error_sums, truth.error_sums
    speed = error_sums.speed_px_s / error_sums.speeds
    found = [
        match_blinks(result.lids.blinks, case.events, case.motion.fps)
        for result, case in zip(results, cases, strict=True)
        if isinstance(result, FitResult)
    ]
    blinks = sum(found, BlinkMatches())
    shown = f"{blinks.precision:>20.3f}, {blinks.recall:.3f}" if found else f"{'':>28}"
    return (
        f"{name:<22}{error_sums.truth_distance_px / error_sums.truth_distances:>9.3f}{speed:>7.2f}"
        f"{error_sums.speed_px_s / best.speed_px_s:>7.2f}"
        f"{row.degrees:>9.2f}{error_sums.peak_px_s / best.peak_px_s:>7.2f}{shown}"
    )


def fitted(cases: list[Case], *variant: str) -> list[FitResult | Motion]:
    """Fit every clip with a variant of conf/fit/."""
    settings = FitSettings.model_validate(compose([*variant])["fit"])
    return [fit_clip(case.observation, settings) for case in cases]


def reobserved(case: Case, noise: NoiseSettings, seed: int) -> Case:
    """The clip as detected in an image of RESOLUTION_FACTOR of the resolution."""
    seen, rng = case.observation, np.random.default_rng(seed)
    coarse = noise.model_copy(update={"resolution": RESOLUTION_FACTOR})
    return replace(case, observation=observe(case.motion, seen.camera, coarse, rng, seen.identity))


def head_with_identity(identity: tuple[float, ...], shade: float = 1.0) -> HeadModel:
    """The open head with a person's shape, with the mean head's eye positions and a lighter or darker skin."""
    head = anny_head()
    weights = np.array(identity or np.zeros(len(head.identity_names)))
    centres = EYE_CENTRES + np.tensordot(weights, head.identity_joints[:, 3:], axes=1)
    scale = np.ptp(EYE_CENTRES[:, 0]) / np.ptp(centres[:, 0])

    def onto(points: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
        return np.asarray(EYE_CENTRES.mean(axis=0) + scale * (points - centres.mean(axis=0)))

    template = onto(head.template + np.tensordot(weights, head.identity, axes=1)).astype(head.template.dtype)
    joints = onto(head.joints + np.tensordot(weights, head.identity_joints, axes=1)).astype(head.joints.dtype)
    skin = head.vertices_of("skin", "lips")
    colours = head.colours.copy()
    colours[skin] = np.clip(colours[skin] * shade, 0, 1)
    return replace(head, template=template, joints=joints, colours=colours)


def strips(head: HeadModel, motion: Motion, camera: Camera) -> Iterator[Float[ndarray, "2 H W"]]:
    """Grey images of both eyes in every frame, degraded, the right one mirrored, for the pose of `motion`."""
    from PIL import Image

    centres = camera.project(head_to_scene(np.tile(EYE_CENTRES, (len(motion), 1, 1)), motion.head, motion.translation))
    corner = np.round(centres.mean(axis=(0, 1)) - np.array(STRIP[::-1]) / 2)
    middle = tuple((np.asarray(camera.centre_px) - corner).tolist())
    near = replace(camera, centre_px=middle, width=STRIP[1], height=STRIP[0])
    for picture, at in zip(HeadRenderer(head, OrbitCamera(near)).draw(motion), centres - corner, strict=True):
        small = Image.fromarray(picture).resize(
            (round(STRIP[1] * RESOLUTION_FACTOR), round(STRIP[0] * RESOLUTION_FACTOR)), Image.Resampling.BOX
        )
        with io.BytesIO() as stored:
            small.save(stored, "JPEG", quality=QUALITY)
            grey = Image.open(stored).convert("L").resize((STRIP[1], STRIP[0]), Image.Resampling.BILINEAR)
        eyes = [np.asarray(grey.crop(_box(centre)), np.float32) / 255 for centre in at]
        yield np.stack([eyes[0], eyes[1][:, ::-1]])


def _box(centre: Float[ndarray, " 2"]) -> tuple[int, int, int, int]:
    left, top = round(float(centre[0]) - EYE[1] / 2), round(float(centre[1]) - EYE[0] / 2)
    return left, top, left + EYE[1], top + EYE[0]


def in_camera_axes(motion: Motion) -> Float[ndarray, "T 2 2"]:
    """Target of the network: x and y of gaze directions in space, with x mirrored for the right eye."""
    looking = np.einsum("tij,tej->tei", rotvec_to_matrix(motion.head), rotvec_to_direction(motion.gaze))[..., :2]
    looking[:, 1, 0] *= -1
    return np.asarray(looking)


def train() -> Any:
    """Train a small convolutional network for gaze of single eyes on rendered eyes of HEADS other heads."""
    import torch

    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    camera = Camera(1154 * 0.925, (112.0, 120.0), 1.0, 224, 224)
    images, targets = [], []
    for _ in range(HEADS):
        head = head_with_identity(tuple(0.2 * rng.standard_normal(6)), float(rng.uniform(0.6, 1.15)))
        motion = random_poses(rng)
        images.append(np.stack(list(strips(head, motion, camera))))
        targets.append(in_camera_axes(motion))
    inputs = torch.from_numpy(np.concatenate(images).reshape(-1, 1, *EYE))
    wanted = torch.from_numpy(np.concatenate(targets).reshape(-1, 2)).float()
    network = torch.nn.Sequential(
        *(torch.nn.Conv2d(1, 16, 5, 2, 2), torch.nn.ReLU(), torch.nn.Conv2d(16, 32, 3, 2, 1), torch.nn.ReLU()),
        *(torch.nn.Conv2d(32, 64, 3, 2, 1), torch.nn.ReLU(), torch.nn.Flatten()),
        *(torch.nn.Linear(64 * EYE[0] * EYE[1] // 64, 64), torch.nn.ReLU(), torch.nn.Linear(64, 2)),
    )
    optimiser = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=1e-2)
    for _ in range(EPOCHS):
        for rows in torch.split(torch.randperm(len(inputs)), 64):
            batch = inputs[rows] * (0.8 + 0.4 * torch.rand(len(rows), 1, 1, 1)) + 0.02 * torch.randn(len(rows), 1, *EYE)
            loss = (network(batch) - wanted[rows]).square().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    return network


def random_poses(rng: np.random.Generator) -> Motion:
    """FRAMES_A_HEAD unrelated frames: heads, gaze and lids as in speech, with a somewhat wider range."""
    angles = np.radians(rng.normal(0, [12.0, 8.0], (FRAMES_A_HEAD, 1, 2)) + np.array([[3.5, 0.0], [-3.5, 0.0]]))
    lid = np.repeat(rng.normal(0.0, 0.08, (FRAMES_A_HEAD, 1)), 2, axis=1)
    head = np.radians(rng.normal(0, [6.0, 8.0, 3.0], (FRAMES_A_HEAD, 3)))
    return Motion.of(25.0, head, angles_to_gaze(np.clip(angles, -0.6, 0.6)), lid=lid)


def predict_gaze(network: Any, case: Case) -> Motion:
    """Gaze predicted by the network for each frame of the rendered clip, under the true head pose."""
    import torch

    motion = case.motion
    pictures = np.stack(list(strips(head_with_identity(case.observation.identity), motion, case.observation.camera)))
    with torch.no_grad():
        told = network(torch.from_numpy(pictures.reshape(-1, 1, *EYE))).numpy().reshape(-1, 2, 2).astype(np.float64)
    told[:, 1, 0] *= -1
    ahead = np.sqrt(np.maximum(1 - np.sum(told**2, axis=-1), 0.1))
    looking = np.concatenate([told, ahead[..., None]], axis=-1)
    looking /= np.linalg.norm(looking, axis=-1, keepdims=True)
    return replace(motion, gaze=direction_to_rotvec(np.einsum("tji,tej->tei", rotvec_to_matrix(motion.head), looking)))


if __name__ == "__main__":
    run_command(main)
