"""An eyeball mesh: two spheres that meet at the iris circle, sclera and cornea (Elisei et al., 2.1).

Iris and pupil are vertex colours on rings of the cornea, so that their edges are sharp at any image size. The pupil
centre is the apex of the cornea, on the optical axis (+z). Dimensions are those of an adult eye.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

SCLERA_RADIUS_M = 0.0125
CORNEA_RADIUS_M = 0.0078
IRIS_RADIUS_M = 0.0059
CORNEA_CENTRE_M = float(np.sqrt(SCLERA_RADIUS_M**2 - IRIS_RADIUS_M**2) - np.sqrt(CORNEA_RADIUS_M**2 - IRIS_RADIUS_M**2))
APEX_M = CORNEA_CENTRE_M + CORNEA_RADIUS_M
SEGMENTS = 36

# Rings from the apex outwards: distance from the axis in mm, part of the faces inside the ring, linear colour.
_CORNEA_RINGS = (
    (1.0, "pupil", (0.006, 0.006, 0.007)),
    (1.85, "pupil", (0.006, 0.006, 0.007)),
    (2.0, "iris", (0.10, 0.12, 0.10)),
    (2.6, "iris", (0.16, 0.25, 0.30)),
    (3.6, "iris", (0.11, 0.24, 0.34)),
    (4.7, "iris", (0.08, 0.20, 0.32)),
    (5.4, "iris", (0.03, 0.08, 0.13)),
    (5.9, "iris", (0.03, 0.06, 0.09)),
)
# Rings on the sclera: angle from the axis in degrees, linear colour.
_SCLERA_RINGS = (
    (30.0, (0.62, 0.60, 0.58)),
    (33.0, (0.80, 0.78, 0.75)),
    (45.0, (0.82, 0.79, 0.75)),
    (60.0, (0.80, 0.72, 0.68)),
    (75.0, (0.72, 0.55, 0.50)),
    (95.0, (0.60, 0.35, 0.30)),
    (135.0, (0.60, 0.35, 0.30)),
)


@dataclass(frozen=True)
class Eyeball:
    """One eye around its centre, looking along +z. Vertex 0 is the apex; `iris` are the vertices of the iris circle."""

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    parts: tuple[str, ...]
    colours: Float[ndarray, "V 3"]
    iris: Int[ndarray, " K"]


def build_eyeball() -> Eyeball:
    """Build the mesh: an apex, rings of SEGMENTS vertices, the posterior pole."""
    around = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    circle = np.stack([np.cos(around), np.sin(around)], axis=-1)
    rings, colours, parts = [], [], []
    for radius_mm, part, colour in _CORNEA_RINGS:
        radius = radius_mm / 1000
        depth = CORNEA_CENTRE_M + np.sqrt(CORNEA_RADIUS_M**2 - radius**2)
        rings.append(np.column_stack([radius * circle, np.full(SEGMENTS, depth)]))
        colours.append(np.outer(_streaks(around) if part == "iris" else np.ones(SEGMENTS), colour))
        parts.append(part)
    for degrees, colour in _SCLERA_RINGS:
        sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
        rings.append(SCLERA_RADIUS_M * np.column_stack([sine * circle, np.full(SEGMENTS, cosine)]))
        colours.append(np.tile(colour, (SEGMENTS, 1)))
        parts.append("sclera")
    poles = np.array([[0.0, 0.0, APEX_M], [0.0, 0.0, -SCLERA_RADIUS_M]])
    faces, owners = _faces(len(rings))
    return Eyeball(
        vertices=np.concatenate([poles[:1], *rings, poles[1:]]),
        faces=faces,
        parts=tuple([*parts, "sclera"][owner] for owner in owners),
        colours=np.concatenate([[_CORNEA_RINGS[0][2]], *colours, [_SCLERA_RINGS[-1][1]]]),
        iris=1 + SEGMENTS * (len(_CORNEA_RINGS) - 1) + np.arange(SEGMENTS),
    )


def _streaks(around_rad: Float[ndarray, " N"]) -> Float[ndarray, " N"]:
    """Light and dark fibres of an iris: a few waves that do not repeat within the circle."""
    waves = 0.5 * np.cos(7 * around_rad + 0.4) + 0.6 * np.cos(11 * around_rad + 2.0) + 0.5 * np.cos(17 * around_rad)
    return np.asarray(1.0 + 0.16 * waves)


def _faces(rings: int) -> tuple[Int[ndarray, "F 3"], list[int]]:
    """Triangles between apex, rings and posterior pole, counter-clockwise from outside, and the ring of each."""
    here = np.arange(SEGMENTS)
    there = (here + 1) % SEGMENTS
    faces = [np.column_stack([np.zeros(SEGMENTS, int), 1 + here, 1 + there])]
    for ring in range(rings - 1):
        inner, outer = 1 + ring * SEGMENTS, 1 + (ring + 1) * SEGMENTS
        faces.append(np.column_stack([inner + here, outer + here, outer + there]))
        faces.append(np.column_stack([inner + here, outer + there, inner + there]))
    last, pole = 1 + (rings - 1) * SEGMENTS, 1 + rings * SEGMENTS
    faces.append(np.column_stack([last + here, np.full(SEGMENTS, pole), last + there]))
    owners = [0] * SEGMENTS + [ring for ring in range(1, rings) for _ in range(2 * SEGMENTS)] + [rings] * SEGMENTS
    return np.concatenate(faces), owners


def sphere_cap(radius_m: float, half_angle_rad: float) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """The part of a sphere within an angle of +z."""
    around = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    angles = np.linspace(0, half_angle_rad, 9)[1:, None]
    ring = np.stack([np.sin(angles) * np.cos(around), np.sin(angles) * np.sin(around), np.cos(angles) + 0 * around], -1)
    faces, _ = _faces(len(angles))
    open_behind = faces[(faces <= SEGMENTS * len(angles)).all(axis=1)]
    return radius_m * np.concatenate([[[0.0, 0.0, 1.0]], ring.reshape(-1, 3)]), open_behind
