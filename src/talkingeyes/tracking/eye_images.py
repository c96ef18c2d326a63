"""Small images of both eyes, cut from a frame around its landmarks, at one scale for every video and face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.tracking.cropping import pixels_per_mm


@dataclass(frozen=True)
class EyeImage:
    """One eye: its pixels, where the centre of the first one is in the frame, and pixels of the frame per pixel."""

    pixels: UInt8[ndarray, "H W 3"]
    corner: Float[ndarray, " 2"]
    scale: float


def cut_eyes(
    image: UInt8[ndarray, "h w 3"], landmarks: Float[ndarray, "L 2"], size_px: tuple[int, int], px_per_m: float
) -> tuple[EyeImage, EyeImage]:
    """Images of the left and right eye: `size_px` is width and height; the frame's edge is repeated beyond it."""
    import cv2

    scale = 1000.0 * float(pixels_per_mm(landmarks[None])[0]) / px_per_m
    found = []
    for points in landmarks[EYE_LANDMARKS]:
        corner = points.mean(axis=0) - 0.5 - scale * (np.array(size_px) - 1.0) / 2.0
        onto = np.array([[scale, 0.0, corner[0]], [0.0, scale, corner[1]]])
        how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
        pixels = cv2.warpAffine(image, onto, size_px, flags=how | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
        found.append(EyeImage(np.asarray(pixels), corner + 0.5, scale))
    return found[0], found[1]
