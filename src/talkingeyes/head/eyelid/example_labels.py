"""An example of a file of labelled curves: the open head in the paper's 34 postures, seen by three cameras.

`talkingeyes eyelid example` writes it. Curves are those of the posed head, with an error of 0.3 mm; of the iris, the
part between the lids. Postures of speech that show no iris are left out, as a person would who labels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze, matrix_to_rotvec, rotvec_to_matrix
from talkingeyes.head.anny import anny_head
from talkingeyes.head.calibrated_camera import CalibratedCamera
from talkingeyes.head.eyelid.anatomy import iris_contour
from talkingeyes.head.eyelid.labels import SCHEMA
from talkingeyes.head.eyelid.model import ANCHOR, LOWER, POINTS, UPPER
from talkingeyes.head.eyelid.postures import HELD_RAD, IRIS_POINTS, LABEL_NOISE_M, SPEECH_POSTURES, speech_postures
from talkingeyes.head.eyelid.region import TEMPORAL_AXES, eyelid_region
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices

YAWS_DEG, DISTANCE_M, FOCAL_PX, CENTRE_PX = (0.0, 30.0, -30.0), 0.9, 2400.0, (600.0, 350.0)
SIDES = ("left", "right")
DIGITS = 2


def example_cameras() -> list[CalibratedCamera]:
    """Three cameras around the eyes: from ahead, and 30 degrees to either side."""
    middle, facing = anny_head().eye_centres.mean(axis=0), np.diag([1.0, -1.0, -1.0])
    found = []
    for yaw in np.radians(YAWS_DEG):
        turn = facing @ rotvec_to_matrix(np.array([0.0, -yaw, 0.0]))
        rotation = matrix_to_rotvec(turn)
        translation = np.array([0.0, 0.0, DISTANCE_M]) - turn @ middle
        found.append(
            CalibratedCamera(
                focal_px=FOCAL_PX,
                centre_px=CENTRE_PX,
                rotation=tuple(rotation.round(6).tolist()),
                translation_m=tuple(translation.round(6).tolist()),
            )
        )
    return found


def example_labels(seed: int = 0) -> dict[str, Any]:
    """The content of the file: nine held gazes, closed lids, and 24 postures of speech; both eyes alike."""
    rng = np.random.default_rng(seed)
    speech, closures = speech_postures(SPEECH_POSTURES, rng)
    angles = np.concatenate([HELD_RAD, np.zeros((1, 2)), speech])
    lid = np.concatenate([np.zeros(len(HELD_RAD)), [1.0], closures])
    kinds = ["held"] * len(HELD_RAD) + ["shut"] + ["speech"] * SPEECH_POSTURES
    cameras = example_cameras()
    curves = [_curves(eye, angles, lid) for eye in range(2)]
    postures = []
    for number, kind in enumerate(kinds):
        views: list[dict[str, Any]] = []
        for camera, seen in enumerate(cameras):
            sides = {side: _labels(curves[eye], number, eye, seen, rng) for eye, side in enumerate(SIDES)}
            views.append({"camera": camera, **sides})
        if kind == "speech" and not all(views[0][side]["iris"] for side in SIDES):
            continue
        postures.append({"name": f"{kind} {number}", "kind": kind, "views": views})
    return {"schema": SCHEMA, "cameras": [camera.model_dump(mode="json") for camera in cameras], "postures": postures}


def _curves(
    eye: int, angles_rad: Float[ndarray, "N 2"], lid: Float[ndarray, " N"]
) -> tuple[Float[ndarray, "N P 3"], Float[ndarray, "N K 3"]]:
    """Lid curves and iris circles of the posed head, in head coordinates."""
    head, region = anny_head(), eyelid_region(anny_head(), eye)
    gaze = angles_to_gaze(np.repeat(angles_rad[:, None], 2, axis=1))
    motion = Motion.of(25.0, np.zeros((len(lid), 3)), gaze, lid=np.repeat(lid[:, None], 2, axis=1))
    vertices = posed_vertices(head, motion_to_pose(head, motion)).astype(np.float64)
    rings = iris_contour(angles_rad, 2 * IRIS_POINTS, np.random.default_rng(0), 0.0)
    return region.curves.of(vertices)[:, :POINTS], rings + region.centre


def _labels(
    curves: tuple[Float[ndarray, "N P 3"], Float[ndarray, "N K 3"]],
    number: int,
    eye: int,
    camera: CalibratedCamera,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """The curves of one eye in one image."""
    lids, ring = curves[0][number], curves[1][number]
    order = np.argsort(lids[UPPER, 0] * TEMPORAL_AXES[eye, 0])
    upper, lower = (np.interp(ring[:, 0] * TEMPORAL_AXES[eye, 0], lids[rows][order, 0] * TEMPORAL_AXES[eye, 0],
                              lids[rows][order, 1]) for rows in (UPPER, LOWER))  # fmt: skip
    visible = ring[(ring[:, 1] < upper) & (ring[:, 1] > lower)]
    noise_px = LABEL_NOISE_M * FOCAL_PX / DISTANCE_M / np.sqrt(2.0)

    def drawn(points: Float[ndarray, "K 3"]) -> list[list[float]]:
        shown = camera.project(points)
        return (shown + rng.normal(0.0, noise_px, shown.shape)).round(DIGITS).tolist()  # type: ignore[no-any-return]

    return {
        "iris": drawn(visible) if len(visible) >= IRIS_POINTS // 2 else None,
        "upper": drawn(lids[UPPER]),
        "lower": drawn(lids[LOWER]),
        "anchor": drawn(lids[ANCHOR]),
    }
