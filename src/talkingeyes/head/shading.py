"""Light on a head: a sky, three lamps, warm light that wraps round skin, highlights where it is moist.

Colours are linear; `to_pixels` turns them into sRGB. Lamps stand in the room, so a head that turns changes its shades.
Wrapped diffuse light with a tint at its edge stands for light under the skin (Green, GPU Gems 2004, chapter 16).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from talkingeyes.head.model import PARTS


@dataclass(frozen=True)
class Lamp:
    """Direction to the lamp, and its colour times strength."""

    towards: tuple[float, float, float]
    colour: tuple[float, float, float]


LAMPS = (
    Lamp((-0.45, 0.55, 0.75), (0.86, 0.82, 0.77)),
    Lamp((0.80, 0.15, 0.60), (0.22, 0.25, 0.29)),
    Lamp((0.35, 0.55, -0.75), (0.45, 0.47, 0.52)),
)
SKY, GROUND = np.array([0.38, 0.40, 0.44], np.float32), np.array([0.21, 0.17, 0.15], np.float32)
WRAP = 0.35  # how far beyond the terminator light still reaches on skin
TINT = np.array([1.0, 0.55, 0.40], np.float32)  # of that light
BACKGROUND = np.array([0.62, 0.67, 0.72], np.float32)

# Strength and sharpness of the highlight of each part.
_GLOSS = {"lips": (0.16, 24), "sclera": (0.55, 160), "iris": (0.9, 220), "pupil": (0.9, 220), "teeth": (0.4, 60)}
_GLOSS |= {"tissue": (0.25, 40), "tongue": (0.2, 24), "skin": (0.075, 14), "brow": (0.02, 8)}
STRENGTH = np.array([_GLOSS[part][0] for part in PARTS], np.float32)
SHARPNESS = np.array([_GLOSS[part][1] for part in PARTS], np.float32)
EYE = np.isin(PARTS, ["sclera", "iris", "pupil"])
MATT = np.isin(PARTS, ["sclera", "iris", "pupil", "teeth"])  # no light under the surface


@dataclass(frozen=True)
class Surface:
    """What rays met. `looking` are the rays' unit directions, `sky` the share of the sky seen, `lit` of the lamps."""

    normals: Float[ndarray, "N 3"]
    looking: Float[ndarray, "N 3"]
    colours: Float[ndarray, "N 3"]
    sky: Float[ndarray, " N"]
    lit: Float[ndarray, " N"]
    parts: Int[ndarray, " N"]


def shade(surface: Surface) -> Float[ndarray, "N 3"]:
    """Light that comes back along each ray."""
    normals, parts = surface.normals, surface.parts
    upward = 0.5 + 0.5 * normals[:, 1:2]
    light = (GROUND + upward * (SKY - GROUND)) * surface.sky[:, None]
    shine = np.zeros(len(parts), np.float32)
    soft = np.where(MATT[parts], 0.0, WRAP).astype(np.float32)
    reach = surface.lit * (0.35 + 0.65 * surface.sky)
    sharpness = SHARPNESS[parts]
    for lamp in LAMPS:
        towards = np.array(lamp.towards, np.float32)
        towards /= np.linalg.norm(towards)
        cosine = normals @ towards
        direct = np.maximum(cosine, 0.0)
        wrapped = np.maximum((cosine + soft) / (1 + soft), 0.0)
        around = direct[:, None] + (wrapped - direct)[:, None].clip(0) * TINT
        light += (reach[:, None] * around) * np.array(lamp.colour, np.float32)
        half = towards - surface.looking
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        facing = np.maximum(np.einsum("nd,nd->n", normals, half), 1e-6)
        shine += np.exp(sharpness * np.log(facing)) * (cosine > 0) * lamp.colour[1]
    edge = 1 - np.maximum(-np.einsum("nd,nd->n", normals, surface.looking), 0)
    shine *= STRENGTH[parts] * (1 + 3 * edge**3) * surface.lit * surface.sky
    return np.asarray(surface.colours * light + shine[:, None])


_LEVELS = 4096
_SRGB = np.linspace(0, 1, _LEVELS)
_SRGB = np.where(_SRGB <= 0.0031308, 12.92 * _SRGB, 1.055 * _SRGB ** (1 / 2.4) - 0.055)
_PIXELS = np.rint(255 * _SRGB).astype(np.uint8)


def to_pixels(light: Float[ndarray, "*N 3"]) -> UInt8[ndarray, "*N 3"]:
    """Linear light to sRGB bytes, bright parts softly limited."""
    limited = np.where(light > 0.7, 1 - 0.09 / np.maximum(light - 0.4, 0.3), light)
    return np.asarray(_PIXELS[(np.clip(limited, 0, 1) * (_LEVELS - 1)).astype(np.int32)])
