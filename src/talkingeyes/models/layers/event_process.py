"""Events in time bins: when the next one comes, and where it leads (a marked point process, discretised).

In every bin a hazard says whether an event happens; what one leads to is a mixture of Gaussians, some at places of
their own, some near the present place but drawn back to the middle, each by its own share (steps that are never drawn
back lead ever farther off: docs/log.md), some at places that were left (event_returns.py). All follow from the
past events (a recurrent network over them, not over frames), from how long the last one is ago, from where the longest
held place is, from the last steps (event_steps.py) if so many are told, and from a condition around the bin. If they
are adaptive, the Gaussians near the present place are moved and widened by all that, too. The end of a sequence is
censoring: a bin without an event is a term of the likelihood like any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from talkingeyes.core.settings import Settings, out_of_bounds
from talkingeyes.models.layers.convolution import CausalConvolutionStack, ConvolutionStack
from talkingeyes.models.layers.event_codebook import CODEBOOKS, CodebookKind
from talkingeyes.models.layers.event_drawing import Drawing, Drawn
from talkingeyes.models.layers.event_returns import Left, Returns
from talkingeyes.models.layers.event_steps import headings_before

OLDEST = 63  # bins since the last event are told apart up to this many
FOLLOW = (0.4, 1.0)  # at first, from the Gaussian that is drawn back most to the one that is not
# How wide Gaussians are at first, of the spread. One in the middle is wide: seldom gone places, to every side, have no
# other near them that would learn them (docs/log.md).
NARROW, WIDE = 0.2, 1.5
LEAST_LOG_SD, MOST_LOG_SD = -5.0, 1.0
LEAST_CLEAN = 0.05  # of the variance of a Gaussian that is left without noise


class EventProcessSettings(Settings):
    """Size of the process, and what guards it against leaning on its own history."""

    width: Annotated[int, Field(gt=0)]
    # Frames of a bin; at most one event a bin.
    bin_frames: Annotated[int, Field(gt=0)]
    # Gaussians at places of their own, and near the present place.
    fixed: Annotated[int, Field(ge=0)]
    relative: Annotated[int, Field(gt=0)]
    # Where the fixed ones stand (event_codebook.py).
    codebook: CodebookKind
    # Whether what is known moves and widens the relative ones, all alike: a location and a scale.
    adaptive: bool
    # Steps that led to the present place and are told.
    steps: Annotated[int, Field(ge=0)]
    # Places that were left and can be gone back to.
    returns: Annotated[int, Field(gt=0)]
    # Convolutions over the condition, of kernel 5 with dilation 1, 2, ...: 3 layers reach 14 bins to each side.
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # In training: share of past events that are hidden, and noise on past places (in units of the scale).
    history_dropout: Annotated[float, Field(ge=0, lt=1)]
    history_noise: Annotated[float, Field(ge=0)]

    @model_validator(mode="after")
    def _clusters(self) -> EventProcessSettings:
        if self.codebook != "learnt" and self.fixed < 2:
            raise out_of_bounds(f"fixed should be 2 or more for codebook={self.codebook}", self.fixed)
        return self


class CausalEventProcessSettings(EventProcessSettings):
    """A process for streams: its layers hear the past of the condition and no more than `ahead` bins of what comes."""

    ahead: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class EventSequence:
    """At most K events of each of B sequences, the first in bin 0; `real` tells them from padding."""

    bins: Int[Tensor, "B K"]
    places: Float[Tensor, "B K D"]
    real: Bool[Tensor, "B K"]

    @classmethod
    def of_frames(cls, event: Bool[Tensor, "B T"], place: Float[Tensor, "B T D"], bin_frames: int) -> EventSequence:
        """Events at marked frames, each to the place at its frame; the first bin holds the place at frame 0 alone."""
        event = event.clone()
        event[:, :bin_frames] = False
        event[:, 0] = True
        most = int(event.sum(1).max())
        order = (~event).long().argsort(dim=1, stable=True)[:, :most]
        real = event.gather(1, order)
        return cls(order // bin_frames, place.gather(1, order[..., None].expand(-1, -1, place.shape[-1])), real)


@dataclass(frozen=True)
class _Past:
    """What is known before bins: features of the events so far, the present place, headings of the steps to it, the age
    of the last event, home."""

    state: Float[Tensor, "B N W"]
    place: Float[Tensor, "B N D"]
    headings: Float[Tensor, "B N P"]
    age: Int[Tensor, "B N"]
    home: Float[Tensor, "B N D"]


@dataclass(frozen=True)
class _Gaussians:
    """Logits, centres and logarithms of the standard deviations of M Gaussians."""

    logits: Float[Tensor, "*N M"]
    centre: Float[Tensor, "*N M D"]
    log_sd: Float[Tensor, "*N M D"]


class EventProcess(nn.Module):
    """Hazard and place of events of D numbers under a condition of C numbers a bin."""

    most_log_size = 2.5  # that the Gaussians near the present place are widened by, or narrowed
    noise: Tensor

    def __init__(self, settings: EventProcessSettings, condition: int, spread: tuple[float, ...]) -> None:
        """`spread`: how far places lie from 0, a number each; where the Gaussians start from.

        Who knows by how much the places to learn from are off (a standard deviation) says so in `noise`.
        """
        super().__init__()
        self.settings = settings
        numbers, width = len(spread), settings.width
        size = (condition, width, settings.layers, settings.dropout)
        ahead = settings.ahead if isinstance(settings, CausalEventProcessSettings) else None
        self.register_buffer("noise", torch.zeros(numbers))
        self.listen = ConvolutionStack(*size) if ahead is None else CausalConvolutionStack(*size, ahead)
        self.token = nn.Linear(2 * numbers + 1 + width, width)
        self.remember = nn.GRU(width, width, batch_first=True)
        self.start = nn.Parameter(torch.zeros(width))
        self.age = nn.Embedding(OLDEST + 1, width)
        self.enter = nn.Linear(2 * width + 2 * numbers + settings.steps * (numbers + 1), width)
        self.trunk = nn.Sequential(nn.GELU(), nn.Dropout(settings.dropout), nn.Linear(width, width), nn.GELU())
        self.hazard = nn.Linear(width, 1)
        self.weigh = nn.Linear(width, settings.fixed + settings.relative)
        far, near = settings.fixed, settings.relative
        start = _quantiles(far + near, numbers) * torch.tensor(spread)
        wide = torch.full((far + near, 1), NARROW)
        if far:
            start[0], wide[0] = 0.0, WIDE
        self.codebook = CODEBOOKS[settings.codebook](start[:far].clone())
        self.steps = nn.Parameter(0.3 * start[far:])
        self.follow = nn.Parameter(torch.linspace(*FOLLOW, near)[:, None].repeat(1, numbers))
        self.log_sds = nn.Parameter((wide * torch.tensor(spread)).log())
        self.adapt = nn.Linear(width, numbers + 1) if settings.adaptive else None
        if self.adapt is not None:
            nn.init.zeros_(self.adapt.weight)
            nn.init.zeros_(self.adapt.bias)
        self.returns = Returns(settings.returns, width, spread)

    def means(self) -> Float[Tensor, "M D"]:
        """Of the Gaussians: first those at places of their own, then how far from the present place the others lie."""
        return torch.cat([self.codebook(), self.steps])

    def terms(self, events: EventSequence, condition: Float[Tensor, "B N C"]) -> dict[str, Tensor]:
        """Negative log-likelihoods: `when` a bin, `where` an event. With them what the codebook learns by, if any."""
        learnt = self.codebook.learn(events.places[events.real])
        heard = self.listen(condition)
        past = self._past(events, heard)
        features = self._features(past, heard)
        count = condition.shape[1]
        happened = torch.zeros(len(heard), count, device=heard.device)
        happened.scatter_add_(1, events.bins, events.real.float())
        when = F.binary_cross_entropy_with_logits(self.hazard(features)[:, 1:, 0], happened[:, 1:].clamp(max=1))
        index = events.bins[..., None]
        at_events = features.gather(1, index.expand(-1, -1, features.shape[-1]))
        from_place = past.place.gather(1, index.expand(-1, -1, past.place.shape[-1]))
        left = Left.before(events.bins, events.places, self.settings.returns)
        before = Left(left.places[:, :-1], left.held[:, :-1])
        likelihood = self._log_density(at_events, from_place, before, events.places)
        return {"when": when, "where": -(likelihood * events.real).sum() / events.real.sum(), **learnt}

    @torch.no_grad()
    def sample(self, condition: Float[Tensor, "_ N C"], uniform: Float[Tensor, "B N U"], temperature: float) -> Drawn:
        """Events drawn from D + 3 uniform numbers a bin, under one condition each or one for all."""
        return Drawing(self, temperature).sample(self.listen(condition).cpu().numpy(), uniform.cpu().numpy())

    def log_sds_in_bounds(self) -> tuple[Float[Tensor, "M D"], Float[Tensor, " D"]]:
        """Of the Gaussians, and of going back."""
        return (
            self.log_sds.clamp(LEAST_LOG_SD, MOST_LOG_SD),
            self.returns.log_sd.clamp(LEAST_LOG_SD, MOST_LOG_SD),
        )

    def clean_sds(self) -> tuple[Float[Tensor, "M D"], Float[Tensor, " D"]]:
        """As wide as the Gaussians would be without the noise, which a place has once and the way between two twice."""
        own, back = (log_sd.exp().square() for log_sd in self.log_sds_in_bounds())
        times = torch.ones_like(own)
        times[self.settings.fixed :] = 2
        noise = self.noise.square()
        own, back = (torch.maximum(each - much * noise, LEAST_CLEAN * each) for each, much in ((own, times), (back, 2)))
        return own.sqrt(), back.sqrt()

    def _past(self, events: EventSequence, heard: Float[Tensor, "B N W"]) -> _Past:
        """What was known before each bin of true events; in training with noise on places and some events hidden."""
        seen = events.places
        if self.training:
            seen = seen + self.settings.history_noise * torch.randn_like(seen)
        before = F.pad(seen[:, :-1], (0, 0, 1, 0))
        since = F.pad(events.bins.diff(dim=1), (1, 0)).clamp(min=0)
        at = heard.gather(1, events.bins[..., None].expand(-1, -1, heard.shape[-1]))
        tokens = self._tokens(seen, before, since, at)
        if self.training:
            seen_of = torch.rand(tokens.shape[:2], device=tokens.device) >= self.settings.history_dropout
            tokens = tokens * seen_of[..., None]
        first = self.start.expand(1, len(seen), -1).contiguous()
        states = torch.cat([first[0][:, None], self.remember(tokens, first)[0]], dim=1)
        order = torch.arange(heard.shape[1], device=heard.device)
        bins = torch.where(events.real, events.bins, heard.shape[1]).contiguous()
        known = torch.searchsorted(bins, order.expand(len(bins), -1).contiguous())  # events before each bin
        last = (known - 1).clamp(min=0)
        place = events.places.gather(1, last[..., None].expand(-1, -1, seen.shape[-1])) * (known > 0)[..., None]
        age = torch.where(known > 0, order - bins.gather(1, last), 0)
        left = Left.before(events.bins, events.places, self.settings.returns)
        home = left.home(F.pad(events.places, (0, 0, 1, 0)))
        headings = headings_before(events.places, self.settings.steps)
        return _Past(_at(states, known), place, _at(headings, known), age, _at(home, known))

    def _tokens(
        self, place: Float[Tensor, "B K D"], before: Float[Tensor, "B K D"], since: Int[Tensor, "B K"], heard: Tensor
    ) -> Float[Tensor, "B K W"]:
        out: Tensor = self.token(torch.cat([place, place - before, since[..., None].float().log1p(), heard], dim=-1))
        return out

    def _features(self, past: _Past, heard: Float[Tensor, "B N W"]) -> Float[Tensor, "B N W"]:
        known = torch.cat([heard, past.state, past.place, past.place - past.home, past.headings], dim=-1)
        entered = self.enter(known) + self.age(past.age.clamp(max=OLDEST))
        out: Tensor = self.trunk(entered)
        return out

    def _gaussians(self, features: Float[Tensor, "*N W"], place: Float[Tensor, "*N D"], left: Left) -> _Gaussians:
        """The mixture where so much is known."""
        log_sd, back = self.log_sds_in_bounds()
        far = self.codebook().expand(*features.shape[:-1], -1, -1)
        near: Tensor = self.steps
        wide = log_sd[self.settings.fixed :]
        if self.adapt is not None:
            adapted = self.adapt(features)[..., None, :]
            log_size = adapted[..., -1:].clamp(-self.most_log_size, self.most_log_size)
            near, wide = adapted[..., :-1] + log_size.exp() * near, log_size + wide
        near = near + self.follow * place[..., None, :]
        sds = [log_sd[: self.settings.fixed].expand_as(far), wide.expand_as(near), back.expand_as(left.places)]
        logits = torch.cat([self.weigh(features), self.returns.logits(features, left, place)], dim=-1)
        return _Gaussians(logits, torch.cat([far, near, left.places], dim=-2), torch.cat(sds, dim=-2))

    def _log_density(
        self, features: Float[Tensor, "B K W"], place: Float[Tensor, "B K D"], left: Left, to: Float[Tensor, "B K D"]
    ) -> Float[Tensor, "B K"]:
        mixture = self._gaussians(features, place, left)
        error = (to[..., None, :] - mixture.centre) * (-mixture.log_sd).exp()
        inside = (-0.5 * error.square() - mixture.log_sd).sum(-1)
        return (mixture.logits.log_softmax(-1) + inside).logsumexp(-1)


def _at(events: Float[Tensor, "B K C"], known: Int[Tensor, "B N"]) -> Float[Tensor, "B N C"]:
    return events.gather(1, known[..., None].expand(-1, -1, events.shape[-1]))


def binned(frames: Float[Tensor, "B T C"], bin_frames: int, beyond: int = 0) -> Float[Tensor, "B N C"]:
    """Means of bins, so many of them beyond the last frame; there, the last frame."""
    count = math.ceil(frames.shape[1] / bin_frames) + beyond
    filled = torch.cat([frames, frames[:, -1:].expand(-1, count * bin_frames - frames.shape[1], -1)], dim=1)
    out: Tensor = filled.unflatten(1, (count, bin_frames)).mean(2)
    return out


def _quantiles(count: int, numbers: int) -> Float[Tensor, "M D"]:
    """Points spread evenly under a standard normal law."""
    points = torch.quasirandom.SobolEngine(numbers, scramble=True, seed=0).draw(count)
    out: Tensor = torch.special.ndtri(points.double().clamp(0.01, 0.99)).float()
    return out
