"""Marked temporal point process in discrete time: hazard and location of the next event, per time bin.

In every bin, a hazard gives the probability of an event. The location of an event follows a mixture of Gaussians with
three kinds of components: absolute components at fixed centres; relative components near the present location, each
pulled towards the centre by an autoregressive coefficient of its own (steps without such a pull drift ever farther
away: docs/log.md); and revisits of previous locations (revisit_mixture.py).

Hazard and mixture depend on the past events (an RNN over events, not frames), the time since the last event, the offset
from the location of the longest dwell, optionally the previous steps (previous_steps.py), and a condition around the
bin. Adaptive components are also shifted and scaled by these features. The end of a sequence is censoring: a bin
without an event is a term of the likelihood like any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.layers.numpy_point_process import MAX_LOG_SCALE, MAX_LOG_SD, MIN_LOG_SD, MIN_VARIANCE_RATIO
from talkingeyes.models.layers.previous_steps import previous_step_encodings
from talkingeyes.models.layers.revisit_mixture import PreviousLocations, RevisitMixture

MAX_AGE_BINS = 63  # longer times since the last event share an embedding
INITIAL_AR_COEFFICIENTS = (0.4, 1.0)  # from the strongest pull to the centre to none
# Initial standard deviations, in units of the spread. One absolute component starts wide: rare locations on all sides
# have no other component near them that could learn them (docs/log.md).
INITIAL_SD, INITIAL_BACKGROUND_SD = 0.2, 1.5

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class PointProcessSettings(Settings):
    """Size of the process, and its regularisation against over-reliance on its own history."""

    width: Annotated[int, Field(gt=0)]
    # Frames per bin; at most one event per bin.
    bin_frames: Annotated[int, Field(gt=0)]
    # Number of mixture components at fixed centres, and of those near the present location.
    absolute_components: Annotated[int, Field(ge=0)]
    relative_components: Annotated[int, Field(gt=0)]
    # Whether the features shift and scale the relative components, all by the same amount.
    adaptive_components: bool
    # Number of previous steps in the features.
    previous_steps: Annotated[int, Field(ge=0)]
    # Number of previous locations that can be revisited.
    previous_locations: Annotated[int, Field(gt=0)]
    # Convolutions over the condition, of kernel 5 with dilation 1, 2, ...: 3 layers reach 14 bins to each side.
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # In training: fraction of past events that are hidden, and noise on past locations (in units of the scale).
    history_dropout: Annotated[float, Field(ge=0, lt=1)]
    history_noise: Annotated[float, Field(ge=0)]


class CausalPointProcessSettings(PointProcessSettings):
    """A process for streaming: its condition encoder uses past bins and at most `lookahead` future bins."""

    lookahead: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class EventSequence:
    """At most K events of each of B sequences, the first in bin 0. `mask` is false for padding."""

    bins: Int[Tensor, "B K"]
    locations: Float[Tensor, "B K D"]
    mask: Bool[Tensor, "B K"]

    @classmethod
    def from_frames(
        cls, event: Bool[Tensor, "B T"], location: Float[Tensor, "B T D"], bin_frames: int
    ) -> EventSequence:
        """Events at marked frames, with the locations of these frames. The first bin holds only an event at frame 0."""
        event = event.clone()
        event[:, :bin_frames] = False
        event[:, 0] = True
        most = int(event.sum(1).max())
        order = (~event).long().argsort(dim=1, stable=True)[:, :most]
        mask = event.gather(1, order)
        return cls(order // bin_frames, location.gather(1, order[..., None].expand(-1, -1, location.shape[-1])), mask)


@dataclass(frozen=True)
class _History:
    """State before each bin: features of past events, present location, encodings of the steps to it, bins since the
    last event, and the location of the longest dwell."""

    state: Float[Tensor, "B N W"]
    location: Float[Tensor, "B N D"]
    step_encodings: Float[Tensor, "B N P"]
    age: Int[Tensor, "B N"]
    longest_dwell_location: Float[Tensor, "B N D"]


@dataclass(frozen=True)
class _Mixture:
    """Logits, centres and log standard deviations of M Gaussians."""

    logits: Float[Tensor, "*N M"]
    centre: Float[Tensor, "*N M D"]
    log_sd: Float[Tensor, "*N M D"]


class PointProcess(nn.Module):
    """Hazard and location of events of D dimensions, given a condition of C numbers per bin."""

    observation_noise: Tensor

    def __init__(self, settings: PointProcessSettings, condition: int, spread: tuple[float, ...]) -> None:
        """`spread`: standard deviation of locations per dimension; it sets the initial Gaussians.

        Set the buffer `observation_noise` to the standard deviation of the errors of the training locations, if it is
        known.
        """
        super().__init__()
        self.settings = settings
        numbers, width = len(spread), settings.width
        lookahead = settings.lookahead if isinstance(settings, CausalPointProcessSettings) else None
        self.register_buffer("observation_noise", torch.zeros(numbers))
        self.condition_encoder = ConvolutionStack(condition, width, settings.layers, settings.dropout, lookahead)
        self.token = nn.Linear(2 * numbers + 1 + width, width)
        self.history_rnn = nn.GRU(width, width, batch_first=True)
        self.start = nn.Parameter(torch.zeros(width))
        self.age = nn.Embedding(MAX_AGE_BINS + 1, width)
        self.input_projection = nn.Linear(2 * width + 2 * numbers + settings.previous_steps * (numbers + 1), width)
        self.trunk = nn.Sequential(nn.GELU(), nn.Dropout(settings.dropout), nn.Linear(width, width), nn.GELU())
        self.hazard = nn.Linear(width, 1)
        self.mixture_logits = nn.Linear(width, settings.absolute_components + settings.relative_components)
        far, near = settings.absolute_components, settings.relative_components
        start = _quantiles(far + near, numbers) * torch.tensor(spread)
        wide = torch.full((far + near, 1), INITIAL_SD)
        if far:
            start[0], wide[0] = 0.0, INITIAL_BACKGROUND_SD
        self.mixture_centres = nn.ParameterDict({"locations": nn.Parameter(start[:far].clone())})
        self.offsets = nn.Parameter(0.3 * start[far:])
        self.ar_coefficients = nn.Parameter(torch.linspace(*INITIAL_AR_COEFFICIENTS, near)[:, None].repeat(1, numbers))
        self.log_sds = nn.Parameter((wide * torch.tensor(spread)).log())
        self.shift_and_scale = nn.Linear(width, numbers + 1) if settings.adaptive_components else None
        if self.shift_and_scale is not None:
            nn.init.zeros_(self.shift_and_scale.weight)
            nn.init.zeros_(self.shift_and_scale.bias)
        self.revisits = RevisitMixture(settings.previous_locations, width, spread)

    def means(self) -> Float[Tensor, "M D"]:
        """Centres of the absolute components, followed by the offsets of the relative components from the present
        location."""
        return torch.cat([self.mixture_centres["locations"], self.offsets])

    def loss_terms(self, events: EventSequence, condition: Float[Tensor, "B N C"]) -> dict[str, Tensor]:
        """Negative log-likelihoods (`time` per bin, `location` per event)."""
        time, location = self._log_likelihoods(events, condition)
        return {"time": -time.mean(), "location": -location.sum() / events.mask.sum()}

    def log_likelihood(self, events: EventSequence, condition: Float[Tensor, "B N C"]) -> dict[str, Tensor]:
        """Log-likelihood of each sequence in nats, `time` and `location`, without the location of the first event."""
        time, location = self._log_likelihoods(events, condition)
        return {"time": time.sum(1), "location": location[:, 1:].sum(1)}

    def _log_likelihoods(
        self, events: EventSequence, condition: Float[Tensor, "B N C"]
    ) -> tuple[Float[Tensor, "B M"], Float[Tensor, "B K"]]:
        """Log-likelihood of every bin but the first (an event or none), and of the location of every event (0 for
        padding)."""
        encoded_condition = self.condition_encoder(condition)
        past = self._past(events, encoded_condition)
        features = self._features(past, encoded_condition)
        happened = torch.zeros(len(encoded_condition), condition.shape[1], device=encoded_condition.device)
        happened.scatter_add_(1, events.bins, events.mask.float())
        time = -F.binary_cross_entropy_with_logits(
            self.hazard(features)[:, 1:, 0], happened[:, 1:].clamp(max=1), reduction="none"
        )
        index = events.bins[..., None]
        at_events = features.gather(1, index.expand(-1, -1, features.shape[-1]))
        from_place = past.location.gather(1, index.expand(-1, -1, past.location.shape[-1]))
        previous_locations = PreviousLocations.before(events.bins, events.locations, self.settings.previous_locations)
        before = PreviousLocations(previous_locations.locations[:, :-1], previous_locations.dwell_bins[:, :-1])
        location = self._log_density(at_events, from_place, before, events.locations) * events.mask
        return time, location

    def clamped_log_sds(self) -> tuple[Float[Tensor, "M D"], Float[Tensor, " D"]]:
        """Clamped log standard deviations of the Gaussians and of revisits."""
        return (
            self.log_sds.clamp(MIN_LOG_SD, MAX_LOG_SD),
            self.revisits.log_sd.clamp(MIN_LOG_SD, MAX_LOG_SD),
        )

    def denoised_sds(self) -> tuple[Float[Tensor, "M D"], Float[Tensor, " D"]]:
        """Standard deviations without observation noise, whose variance enters a location once and a step twice."""
        own, back = (log_sd.exp().square() for log_sd in self.clamped_log_sds())
        times = torch.ones_like(own)
        times[self.settings.absolute_components :] = 2
        observation_noise = self.observation_noise.square()
        own, back = (
            torch.maximum(each - much * observation_noise, MIN_VARIANCE_RATIO * each)
            for each, much in ((own, times), (back, 2))
        )
        return own.sqrt(), back.sqrt()

    def _past(self, events: EventSequence, encoded_condition: Float[Tensor, "B N W"]) -> _History:
        """State before each bin of true events; in training with noise on locations and with some events hidden."""
        seen = events.locations
        if self.training:
            seen = seen + self.settings.history_noise * torch.randn_like(seen)
        before = F.pad(seen[:, :-1], (0, 0, 1, 0))
        since = F.pad(events.bins.diff(dim=1), (1, 0)).clamp(min=0)
        at = encoded_condition.gather(1, events.bins[..., None].expand(-1, -1, encoded_condition.shape[-1]))
        tokens = self._tokens(seen, before, since, at)
        if self.training:
            seen_of = torch.rand(tokens.shape[:2], device=tokens.device) >= self.settings.history_dropout
            tokens = tokens * seen_of[..., None]
        first = self.start.expand(1, len(seen), -1).contiguous()
        states = torch.cat([first[0][:, None], self.history_rnn(tokens, first)[0]], dim=1)
        order = torch.arange(encoded_condition.shape[1], device=encoded_condition.device)
        bins = torch.where(events.mask, events.bins, encoded_condition.shape[1]).contiguous()
        known = torch.searchsorted(bins, order.expand(len(bins), -1).contiguous())  # number of events before each bin
        last = (known - 1).clamp(min=0)
        location = events.locations.gather(1, last[..., None].expand(-1, -1, seen.shape[-1])) * (known > 0)[..., None]
        age = torch.where(known > 0, order - bins.gather(1, last), 0)
        previous_locations = PreviousLocations.before(events.bins, events.locations, self.settings.previous_locations)
        longest_dwell_location = previous_locations.longest_dwell_location(F.pad(events.locations, (0, 0, 1, 0)))
        step_encodings = previous_step_encodings(events.locations, self.settings.previous_steps)
        return _History(
            _at(states, known), location, _at(step_encodings, known), age, _at(longest_dwell_location, known)
        )

    def _tokens(
        self,
        location: Float[Tensor, "B K D"],
        before: Float[Tensor, "B K D"],
        since: Int[Tensor, "B K"],
        encoded_condition: Tensor,
    ) -> Float[Tensor, "B K W"]:
        out: Tensor = self.token(
            torch.cat([location, location - before, since[..., None].float().log1p(), encoded_condition], dim=-1)
        )
        return out

    def _features(self, past: _History, encoded_condition: Float[Tensor, "B N W"]) -> Float[Tensor, "B N W"]:
        known = torch.cat(
            [
                encoded_condition,
                past.state,
                past.location,
                past.location - past.longest_dwell_location,
                past.step_encodings,
            ],
            dim=-1,
        )
        entered = self.input_projection(known) + self.age(past.age.clamp(max=MAX_AGE_BINS))
        out: Tensor = self.trunk(entered)
        return out

    def _mixture(
        self, features: Float[Tensor, "*N W"], location: Float[Tensor, "*N D"], previous_locations: PreviousLocations
    ) -> _Mixture:
        """The mixture given features, present location and previous locations."""
        log_sd, back = self.clamped_log_sds()
        far = self.mixture_centres["locations"].expand(*features.shape[:-1], -1, -1)
        near: Tensor = self.offsets
        wide = log_sd[self.settings.absolute_components :]
        if self.shift_and_scale is not None:
            adapted = self.shift_and_scale(features)[..., None, :]
            log_size = adapted[..., -1:].clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE)
            near, wide = adapted[..., :-1] + log_size.exp() * near, log_size + wide
        near = near + self.ar_coefficients * location[..., None, :]
        sds = [
            log_sd[: self.settings.absolute_components].expand_as(far),
            wide.expand_as(near),
            back.expand_as(previous_locations.locations),
        ]
        logits = torch.cat(
            [self.mixture_logits(features), self.revisits.logits(features, previous_locations, location)], dim=-1
        )
        return _Mixture(logits, torch.cat([far, near, previous_locations.locations], dim=-2), torch.cat(sds, dim=-2))

    def _log_density(
        self,
        features: Float[Tensor, "B K W"],
        location: Float[Tensor, "B K D"],
        previous_locations: PreviousLocations,
        to: Float[Tensor, "B K D"],
    ) -> Float[Tensor, "B K"]:
        mixture = self._mixture(features, location, previous_locations)
        error = (to[..., None, :] - mixture.centre) * (-mixture.log_sd).exp()
        inside = (-0.5 * error.square() - mixture.log_sd - HALF_LOG_2PI).sum(-1)
        return (mixture.logits.log_softmax(-1) + inside).logsumexp(-1)


def _at(events: Float[Tensor, "B K C"], known: Int[Tensor, "B N"]) -> Float[Tensor, "B N C"]:
    return events.gather(1, known[..., None].expand(-1, -1, events.shape[-1]))


def bin_means(frames: Float[Tensor, "B T C"], bin_frames: int, extra_bins: int = 0) -> Float[Tensor, "B N C"]:
    """Means of bins, with `extra_bins` more that repeat the last frame."""
    count = math.ceil(frames.shape[1] / bin_frames) + extra_bins
    filled = torch.cat([frames, frames[:, -1:].expand(-1, count * bin_frames - frames.shape[1], -1)], dim=1)
    out: Tensor = filled.unflatten(1, (count, bin_frames)).mean(2)
    return out


def _quantiles(count: int, numbers: int) -> Float[Tensor, "M D"]:
    """Quasi-random quantiles of a standard normal distribution."""
    points = torch.quasirandom.SobolEngine(numbers, scramble=True, seed=0).draw(count)
    out: Tensor = torch.special.ndtri(points.double().clamp(0.01, 0.99)).float()
    return out
