"""The Eyelid model: variance explained by its stages, and errors and speed of capture from images.

Elisei, Bailly & Casari (AVSP 2007). Variance: sections 4.1 and 5.2, on 34 labelled postures per eye as in the paper and
on held-out gazes, for two kinds of lids that are not of the model's form: those of `eyelid.anatomy` (two people), and
the open head's sculpted lids, driven by its own rule. Capture: section 6, on images of that head with lids moved by
that rule and jitter, and a model fitted to 34 of its labelled postures; true gaze and closure are known. The conditions
are those requested in the paper's conclusion. Errors are angles between true and estimated lines of sight, in degrees.

Run     python -m pipelines.results.eyelid [POSTURES]      (24 by default: about two minutes)
Reads   the open head
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.core.kinematics import angle_between_deg
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_direction, angles_to_gaze
from talkingeyes.fitting.analysis_by_synthesis import EyeEstimate, EyeGeometry, PosedImage, estimate_eye
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.anatomy import sample_eyelid_parameters
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES
from talkingeyes.head.eyelid.model import ExplainedVariance, explained_variance, fit_eyelid_model
from talkingeyes.head.eyelid.postures import (
    LidCurveFunction,
    Random,
    anatomical_lid_curves,
    held_out_postures,
    paper_postures,
)
from talkingeyes.head.eyelid.region import TEMPORAL_AXES, EyelidRegion, eyelid_region
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.orchestration.run import run_command
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing, OrbitCamera

PAPER = {"left": (0.61, 0.73), "right": (0.66, 0.799)}
LID_JITTER = 0.03
HELD_OUT = 200
YAWS_DEG = (0.0, 30.0, -30.0)


@dataclass(frozen=True)
class Scene:
    """Postures of both eyes and their images: one list of frames per view."""

    angles_rad: Float[ndarray, "N 2"]
    lid: Float[ndarray, " N"]
    views: list[OrbitCamera]
    frames: list[list[UInt8[ndarray, "H W 3"]]]


@dataclass(frozen=True)
class Disturbance:
    """Errors of the input of capture: image noise, head pose errors, number of views."""

    noise: float = 0.0
    turn_deg: float = 0.0
    shift_m: float = 0.0
    views: int = 3


def sculpted_head() -> HeadModel:
    """The open head without the Eyelid model's shapes: its lids follow the rule for ARKit's shapes."""
    head = anny_head()
    kept = len(head.expression_names) - len(LID_SHAPES)
    return replace(head, expression=head.expression[:kept], expression_names=head.expression_names[:kept])


def motion_of(angles_rad: Float[ndarray, "N 2"], lid: Float[ndarray, "N 2"]) -> Motion:
    """Both eyes in the same postures, the head still."""
    gaze = angles_to_gaze(np.repeat(angles_rad[:, None], 2, axis=1))
    return Motion.of(fps=25.0, head=np.zeros((len(gaze), 3)), gaze=gaze, lid=lid)


def sculpted(head: HeadModel, around: EyelidRegion) -> LidCurveFunction:
    """The lids of the head as curves of a region."""

    def curves(angles_rad: ndarray, lid: ndarray, rng: Random) -> ndarray:
        jittered = lid + rng.normal(0.0, LID_JITTER, len(lid))
        vertices = posed_vertices(
            head, motion_to_pose(head, motion_of(angles_rad, np.repeat(jittered[:, None], 2, axis=1)))
        )
        points = around.curves.of(vertices.astype(np.float64)) - around.centre
        return np.asarray(points * TEMPORAL_AXES[around.eye])

    return curves


def print_variance(head: HeadModel) -> list[EyeGeometry]:
    """Print the table of explained variance; return the models of the sculpted lids."""
    print(f"{'variance of the coordinates explained, %':<41}{'34 postures':<28}200 held-out gazes")
    header = f"{'stage one':>12}{'residual':>10}{'both':>8}"
    print(f"{'lids':<22}{'eye':<7}{header}{header}{'both, open':>12}")
    eyes = []
    for kind in ("anatomy, first person", "anatomy, second", "sculpted, by rule"):
        for eye, side in enumerate(PAPER):
            rng = np.random.default_rng([len(kind), eye])
            around = eyelid_region(head, eye)
            lids = (
                anatomical_lid_curves(around, sample_eyelid_parameters(rng))
                if "anatomy" in kind
                else sculpted(head, around)
            )
            labels = paper_postures(lids, rng)
            model = fit_eyelid_model(labels)
            others = held_out_postures(lids, labels.angles_rad, HELD_OUT, rng)
            is_open = model.lid(others.angles_rad, others.curves) < 0.25
            trained, held_out = explained_variance(model, labels), explained_variance(model, others)
            print(
                f"{kind:<22}{side:<7}{_percent(trained)}{_percent(held_out)}"
                f"{100 * explained_variance(model, others.at(is_open)).both_stages:12.1f}"
            )
            if kind.startswith("sculpted"):
                eyes.append(EyeGeometry(eye, around.centre, model))
    for side, shares in PAPER.items():
        print(f"{'the paper':<22}{side:<7}{_percent(ExplainedVariance(*shares))}")
    return eyes


def render_scene(head: HeadModel, count: int, lids: tuple[float, float], size_px: int, seed: int) -> Scene:
    """Render postures with closures from a range, from three views, as images of `size_px`."""
    rng = np.random.default_rng(seed)
    angles = np.clip(rng.normal(0.0, np.radians([9.0, 7.0]), (count, 2)), *np.radians([[-28, -22], [28, 16]]))
    lid = rng.uniform(*lids, count)
    motion = motion_of(angles, lid[:, None] + rng.normal(0.0, LID_JITTER, (count, 2)))
    views = [Framing(0.285, (0.0, 0.030, 0.0), yaw_deg=yaw).view(size_px, size_px) for yaw in YAWS_DEG]
    return Scene(angles, lid, views, [list(HeadRenderer(head, view).draw(motion)) for view in views])


def print_capture(name: str, scene: Scene, eyes: list[EyeGeometry], wrong: Disturbance) -> None:
    """Print a row: errors of gaze and closure over both eyes, fraction flagged, time."""
    rng = np.random.default_rng(0)
    errors, lids, seconds = [], [], 0.0
    for frame, (angles, lid) in enumerate(zip(scene.angles_rad, scene.lid, strict=True)):
        posed_images = [_disturbed(scene, view, frame, wrong, rng) for view in range(wrong.views)]
        start = time.process_time()
        found: list[EyeEstimate] = [estimate_eye(posed_images, eye) for eye in eyes]
        seconds += time.process_time() - start
        for one in found:
            if not one.nearly_shut:
                errors.append(angle_between_deg(angles_to_direction(one.angles_rad), angles_to_direction(angles)))
                lids.append(abs(one.lid - lid))
    flagged = 1 - len(errors) / (2 * len(scene.lid))
    milliseconds = 1000 * seconds / len(scene.lid)
    if errors:
        median, worst = np.median(errors), np.percentile(errors, 95)
        print(f"{name:<40}{median:8.2f}{worst:8.2f}{np.mean(lids):10.3f}{100 * flagged:10.0f}{milliseconds:10.0f}")
    else:
        print(f"{name:<40}{'-':>8}{'-':>8}{'-':>10}{100 * flagged:10.0f}{milliseconds:10.0f}")


def main() -> None:
    """Print both tables."""
    count = int(sys.argv[1]) if sys.argv[1:] else 24
    head = sculpted_head()
    eyes = print_variance(head)
    print(f"\ncapture of {count} postures, both eyes     gaze error, degrees   closure  flagged   ms a frame")
    print(f"{'condition':<40}{'median':>8}{'95 %':>8}{'error':>10}{'%':>10}{'(CPU)':>10}")
    open_eyes = render_scene(head, count, (0.0, 0.1), 256, 1)
    print_capture("open, three views of 256 px", open_eyes, eyes, Disturbance())
    print_capture("open, one view", open_eyes, eyes, Disturbance(views=1))
    for low, high in ((0.4, 0.6), (0.6, 0.8), (0.9, 1.0)):
        scene = render_scene(head, count, (low, high), 256, 2)
        print_capture(f"closure {low} to {high}", scene, eyes, Disturbance())
    for noise in (0.02, 0.05):
        print_capture(f"open, noise of {100 * noise:.0f} % a channel", open_eyes, eyes, Disturbance(noise=noise))
    for size_px in (128, 512):
        scene = render_scene(head, count, (0.0, 0.1), size_px, 1)
        print_capture(f"open, {size_px} px", scene, eyes, Disturbance())
    for turn_deg, shift_m in ((1.0, 0.0), (2.0, 0.0), (0.0, 0.001)):
        wrong = Disturbance(turn_deg=turn_deg, shift_m=shift_m)
        name = f"open, head {turn_deg:.0f} degrees, {1000 * shift_m:.0f} mm off"
        print_capture(name, open_eyes, eyes, wrong)
    print(f"{'the paper, three views of 720 x 576':<40}{'no figure':>16}{'':>20}{800:10d}  (with a GPU of 2007)")


def _disturbed(scene: Scene, view: int, frame: int, wrong: Disturbance, rng: Random) -> PosedImage:
    image = scene.frames[view][frame] / 255.0
    noisy = np.clip(image + rng.normal(0.0, wrong.noise, image.shape), 0.0, 1.0) if wrong.noise else image
    turn, shift = (_direction(rng) * size for size in (np.radians(wrong.turn_deg), wrong.shift_m))
    return PosedImage(noisy, scene.views[view], turn, shift)


def _direction(rng: Random) -> Float[ndarray, " 3"]:
    free = rng.normal(size=3)
    return np.asarray(free / np.linalg.norm(free))


def _percent(shares: ExplainedVariance) -> str:
    return f"{100 * shares.stage_one:12.1f}{100 * shares.of_residual:10.1f}{100 * shares.both_stages:8.1f}"


if __name__ == "__main__":
    run_command(main)
