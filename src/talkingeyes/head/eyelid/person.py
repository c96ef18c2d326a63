"""The Eyelid model of a person: both eyes, built from labelled curves, saved, and put on any head.

Elisei, Bailly & Casari (AVSP 2007), sections 4.1 and 5.1. First, each eye's centre, the radius of its iris and the gaze
of each posture are those whose projected iris circles are nearest to the labelled contours in all views: the circle
turns about the centre of the eye, at the distance that the two spheres of an average eye give for its radius. Then each
curve is the cubic Bezier curve nearest to its labels, which one view leaves open in depth: there the open head's curve,
in the size of the person's eye, decides (`DEPTH_SD_M`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import least_squares

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.npz import save_npz
from talkingeyes.core.rotation import angles_to_direction, rotvec_to_matrix
from talkingeyes.head.anny import anny_head
from talkingeyes.head.calibrated_camera import CalibratedCamera
from talkingeyes.head.eyelid.anatomy import IRIS_CENTRE_M, IRIS_RADIUS_M
from talkingeyes.head.eyelid.labels import EyelidLabels, LabelledPosture
from talkingeyes.head.eyelid.model import (
    ANCHOR,
    LOWER,
    POINTS,
    UPPER,
    ExplainedVariance,
    EyelidModel,
    LabelledPostures,
    explained_variance,
    fit_eyelid_model,
)
from talkingeyes.head.eyelid.region import TEMPORAL_AXES, eyelid_region

SIDES = ("left", "right")
CURVES = {"upper": UPPER, "lower": LOWER, "anchor": ANCHOR}
LABEL_SD_M = 0.0003  # error of a labelled point
DEPTH_SD_M = 0.002  # of a curve from that of the open head
RADIUS_SD_M = 0.0003  # of the iris radius of people (Hashemi et al. 2015: 11.8 mm white to white, +-0.5)
CORNER_WEIGHT = 3.0  # of the ends of a lid, which correspond in all views
MAX_VALUE = 1e3  # of a model in a file: metres, radians, closures and their ratios
LID_WIDTH_M = (0.01, 0.1)
SAMPLES = 41  # of a Bezier curve
GAZE_GRID_RAD = np.radians([[yaw, pitch] for yaw in range(-40, 41, 10) for pitch in range(-30, 31, 10)])
BOUNDS_M, BOUNDS_RAD = 0.03, 1.5  # of the eye's centre from the open head's, of gaze


@dataclass(frozen=True)
class PersonEye:
    """One eye of a person: centre in head coordinates, radius of the iris, and its Eyelid model."""

    centre: Float[ndarray, " 3"]
    iris_radius_m: float
    lids: EyelidModel


@dataclass(frozen=True)
class EyelidPerson:
    """Both eyes of a person: left, right."""

    eyes: tuple[PersonEye, PersonEye]

    def save(self, path: Path) -> None:
        """Write as npz without pickles."""
        arrays: dict[str, ndarray] = {}
        for side, eye in zip(SIDES, self.eyes, strict=True):
            arrays |= {f"{side}_eye_centre": eye.centre, f"{side}_iris_radius_m": np.array(eye.iris_radius_m)}
            arrays |= {f"{side}_{field.name}": np.array(getattr(eye.lids, field.name)) for field in fields(EyelidModel)}
        with atomic_write(path) as partial:
            save_npz(partial, **arrays)


def _are_plausible(values: ndarray) -> bool:
    """Numbers of the size of metres, radians and closures."""
    return bool(values.dtype.kind in "fiu" and np.isfinite(values).all() and (np.abs(values) < MAX_VALUE).all())


def load_person(path: Path) -> EyelidPerson:
    """Read npz written by `EyelidPerson.save`. Raises InputError if it is not one."""
    shapes = {"eye_centre": (3,), "iris_radius_m": (), "rest": (POINTS, 3), "centre": (4,), "weights": (4, POINTS, 3),
              "blink": (POINTS, 3), "mean_blink": ()}  # fmt: skip
    names = [f"{side}_{name}" for side in SIDES for name in shapes]
    file = read_npz(path, names, "Eyelid model (`talkingeyes eyelid fit`)")
    for name in names:
        shape = shapes[name.partition("_")[2]]
        if name not in file or file[name].shape != shape or not _are_plausible(file[name]):
            raise InputError(f"{path}: should be a model of `talkingeyes eyelid fit`, with {name} of shape {shape}")
        width = np.ptp(file[name], axis=0).max() if name.endswith("_rest") else LID_WIDTH_M[0]
        if not LID_WIDTH_M[0] <= width <= LID_WIDTH_M[1]:
            raise InputError(
                f"{path}: {name} should be a lid of {LID_WIDTH_M[0]} to {LID_WIDTH_M[1]} m, got {width:.3g}"
            )
    eyes = [
        PersonEye(
            file[f"{side}_eye_centre"],
            float(file[f"{side}_iris_radius_m"]),
            EyelidModel(
                rest=file[f"{side}_rest"],
                centre=file[f"{side}_centre"],
                weights=file[f"{side}_weights"],
                blink=file[f"{side}_blink"],
                mean_blink=float(file[f"{side}_mean_blink"]),
            ),
        )
        for side in SIDES
    ]
    return EyelidPerson((eyes[0], eyes[1]))


def fit_person(labels: EyelidLabels) -> tuple[EyelidPerson, tuple[ExplainedVariance, ExplainedVariance]]:
    """Build the model of both eyes, and the variance it explains. Raises InputError if the labels do not suffice."""
    eyes, variances = [], []
    for eye, side in enumerate(SIDES):
        images = [_images(posture, labels.cameras, side) for posture in labels.postures]
        centre, radius, angles = _fit_irises(images, eye)
        curves = np.stack([_fit_curves(views, eye, centre) for views in images])
        kinds = np.array([posture.kind for posture in labels.postures])
        postures = LabelledPostures(angles, curves, held=kinds == "held", shut=kinds == "shut")
        try:
            model = fit_eyelid_model(postures)
        except InputError as error:
            raise InputError(f"{error} (the {side} eye)") from None
        eyes.append(PersonEye(centre, radius, model))
        variances.append(explained_variance(model, postures))
    return EyelidPerson((eyes[0], eyes[1])), (variances[0], variances[1])


@dataclass(frozen=True)
class _Image:
    """The labels of one eye in one view, with the pose of the head."""

    camera: CalibratedCamera
    turn: Float[ndarray, "3 3"]
    translation: Float[ndarray, " 3"]
    curves: dict[str, Float[ndarray, "K 2"]]

    def project(self, points: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
        """Project points in head coordinates."""
        return self.camera.project(points @ self.turn.T + self.translation)

    def px_per_m(self, point: Float[ndarray, " 3"]) -> float:
        """Scale of the image at a point of the head."""
        away = self.turn @ point + self.translation - self.camera.origin
        return self.camera.focal_px / float(np.linalg.norm(away))

    def ahead(self) -> Float[ndarray, " 3"]:
        """Direction of view in head coordinates."""
        return np.asarray(self.camera.turn[2] @ self.turn)


def _images(posture: LabelledPosture, cameras: Sequence[CalibratedCamera], side: str) -> list[_Image]:
    turn, translation = rotvec_to_matrix(np.array(posture.rotation)), np.array(posture.translation_m)
    return [
        _Image(
            cameras[view.camera],
            turn,
            translation,
            {name: np.array(points) for name, points in getattr(view, side).model_dump().items() if points},
        )
        for view in posture.views
    ]


def _fit_irises(images: list[list[_Image]], eye: int) -> tuple[Float[ndarray, " 3"], float, Float[ndarray, "N 2"]]:
    """Centre of the eye, radius of its iris, and gaze (yaw, pitch) of each posture; 0 where no iris is labelled."""
    seen = [(number, image) for number, views in enumerate(images) for image in views if "iris" in image.curves]
    rest = anny_head().eye_centres[eye]
    around = np.linspace(0.0, 2.0 * np.pi, 2 * SAMPLES)

    def apart_sd(image: _Image, centre: ndarray, radius: float, gaze: ndarray) -> Float[ndarray, "K 2"]:
        """From the circle to the contour, in standard deviations of a label."""
        shown = image.project(centre + _iris_ring(gaze, radius, around))
        return np.asarray(_to_polyline(image.curves["iris"], shown) / (LABEL_SD_M * image.px_per_m(centre)))

    def residual(state: Float[ndarray, " U"]) -> Float[ndarray, " R"]:
        centre, radius, angles = rest + state[:3], IRIS_RADIUS_M * state[3], state[4:].reshape(-1, 2)
        gaze = angles_to_direction(angles)
        parts = [np.array([(state[3] - 1.0) * IRIS_RADIUS_M / RADIUS_SD_M])]
        for number, image in seen:
            parts.append(apart_sd(image, centre, radius, gaze[number]).ravel())
        return np.concatenate([*parts, 1e-3 * state[4:]])

    unknown = 4 + 2 * len(images)
    start = np.zeros(unknown)
    start[3] = 1.0
    costs = np.zeros((len(images), len(GAZE_GRID_RAD)))
    for number, image in seen:
        for column, gaze in enumerate(angles_to_direction(GAZE_GRID_RAD)):
            costs[number, column] += (apart_sd(image, rest, IRIS_RADIUS_M, gaze) ** 2).sum()
    start[4:] = GAZE_GRID_RAD[costs.argmin(axis=1)].ravel()
    bounds = np.concatenate([np.full(3, BOUNDS_M), [0.5], np.full(unknown - 4, BOUNDS_RAD)])
    pattern = _iris_pattern([len(image.curves["iris"]) for _, image in seen], [number for number, _ in seen], unknown)
    found = least_squares(
        residual, start, bounds=(start - bounds, start + bounds), x_scale=bounds, jac_sparsity=pattern
    ).x
    labelled = np.isin(np.arange(len(images)), [number for number, _ in seen])
    return rest + found[:3], float(IRIS_RADIUS_M * found[3]), found[4:].reshape(-1, 2) * labelled[:, None]


def _iris_pattern(counts: list[int], postures: list[int], unknown: int) -> ndarray:
    """Which residual depends on which unknown, so that derivatives cost as much as for one posture."""
    rows = [np.eye(1, unknown, 3)]
    for count, number in zip(counts, postures, strict=True):
        row = np.zeros((2 * count, unknown))
        row[:, :4] = 1.0
        row[:, 4 + 2 * number : 6 + 2 * number] = 1.0
        rows.append(row)
    return np.concatenate([*rows, np.eye(unknown)[4:]])


def _iris_ring(gaze: Float[ndarray, " 3"], radius: float, around: Float[ndarray, " K"]) -> Float[ndarray, "K 3"]:
    """The circle of the iris around the eye's centre, in an eye of the average ratio of radii."""
    side = np.cross([0.0, 1.0, 0.0], gaze)
    side /= np.linalg.norm(side)
    up = np.cross(gaze, side)
    flat = np.cos(around)[:, None] * side + np.sin(around)[:, None] * up
    return np.asarray(radius * (IRIS_CENTRE_M / IRIS_RADIUS_M * gaze + flat))


def _fit_curves(images: list[_Image], eye: int, centre: Float[ndarray, " 3"]) -> Float[ndarray, "P 3"]:
    """The curves of one posture around the centre of the eye, +x to the temple, resampled."""
    region = eyelid_region(anny_head(), eye)
    template = region.points[:POINTS] * TEMPORAL_AXES[eye]
    scale = _width_m(images, centre) / float(np.linalg.norm(template[UPPER][-1] - template[UPPER][0]))
    found = np.zeros((POINTS, 3))
    for name, rows in CURVES.items():
        found[rows] = _fit_curve(images, name, centre + scale * template[rows])
    return np.asarray((found - centre) * TEMPORAL_AXES[eye])


def _width_m(images: list[_Image], centre: Float[ndarray, " 3"]) -> float:
    """Distance of the eye corners: the largest that a view shows."""
    return max(
        float(np.linalg.norm(image.curves["upper"][-1] - image.curves["upper"][0])) / image.px_per_m(centre)
        for image in images
    )


def _fit_curve(images: list[_Image], name: str, template: Float[ndarray, "K 3"]) -> Float[ndarray, "K 3"]:
    """The Bezier curve nearest to the labels in all views, as points at equal steps of its length."""
    basis = _bernstein(np.linspace(0.0, 1.0, SAMPLES))
    place = _bernstein(np.linspace(0.0, 1.0, len(template)))
    start = np.linalg.lstsq(place, template, rcond=None)[0]
    ends = 1.0 if name == "anchor" else CORNER_WEIGHT

    def residual(state: Float[ndarray, " U"]) -> Float[ndarray, " R"]:
        control = state.reshape(start.shape)
        curve, parts = basis @ control, []
        for image in images:
            shown, labels = image.project(curve), image.curves[name]
            apart = np.concatenate([_to_polyline(labels, shown), ends * (labels[[0, -1]] - shown[[0, -1]])])
            parts.append((apart / (LABEL_SD_M * image.px_per_m(template[0]))).ravel())
            parts.append((place @ control - template) @ image.ahead() / DEPTH_SD_M)
        return np.concatenate(parts)

    control = least_squares(residual, start.ravel(), x_scale=0.01, ftol=1e-3, max_nfev=30).x.reshape(start.shape)
    fine = basis @ control
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    wanted = np.linspace(0.0, length[-1], len(template))
    return np.stack([np.interp(wanted, length, axis) for axis in fine.T], axis=-1)


def _bernstein(share: Float[ndarray, " N"]) -> Float[ndarray, "N 4"]:
    rest = 1.0 - share
    return np.stack([rest**3, 3.0 * rest**2 * share, 3.0 * rest * share**2, share**3], axis=-1)


def _to_polyline(points: Float[ndarray, "N 2"], line: Float[ndarray, "K 2"]) -> Float[ndarray, "N 2"]:
    """Vectors from the nearest places of a line to points."""
    start, step = line[:-1], np.diff(line, axis=0)
    length = np.maximum((step**2).sum(axis=1), 1e-12)
    share = np.clip(((points[:, None] - start) * step).sum(axis=-1) / length, 0.0, 1.0)
    apart = points[:, None] - start - share[..., None] * step
    nearest = (apart**2).sum(axis=-1).argmin(axis=1)
    return np.asarray(apart[np.arange(len(points)), nearest])
