"""How lids really move, as far as it is known: the world's own lids, from which the Eyelid model is built.

Lids turn on the eyeball about the axis from corner to corner (Becker & Fuchs 1988; FACTS, section 5): the upper lid
follows the eye down with gain 1 and up with .8 over the first 15 degrees, saturating, the lower lid with .35; people
are not symmetric, and a lid moves by itself (1.2 degrees) while the eye is still. A blink brings the upper lid nine
tenths of the way and the lower lid the rest. Lids lie on two spheres, so the bulge of the cornea, wherever it looks,
lifts them. None of this has the form of the model: gains bend at zero, the lifted lid is no sum of sines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import direction_of_angles
from talkingeyes.head.eyelid.construction import LOWER, UPPER
from talkingeyes.head.eyelid.region import TEMPORAL, Region, elevation

SCLERA_RADIUS_M, CORNEA_RADIUS_M, IRIS_RADIUS_M = 0.0125, 0.0078, 0.0059
CORNEA_CENTRE_M = float(np.sqrt(SCLERA_RADIUS_M**2 - IRIS_RADIUS_M**2) - np.sqrt(CORNEA_RADIUS_M**2 - IRIS_RADIUS_M**2))
IRIS_CENTRE_M = float(np.sqrt(SCLERA_RADIUS_M**2 - IRIS_RADIUS_M**2))
LID_M = 0.0008  # a lid's least distance from the eyeball, where it is not nearer at rest
UPPER_TRAVEL = 0.9
JITTER_RAD = np.radians(1.2)


@dataclass(frozen=True)
class Person:
    """What differs between people, and between the eyes of one: gains by which lids follow small turns of the eye, the
    angles at which the upper lid's lift and fall saturate, how much lower it rests than the head's."""

    upper_down: float = 1.0
    upper_up: float = 0.88
    lower: float = 0.35
    droop_rad: float = 0.0
    lift_rad: float = float(np.radians(24.0))
    fall_rad: float = float(np.radians(75.0))


def draw_person(random: np.random.Generator) -> Person:
    """An eye of somebody: gains within a tenth of the mean, the upper lid up to a few degrees lower or higher."""
    down, up, lower = np.clip(random.normal(1.0, [0.04, 0.06, 0.08]), 0.85, 1.15)
    return Person(
        upper_down=float(down),
        upper_up=float(0.88 * up),
        lower=float(0.35 * lower),
        droop_rad=float(random.normal(0.0, np.radians(1.0))),
        lift_rad=float(np.radians(np.clip(random.normal(24.0, 3.0), 16.0, 32.0))),
        fall_rad=float(np.radians(np.clip(random.normal(75.0, 10.0), 50.0, 100.0))),
    )


def upper_turn_rad(pitch_rad: Float[ndarray, "*N"], person: Person) -> Float[ndarray, "*N"]:
    """How far the upper lid turns upwards with an eye at a pitch: saturating, less upwards than downwards."""
    up, down = np.maximum(pitch_rad, 0.0), np.maximum(-pitch_rad, 0.0)
    lifted = person.upper_up * person.lift_rad * np.tanh(up / person.lift_rad)
    fallen = person.upper_down * person.fall_rad * np.tanh(down / person.fall_rad)
    return np.asarray(lifted - fallen - person.droop_rad)


def lids(
    region: Region,
    angles_rad: Float[ndarray, "T 2"],
    lid: Float[ndarray, " T"],
    person: Person,
    jitter_rad: Float[ndarray, " T"],
) -> Float[ndarray, "T N 3"]:
    """All points of a region, in its coordinates, at gazes (yaw, pitch in the head) and closures."""
    upper, lower = _turns(region, angles_rad[:, 1], lid, person, jitter_rad)
    turned = _turned(region.points, region.upper_share * upper + region.lower_share * lower)
    gaze = direction_of_angles(angles_rad) * TEMPORAL[region.eye]
    ahead = np.array([0.0, 0.0, 1.0])
    distance = np.linalg.norm(region.points, axis=-1)
    clearance = np.minimum(distance - surface_m(region.points / distance[:, None], ahead), LID_M)
    moved = (region.upper_share + region.lower_share) > 0
    reach = np.linalg.norm(turned, axis=-1, keepdims=True)
    unit = turned / reach
    least = surface_m(unit, gaze[:, None, :])[..., None] + clearance[:, None]
    return np.where(moved[:, None], unit * np.maximum(reach, least), turned)


def surface_m(unit: Float[ndarray, "*N 3"], gaze: Float[ndarray, "*M 3"]) -> Float[ndarray, "*N"]:
    """Distance from the centre to the eyeball's surface: the sclera, or the cornea that stands out around the gaze."""
    cosine = (unit * gaze).sum(axis=-1)
    under = CORNEA_RADIUS_M**2 - CORNEA_CENTRE_M**2 * (1.0 - cosine**2)
    cornea = CORNEA_CENTRE_M * cosine + np.sqrt(np.maximum(under, 0.0))
    return np.where(cosine > 0, np.maximum(SCLERA_RADIUS_M, cornea), SCLERA_RADIUS_M)


def iris_contour(
    angles_rad: Float[ndarray, "T 2"], points: int, random: np.random.Generator, noise_m: float
) -> Float[ndarray, "T K 3"]:
    """The circle of the iris, in head axes around the eye's centre, as somebody draws it."""
    around = np.linspace(0, 2 * np.pi, points, endpoint=False)
    gaze = direction_of_angles(angles_rad)
    side = np.cross([0.0, 1.0, 0.0], gaze)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(gaze, side)
    ring = np.cos(around)[:, None] * side[:, None] + np.sin(around)[:, None] * up[:, None]
    drawn = IRIS_CENTRE_M * gaze[:, None] + IRIS_RADIUS_M * ring
    return np.asarray(drawn + random.normal(0.0, noise_m, drawn.shape))


def _turns(
    region: Region,
    pitch_rad: Float[ndarray, " T"],
    lid: Float[ndarray, " T"],
    person: Person,
    jitter_rad: Float[ndarray, " T"],
) -> tuple[Float[ndarray, "T N"], Float[ndarray, "T N"]]:
    """Angles by which the upper and the lower lid turn at each point's place between the corners."""
    follows = upper_turn_rad(pitch_rad, person) + jitter_rad
    inside = np.clip(region.along, 0.0, 1.0)
    reach = np.sqrt(4.0 * inside * (1.0 - inside))  # the corners are held by their ligaments
    place = region.along[UPPER]
    rest = np.interp(inside, place, elevation(region.upper)) - np.interp(
        inside, region.along[LOWER], elevation(region.lower)
    )
    upper, lower = follows[:, None] * reach, (person.lower * pitch_rad)[:, None] * reach
    closing = lid[:, None] * np.maximum(np.maximum(rest, 0.0) + upper - lower, 0.0)
    return upper - UPPER_TRAVEL * closing, lower + (1.0 - UPPER_TRAVEL) * closing


def _turned(points: Float[ndarray, "N 3"], angle_rad: Float[ndarray, "T N"]) -> Float[ndarray, "T N 3"]:
    """Points turned upwards by their angles about the axis from corner to corner."""
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    x, y, z = points.T
    return np.stack([np.broadcast_to(x, angle_rad.shape), cosine * y + sine * z, cosine * z - sine * y], axis=-1)
