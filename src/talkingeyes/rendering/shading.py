"""Shading of a head: a sky, three lamps, subsurface scattering of skin, highlights of moist parts.

Diffuse light is computed at vertices; highlights of eyes, lips and teeth at every pixel, from interpolated normals.
Colours are linear; `to_pixels` converts them to sRGB. Lamps are fixed in the scene, so shading changes with head
rotation. Wrapped diffuse light with a tint at its edge approximates subsurface scattering (Green, GPU Gems 2004,
chapter 16).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from talkingeyes.head.model import PARTS


@dataclass(frozen=True)
class DirectionalLight:
    """Direction to the lamp, and its colour times intensity."""

    towards: tuple[float, float, float]
    colour: tuple[float, float, float]

    @property
    def direction(self) -> Float[ndarray, " 3"]:
        """Unit vector to the lamp."""
        towards = np.array(self.towards, np.float32)
        return np.asarray(towards / np.linalg.norm(towards))


LAMPS = (
    DirectionalLight((-0.45, 0.55, 0.75), (0.86, 0.82, 0.77)),
    DirectionalLight((0.80, 0.15, 0.60), (0.22, 0.25, 0.29)),
    DirectionalLight((0.35, 0.55, -0.75), (0.45, 0.47, 0.52)),
)
SKY, GROUND = np.array([0.38, 0.40, 0.44], np.float32), np.array([0.21, 0.17, 0.15], np.float32)
WRAP = 0.35  # how far diffuse light extends beyond the terminator on skin
TINT = np.array([1.0, 0.55, 0.40], np.float32)  # of the light beyond it
BACKGROUND = np.array([0.62, 0.67, 0.72], np.float32)

SKIN_STRENGTH, SKIN_SHARPNESS = 0.075, 14.0
# Strength and sharpness of the highlights of moist parts.
_GLOSS = {"lips": (0.16, 24), "sclera": (0.55, 160), "iris": (1.5, 500), "pupil": (1.5, 500), "teeth": (0.4, 60)}
_GLOSS |= {"tissue": (0.25, 40), "tongue": (0.2, 24), "waterline": (0.9, 60)}
STRENGTH, SHARPNESS = (np.array([_GLOSS.get(part, (0, 1))[at] for part in PARTS], np.float32) for at in range(2))
GLOSSY = STRENGTH > 0
EYE = np.isin(PARTS, ["sclera", "iris", "pupil"])
MATT = np.isin(PARTS, ["sclera", "iris", "pupil", "teeth", "lash", "cloth"])  # without subsurface scattering


@dataclass(frozen=True)
class VertexLight:
    """Light from vertices to the camera, without the highlights of moist parts: from the sky, and from the lamps."""

    sky: Float[ndarray, "V 3"]
    lamps: Float[ndarray, "V 3"]


def vertex_light(
    normals: Float[ndarray, "V 3"],
    view_directions: Float[ndarray, "V 3"],
    colours: Float[ndarray, "V 3"],
    ambient: Float[ndarray, " V"],
    matt: Bool[ndarray, " V"],
) -> VertexLight:
    """Diffuse light, and the broad highlight of skin. `view_directions`: from the camera; `matt`: no scattering."""
    upward = 0.5 + 0.5 * normals[:, 1:2]
    sky = colours * (GROUND + upward * (SKY - GROUND)) * ambient[:, None]
    soft = np.where(matt, 0.0, WRAP).astype(np.float32)
    lamps = np.zeros_like(colours)
    shine = np.zeros(len(normals), np.float32)
    for lamp in LAMPS:
        cosine = normals @ lamp.direction
        direct = np.maximum(cosine, 0.0)
        wrapped = np.maximum((cosine + soft) / (1 + soft), 0.0)
        around = direct[:, None] + np.maximum(wrapped - direct, 0.0)[:, None] * TINT
        lamps += around * np.array(lamp.colour, np.float32)
        shine += specular(normals, view_directions, lamp, SKIN_SHARPNESS) * (cosine > 0)
    edge = 1 - np.maximum(-np.einsum("vd,vd->v", normals, view_directions), 0)
    shine *= np.where(matt, 0.0, SKIN_STRENGTH) * (1 + 3 * edge**3) * ambient * (0.35 + 1.1 * colours[:, 0])
    return VertexLight(sky, (colours * lamps + shine[:, None]) * (0.35 + 0.65 * ambient)[:, None])


def specular(
    normals: Float[ndarray, "N 3"],
    view_directions: Float[ndarray, "N 3"],
    lamp: DirectionalLight,
    sharpness: Float[ndarray, "*N"] | float,
) -> Float[ndarray, " N"]:
    """The specular reflection of a lamp (Blinn 1977)."""
    half = lamp.direction - view_directions
    half /= np.sqrt(np.einsum("nd,nd->n", half, half))[:, None]
    cosine = np.maximum(np.einsum("nd,nd->n", normals, half), 1e-6)
    return np.asarray(np.exp(sharpness * np.log(cosine)) * lamp.colour[1])


def specular_highlights(
    normals: Float[ndarray, "N 3"], view_directions: Float[ndarray, "N 3"], parts: Int[ndarray, " N"]
) -> Float[ndarray, " N"]:
    """Highlights of glossy parts, from the first lamp only: a second one in an eye would hide its pupil."""
    return np.asarray(STRENGTH[parts] * specular(normals, view_directions, LAMPS[0], SHARPNESS[parts]))


_LEVELS, _BRIGHTEST = 4096, 2.0
_LIGHT = np.linspace(0, _BRIGHTEST, _LEVELS)
_LIGHT = np.where(_LIGHT > 0.7, 1 - 0.09 / np.maximum(_LIGHT - 0.4, 0.3), _LIGHT)  # soft limit for bright parts
_SRGB = np.where(_LIGHT <= 0.0031308, 12.92 * _LIGHT, 1.055 * np.maximum(_LIGHT, 1e-9) ** (1 / 2.4) - 0.055)
_PIXELS = np.rint(255 * _SRGB).astype(np.uint8)


def to_pixels(light: Float[ndarray, "*N 3"]) -> UInt8[ndarray, "*N 3"]:
    """Linear light to sRGB bytes."""
    level = np.minimum(light * ((_LEVELS - 1) / _BRIGHTEST), _LEVELS - 1)
    return np.asarray(np.take(_PIXELS, level.astype(np.uint16)))
