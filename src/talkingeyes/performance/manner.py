"""Habits of a person, measured: where head and gaze rest, how far they go, how often eyes jump and blink.

They are measured in motions of a speaker of the corpus (and kept with the model), or in a reference clip, and imposed
on what the model gives. Head and gaze are rotation vectors and (yaw, pitch) in space, radians.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Manner:
    """What is measured: means and standard deviations within a clip, over clips; rates a minute."""

    head_mean_rad: tuple[float, float, float]
    head_sd_rad: tuple[float, float, float]
    gaze_mean_rad: tuple[float, float]
    gaze_sd_rad: tuple[float, float]
    saccades_per_min: float
    blinks_per_min: float
