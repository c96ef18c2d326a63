"""Errors of `talkingeyes capture` on rendered clips with known truth, and its agreement with LightGazeFit on videos.

Rendered: fixations, head movements and blinks of three heads, the open head (whose lids the model knows) and two other
identities, with lids as gaze puts them and then half closed. Poses are fitted from MediaPipe's landmarks. Errors are
angles between true and captured gaze in the head, and, with the pose's error, in space. Videos: correlation of both
eyes' mean yaw and pitch with LightGazeFit on MediaPipe's pupils, over frames with both eyes trusted.

Run     python -m pipelines.results.eyelid_capture [VIDEO...]      (extra `track`; rendering takes two minutes)
Reads   the open head, conf/
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from PIL import Image

from talkingeyes.core.kinematics import angle_between_deg
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_direction, angles_to_gaze, gaze_to_angles, rotvec_to_matrix
from talkingeyes.head.anny import anny_head
from talkingeyes.head.model import HeadModel
from talkingeyes.orchestration.run import run_command
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import Framing
from talkingeyes.workflows.capture import Capture, capture, summarise

FPS, FRAMES, SIZE_PX = 25.0, 150, 480
LEVELS, LEVEL_FRAMES = (0.0, 0.3, 0.5, 0.65), 38  # closure added to that of gaze, in turn
BINS = ((-0.5, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.75), (0.75, 1.1))
IDENTITY_SD = 0.2  # of the weights of identity shapes, as in conf/fit


@dataclass(frozen=True)
class Errors:
    """Per frame and eye: true closure, errors of gaze in the head and in space (degrees) and of closure, trust."""

    closure: Float[ndarray, " N"]
    in_head_deg: Float[ndarray, " N"]
    in_space_deg: Float[ndarray, " N"]
    closure_error: Float[ndarray, " N"]
    trusted: Bool[ndarray, " N"]


def sample_motion(seed: int) -> Motion:
    """Fixations of 0.3 to 0.9 s, slow head movements, blinks, and lids closed by LEVELS in turn."""
    rng = np.random.default_rng(seed)
    times = np.arange(FRAMES) / FPS
    onsets = np.cumsum(rng.uniform(0.3, 0.9, FRAMES))
    fixations = rng.normal(0.0, np.radians([9.0, 5.0]), (FRAMES, 2))
    angles = fixations[np.searchsorted(onsets, times)]
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    head = sum(
        np.radians(size) * np.sin(2.0 * np.pi * rate * times[:, None] + phase)
        for size, rate, phase in zip(([4.0, 6.0, 2.0], [2.0, 3.0, 1.0]), (0.3, 0.9), phases, strict=True)
    )
    lid = np.array(LEVELS)[np.arange(FRAMES) // LEVEL_FRAMES % len(LEVELS)]
    for start in (20, 85, 130):
        lid[start : start + 6] = np.maximum(lid[start : start + 6], [0.5, 0.95, 1.0, 0.8, 0.5, 0.3])
    gaze = angles_to_gaze(np.repeat(angles[:, None], 2, axis=1))
    return Motion.of(FPS, np.asarray(head), gaze, lid=np.repeat(lid[:, None], 2, axis=1))


def other_identity(seed: int) -> HeadModel:
    """The open head with other identity weights; 0: the mean."""
    head = anny_head()
    weights = (seed > 0) * np.clip(np.random.default_rng(seed).normal(0.0, IDENTITY_SD, len(head.identity)), -0.6, 0.6)
    template = head.template + np.tensordot(weights, head.identity, axes=1)
    joints = head.joints + np.tensordot(weights, head.identity_joints, axes=1)
    return replace(head, template=template.astype(head.template.dtype), joints=joints)


def capture_rendered(seed: int) -> tuple[Motion, Capture]:
    """Render a clip and capture it."""
    motion, view = sample_motion(seed), Framing(0.285, (0.0, 0.030, 0.0)).view(SIZE_PX, SIZE_PX)
    with tempfile.TemporaryDirectory() as folder:
        for frame, image in enumerate(HeadRenderer(other_identity(seed), view).draw(motion)):
            Image.fromarray(image).save(Path(folder) / f"{frame:04d}.png")
        return motion, capture([Path(folder)], fps=FPS)


def measure(motion: Motion, found: Capture) -> Errors:
    """Errors of both eyes."""
    parts = []
    fitted, true = rotvec_to_matrix(found.motion.head), rotvec_to_matrix(motion.head)
    for eye, track in enumerate(found.tracks):
        own, wanted = angles_to_direction(track.angles_rad), angles_to_direction(gaze_to_angles(motion.gaze[:, eye]))
        space = angle_between_deg(np.einsum("tij,tj->ti", fitted, own), np.einsum("tij,tj->ti", true, wanted))
        lid = motion.lid[:, eye]
        parts.append((lid, angle_between_deg(own, wanted), space, track.closure - lid, track.trusted))
    return Errors(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def print_errors(name: str, errors: list[Errors]) -> None:
    """A row per bin of true closure."""
    closure, head, space, lid, trusted = (
        np.concatenate([getattr(each, field) for each in errors])
        for field in ("closure", "in_head_deg", "in_space_deg", "closure_error", "trusted")
    )
    for low, high in BINS:
        rows = (closure >= low) & (closure < high)
        kept = rows & trusted
        numbers = [f"{np.percentile(each[kept], share):8.2f}" if kept.any() else f"{'-':>8}"
                   for each in (head, space) for share in (50, 95)]  # fmt: skip
        print(
            f"{name:<22}{low:5.2f} to {high:4.2f}{rows.sum():7}{''.join(numbers)}"
            f"{np.median(np.abs(lid[rows])):9.3f}{100 * (1 - trusted[rows].mean()):9.0f}"
        )


def print_agreement(path: Path) -> None:
    """A row for a video: agreement with LightGazeFit."""
    found = capture([path])
    summary = summarise(found)
    own = np.degrees(np.stack([track.angles_rad for track in found.tracks], axis=1)).mean(axis=1)
    other = np.degrees(gaze_to_angles(found.views[0].fit.motion.gaze)).mean(axis=1)
    both = found.tracks[0].trusted & found.tracks[1].trusted
    trusted = [summary[side]["trusted"] for side in ("left", "right")]
    text = f"{path.name:<28}{len(own):6}{summary['frames_per_second']:7.0f}{trusted[0]:8.2f}{trusted[1]:6.2f}"
    if both.sum() > 2:
        yaw, pitch = (np.corrcoef(own[both, axis], other[both, axis])[0, 1] for axis in range(2))
        offset, spread = np.median((own - other)[both], axis=0), (own - other)[both].std(axis=0)
        text += f"{yaw:8.2f}{pitch:7.2f}{offset[0]:8.1f}{offset[1]:6.1f}{spread[0]:8.1f}{spread[1]:6.1f}"
    print(text, flush=True)


def main() -> None:
    """Print both tables."""
    if sys.argv[1:]:
        print(f"{'video':<28}{'frames':>6}{'a s':>7}{'trusted':>14}{'yaw, pitch':>15}{'offset':>14}{'spread':>14}")
        for path in map(Path, sys.argv[1:]):
            print_agreement(path)
        return
    rows = [capture_rendered(seed) for seed in range(3)]
    errors = [measure(motion, found) for motion, found in rows]
    print(f"{'gaze error, degrees':<22}{'closure':<12}{'n':>8}{'in head: median, 95 %':>18}{'in space':>14}"
          f"{'closure':>11}{'flagged %':>10}")  # fmt: skip
    print_errors("known lids", errors[:1])
    print_errors("other people", errors[1:])
    speeds = [summarise(found)["frames_per_second"] for _, found in rows]
    print(f"{np.mean(speeds):.0f} frames a second on one core, one view of {SIZE_PX} px")


if __name__ == "__main__":
    run_command(main)
