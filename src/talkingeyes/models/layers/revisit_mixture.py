"""Mixture components at previous locations, with which a point process (point_process.py) can return to them.

People look away from a partner and back. Locations differ between clips, so neither Gaussians at fixed centres nor
steps from the present location find the way back, and free-running gaze drifts away (docs/log.md). Each previous
location is scored by its offset from the present location and from the location of the longest dwell
(`longest_dwell_location`), by its dwell time, and by its recency. Hazards also use `longest_dwell_location`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from talkingeyes.models.layers.numpy_point_process import MASKED_LOGIT

INITIAL_SD = 0.33  # in units of the spread: a return is not exact


@dataclass(frozen=True)
class PreviousLocations:
    """The last R previous locations, the latest first, and their dwell times in bins (0: missing)."""

    locations: Float[Tensor, "*N R D"]
    dwell_bins: Float[Tensor, "*N R"]

    @classmethod
    def before(cls, bins: Int[Tensor, "B K"], locations: Float[Tensor, "B K D"], count: int) -> PreviousLocations:
        """Previous locations before each event of a sequence and after the last: (B, K + 1, R, ...)."""
        dwell_bins = F.pad(bins.diff(dim=1), (0, 1)).clamp(min=0).to(locations)
        which = (
            torch.arange(bins.shape[1] + 1, device=bins.device)[:, None] - 2 - torch.arange(count, device=bins.device)
        )
        at = which.clamp(min=0, max=bins.shape[1] - 1)
        return cls(locations[:, at], dwell_bins[:, at] * (which >= 0))

    def longest_dwell_location(self, present: Float[Tensor, "*N D"]) -> Float[Tensor, "*N D"]:
        """The previous location of the longest dwell; the present location if there is none."""
        longest = self.dwell_bins.argmax(-1)[..., None, None].expand(*present.shape[:-1], 1, present.shape[-1])
        location = self.locations.gather(-2, longest)[..., 0, :]
        return torch.where(self.dwell_bins.amax(-1)[..., None] > 0, location, present)


class RevisitMixture(nn.Module):
    """Scores of the previous locations, and the spread of landings around them."""

    def __init__(self, count: int, width: int, spread: tuple[float, ...]) -> None:
        """`spread`: standard deviation of locations per dimension."""
        super().__init__()
        numbers = len(spread)
        self.candidate = nn.Linear(2 * numbers + 1, width)
        self.recency = nn.Parameter(torch.zeros(count, width))
        self.known = nn.Linear(width, width)
        self.score = nn.Linear(width, 1)
        self.log_sd = nn.Parameter((INITIAL_SD * torch.tensor(spread)).log())

    def logits(
        self, features: Float[Tensor, "*N W"], previous_locations: PreviousLocations, location: Float[Tensor, "*N D"]
    ) -> Float[Tensor, "*N R"]:
        """Logits of the previous locations; MASKED_LOGIT for missing ones."""
        away, off = (
            previous_locations.locations - location[..., None, :],
            previous_locations.locations - previous_locations.longest_dwell_location(location)[..., None, :],
        )
        candidate = (
            self.candidate(torch.cat([away, off, previous_locations.dwell_bins[..., None].log1p()], dim=-1))
            + self.recency
        )
        scored: Tensor = self.score(F.gelu(candidate + self.known(features)[..., None, :]))[..., 0]
        return scored.masked_fill(previous_locations.dwell_bins == 0, MASKED_LOGIT)
