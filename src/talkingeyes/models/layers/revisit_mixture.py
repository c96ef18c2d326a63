"""Places that events left: a process (point_process.py) can go back to one of them.

People look away from somebody and back to where he is. Places of a clip are its own, so neither Gaussians at fixed
places nor steps from the present one find the way back, and gaze that is drawn freely wanders off (docs/log.md). Which
place is gone back to is scored by how far it is, how long it held, and how long ago that was. The one that held longest
is `longest_dwell_location`; hazards are told where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

INITIAL_SD = 0.33  # in units of the spread: nobody lands exactly where he was
MASKED_LOGIT = -1e9  # the logit of a place that there is not


@dataclass(frozen=True)
class PreviousLocations:
    """The last R places that were left, the latest first, and for how many bins each held; 0: there is none yet."""

    locations: Float[Tensor, "*N R D"]
    dwell_bins: Float[Tensor, "*N R"]

    @classmethod
    def before(cls, bins: Int[Tensor, "B K"], locations: Float[Tensor, "B K D"], count: int) -> PreviousLocations:
        """What had been left before each event of a sequence, and after the last: (B, K + 1, R, ...)."""
        dwell_bins = F.pad(bins.diff(dim=1), (0, 1)).clamp(min=0).to(locations)
        which = (
            torch.arange(bins.shape[1] + 1, device=bins.device)[:, None] - 2 - torch.arange(count, device=bins.device)
        )
        at = which.clamp(min=0, max=bins.shape[1] - 1)
        return cls(locations[:, at], dwell_bins[:, at] * (which >= 0))

    def longest_dwell_location(self, present: Float[Tensor, "*N D"]) -> Float[Tensor, "*N D"]:
        """The place that held longest; the present one where none was left yet."""
        longest = self.dwell_bins.argmax(-1)[..., None, None].expand(*present.shape[:-1], 1, present.shape[-1])
        location = self.locations.gather(-2, longest)[..., 0, :]
        return torch.where(self.dwell_bins.amax(-1)[..., None] > 0, location, present)


class RevisitMixture(nn.Module):
    """How likely it is to go back to each of the places that were left, and how near one lands."""

    def __init__(self, count: int, width: int, spread: tuple[float, ...]) -> None:
        """`spread`: how far places lie from 0, a number each."""
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
        """Of each place that was left, where so much is known."""
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
