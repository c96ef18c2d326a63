"""Free-running sampler of a point process (point_process.py), in numpy.

Every event changes the distribution of the next, so sampling is a loop of small steps, in which a call of torch costs
more than its arithmetic. In numpy, sampling takes a fraction of the time (docs/log.md). The formulas are those of
training; tests/test_point_process_sampler.py compares each sample with them. Constants that both share are here.

Guidance (Ho & Salimans 2022) strengthens what the condition changes, in sampling alone: the log-odds of an event and
the log-probabilities of the mixture are extrapolated from those under a neutral condition. Arrays have an axis of
variants first: the condition, and with guidance the neutral one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from pydantic import Field
from scipy.special import expit, ndtri

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.numpy_layers import NumpyGRU, NumpyLinear, Tensors, gelu

MIN_STEP = 0.05  # in units of the scale: the direction of shorter steps shrinks to zero
MASKED_LOGIT = -1e9  # for missing locations
MAX_LOG_SCALE = 2.5  # bound on the adaptive scale of the relative components
MIN_LOG_SD, MAX_LOG_SD = -5.0, 1.0
MIN_VARIANCE_RATIO = 0.05  # lower bound of denoised to learned variance

# Maximum number of bins evaluated together, absolute and in mean gaps between events (about 3 bins for heads, 12 for
# gaze).
MAX_BLOCK_BINS, BLOCK_MEAN_GAPS = 16, 2.0


class Guidance(Settings):
    """Factors on what the condition changes in the log-odds of an event (`time`) and in the log-probabilities of the
    mixture's components (`location`); 1: none."""

    time: Annotated[float, Field(gt=0)]
    location: Annotated[float, Field(gt=0)]

    @property
    def is_one(self) -> bool:
        """Whether samples are as the network has learned them."""
        return self.time == self.location == 1


NO_GUIDANCE = Guidance(time=1.0, location=1.0)


@dataclass(frozen=True)
class SampledEvents:
    """Samples of N bins: whether there is an event, its phase within the bin (0 to 1), and the location since then."""

    event: Bool[ndarray, "B N"]
    phase: Float[ndarray, "B N"]
    location: Float[ndarray, "B N D"]


@dataclass
class SamplerState:
    """State between two bins: the states of the RNN, the present location, the encodings of the last S steps, the bins
    since the last event, and the last R locations."""

    state: Float[ndarray, "V B W"]
    location: Float[ndarray, "B D"]
    longest_dwell_location: Float[
        ndarray, "B D"
    ]  # the previous location of the longest dwell; the present one if there is none
    step_encodings: Float[ndarray, "B S H"]
    age: Int[ndarray, " B"]
    previous_locations: Float[ndarray, "B R D"]
    dwell_bins: Float[ndarray, "B R"]  # 0: no previous location

    @classmethod
    def concat(cls, states: Sequence[SamplerState]) -> SamplerState:
        """One state of the rows of all."""
        columns = {name: [getattr(each, name) for each in states] for name in cls._axes()}
        return cls(**{name: np.concatenate(columns[name], axis=axis) for name, axis in cls._axes().items()})

    def rows(self) -> list[SamplerState]:
        """A state for each row."""
        columns = [np.split(getattr(self, name), len(self.age), axis=axis) for name, axis in self._axes().items()]
        return [SamplerState(*row) for row in zip(*columns, strict=True)]

    @classmethod
    def _axes(cls) -> dict[str, int]:
        """The axis of rows of each array."""
        return {each.name: int(each.name == "state") for each in fields(cls)}

    def move_to(self, rows: Int[ndarray, " S"], location: Float[ndarray, "S D"]) -> None:
        """Move some rows to a new location; the oldest previous location is dropped."""
        old, age = self.location[rows], self.age[rows]
        if self.step_encodings.shape[1]:
            step = np.where(age[:, None] > 0, location - old, 0)  # no step leads to the first location
            self.step_encodings[rows] = _prepend(_encode_step(step), self.step_encodings[rows])
        self.previous_locations[rows] = previous_locations = _prepend(old, self.previous_locations[rows])
        self.dwell_bins[rows] = dwell_bins = _prepend(age.astype(np.float32), self.dwell_bins[rows])
        longest = dwell_bins.argmax(-1)
        order = np.arange(len(rows))
        self.longest_dwell_location[rows] = np.where(
            dwell_bins[order, longest][:, None] > 0, previous_locations[order, longest], location
        )
        self.location[rows] = location
        self.age[rows] = 0


def _encode_step(step: Float[ndarray, "S D"]) -> Float[ndarray, "S H"]:
    """The numpy version of `encode_step` in previous_steps.py."""
    length = np.sqrt(np.einsum("sd,sd->s", step, step))[:, None] + np.float32(MIN_STEP)
    return np.concatenate([step / length, np.log(length)], axis=1)


def _prepend(new: Float[ndarray, "S ..."], past: Float[ndarray, "S R ..."]) -> Float[ndarray, "S R ..."]:
    """Insert the new entry first and drop the oldest."""
    return np.concatenate([new[:, None], past[:, :-1]], axis=1)


@dataclass(frozen=True)
class SamplerWeights:
    """Tensors of a process by name, and what is derived from them: centres and offsets of the Gaussians, and their
    standard deviations without observation noise."""

    tensors: Tensors
    means: Float[ndarray, "M D"]
    sds: Float[ndarray, "M D"]
    return_sd: Float[ndarray, " D"]
    absolute_components: int
    previous_steps: int
    previous_locations: int

    @classmethod
    def of(cls, tensors: Tensors) -> SamplerWeights:
        """Weights of a process with learned mixture centres, by the formulas of `PointProcess`."""
        centres, noise = tensors["mixture_centres.locations"], np.square(tensors["observation_noise"])
        own, back = (
            np.square(np.exp(tensors[name].clip(MIN_LOG_SD, MAX_LOG_SD))) for name in ("log_sds", "revisits.log_sd")
        )
        times = np.where(np.arange(len(own)) < len(centres), 1, 2)[:, None].astype(np.float32)
        sds, return_sd = (
            np.sqrt(np.maximum(each - much * noise, MIN_VARIANCE_RATIO * each))
            for each, much in ((own, times), (back, 2))
        )
        means = np.concatenate([centres, tensors["offsets"]])
        (width,), numbers = tensors["start"].shape, means.shape[1]
        previous_steps = (tensors["input_projection.weight"].shape[1] - 2 * width - 2 * numbers) // (numbers + 1)
        return cls(tensors, means, sds, return_sd, len(centres), previous_steps, len(tensors["revisits.recency"]))


class Sampler:
    """Weights of a process for free running. Samples are determined by D + 3 uniform numbers per bin."""

    def __init__(
        self,
        weights: SamplerWeights,
        temperature: float,
        guidance: Guidance = NO_GUIDANCE,
        activation: Callable[[Float[ndarray, "*N"]], Float[ndarray, "*N"]] = gelu,
    ) -> None:
        """`temperature` scales the mixture logits and the Gaussians; `activation` is an implementation of GELU.

        `guidance` acts if conditions have two variants.
        """
        tensors = weights.tensors
        self.means, ar_coefficients = weights.means, tensors["ar_coefficients"]
        (width,), (count, numbers) = tensors["start"].shape, self.means.shape
        self.ar_coefficients = np.concatenate(
            [np.zeros((count - len(ar_coefficients), numbers), np.float32), ar_coefficients]
        )
        self.temperature, self.previous_locations = temperature, weights.previous_locations
        self.start, self.age, self.recency = tensors["start"], tensors["age.weight"], tensors["revisits.recency"]
        input_projection, self.input_bias = (
            tensors["input_projection.weight"].T.copy(),
            tensors["input_projection.bias"],
        )
        self.condition_weight, self.history_weight = input_projection[:width], input_projection[width:]
        self.previous_steps, self.absolute_components = weights.previous_steps, weights.absolute_components
        self.shift_and_scale = NumpyLinear(tensors, "shift_and_scale") if "shift_and_scale.weight" in tensors else None
        self.trunk, self.hazard, self.mixture_logits = (
            NumpyLinear(tensors, name) for name in ("trunk.2", "hazard", "mixture_logits")
        )
        self.history_rnn = NumpyGRU(tensors, "token", "history_rnn")
        self.candidate, self.known, self.score = (
            NumpyLinear(tensors, f"revisits.{name}") for name in ("candidate", "known", "score")
        )
        self.sds, self.return_sd, self.gelu, self.guidance = weights.sds, weights.return_sd, activation, guidance

    def sample(self, encoded_condition: Float[ndarray, "V _ N W"], uniform: Float[ndarray, "B N U"]) -> SampledEvents:
        """Sample all bins, from event to event; one condition for all rows or one per row.

        Between two events, the hazard depends only on the condition and the age, so several bins are evaluated
        together. The result equals that of `begin` and `advance`.
        """
        # Beyond the last bin the condition is zero and no event can happen.
        entered = np.pad(encoded_condition @ self.condition_weight, ((0, 0), (0, 0), (0, MAX_BLOCK_BINS), (0, 0)))
        least = np.pad(uniform[..., 0], ((0, 0), (0, MAX_BLOCK_BINS)), constant_values=2.0)
        batch, count = uniform.shape[:2]
        encoded_condition, entered = (
            np.broadcast_to(each, (len(each), batch, *each.shape[2:])) for each in (encoded_condition, entered)
        )
        run = self.begin(encoded_condition[:, :, 0], uniform[:, 0])
        event, location = np.zeros((batch, count), bool), np.zeros((batch, count, run.location.shape[1]), np.float32)
        event[:, 0], location[:, 0] = True, run.location
        at = np.zeros(batch, int)  # last sampled bin of each row
        block_bins, events = MAX_BLOCK_BINS, 0
        while len(rows := np.flatnonzero(at < count - 1)):
            ahead = np.arange(1, block_bins + 1)
            bins = at[rows, None] + ahead
            features = self._features(run, rows, entered[:, rows[:, None], bins], run.age[rows, None] + ahead)
            happens = least[rows[:, None], bins] < self._hazard(features)
            moved = happens.any(1)
            first = np.where(moved, happens.argmax(1), block_bins - 1)
            at[rows] += first + 1
            run.age[rows] += first + 1
            if len(new := rows[moved]):
                where = at[new]
                at_event = features[:, moved, first[moved]]
                self._move(run, new, at_event, encoded_condition[:, new, where], uniform[new, where, 2:])
                event[new, where], location[new, where] = True, run.location[new]
                events += len(new)
                block_bins = min(1 + int(BLOCK_MEAN_GAPS * at.sum() / events), MAX_BLOCK_BINS)
        since = np.maximum.accumulate(np.where(event, np.arange(count), 0), axis=1)
        return SampledEvents(event, uniform[..., 1], np.take_along_axis(location, since[..., None], axis=1))

    def begin(self, encoded_condition: Float[ndarray, "V B W"], uniform: Float[ndarray, "B U"]) -> SamplerState:
        """State after the first bin, which always holds an event."""
        (variants, batch), numbers = encoded_condition.shape[:2], self.ar_coefficients.shape[1]
        still = np.repeat(_encode_step(np.zeros((batch, numbers), np.float32))[:, None], self.previous_steps, axis=1)
        run = SamplerState(
            np.tile(self.start, (variants, batch, 1)),
            np.zeros((batch, numbers), np.float32),
            np.zeros((batch, numbers), np.float32),
            still,
            np.zeros(batch, int),
            np.zeros((batch, self.previous_locations, numbers), np.float32),
            np.zeros((batch, self.previous_locations), np.float32),
        )
        rows = np.arange(batch)
        self._move(run, rows, self._bin_features(run, encoded_condition), encoded_condition, uniform[:, 2:])
        return run

    def advance(
        self, run: SamplerState, encoded_condition: Float[ndarray, "V B W"], uniform: Float[ndarray, "B U"]
    ) -> Bool[ndarray, " B"]:
        """Sample one more bin, as streaming needs it, and update the state. Returns the rows with an event."""
        run.age += 1
        features = self._bin_features(run, encoded_condition)
        event: Bool[ndarray, " B"] = uniform[:, 0] < self._hazard(features)
        if len(rows := np.flatnonzero(event)):
            self._move(run, rows, features[:, rows], encoded_condition[:, rows], uniform[rows, 2:])
        return event

    def _bin_features(self, run: SamplerState, encoded_condition: Float[ndarray, "V B W"]) -> Float[ndarray, "V B W"]:
        """Features of one bin of all rows."""
        entered = (encoded_condition @ self.condition_weight)[:, :, None]
        return self._features(run, np.arange(len(run.age)), entered, run.age[:, None])[:, :, 0]

    def _features(
        self, run: SamplerState, rows: Int[ndarray, " S"], entered: Float[ndarray, "V S N W"], age: Int[ndarray, "S N"]
    ) -> Float[ndarray, "V S N W"]:
        """Features of N bins of some rows; `entered` is the projected condition."""
        location = run.location[rows]
        step_encodings = run.step_encodings[rows].reshape(len(rows), -1)
        places = np.concatenate([location, location - run.longest_dwell_location[rows], step_encodings], axis=1)
        state = run.state[:, rows]
        known = np.concatenate([state, np.broadcast_to(places, (*state.shape[:2], places.shape[1]))], axis=2)
        known = known @ self.history_weight
        entered = entered + (known + self.input_bias)[:, :, None] + self.age[np.minimum(age, len(self.age) - 1)]
        return self.gelu(self.trunk(self.gelu(entered)))

    def _hazard(self, features: Float[ndarray, "V *N W"]) -> Float[ndarray, "*N"]:
        return np.asarray(expit(_extrapolate(self.hazard(features)[..., 0], self.guidance.time)))

    def _move(
        self,
        run: SamplerState,
        rows: Int[ndarray, " S"],
        features: Float[ndarray, "V S W"],
        encoded_condition: Float[ndarray, "V S W"],
        uniform: Float[ndarray, "S U"],
    ) -> None:
        """Sample the location of an event in some rows and update their state."""
        old = run.location[rows]
        new = self._place(run, rows, features, uniform)
        since = np.log1p(run.age[rows, None].astype(np.float32))
        event = np.concatenate([new, new - old, since], axis=1)
        for state, condition in zip(run.state, encoded_condition, strict=True):
            state[rows] = self.history_rnn(np.concatenate([event, condition], axis=1), state[rows])
        run.move_to(rows, new)

    def _place(
        self,
        run: SamplerState,
        rows: Int[ndarray, " S"],
        features: Float[ndarray, "V S W"],
        uniform: Float[ndarray, "S U"],
    ) -> Float[ndarray, "S D"]:
        """Sample a location: first the mixture component, then a point of its Gaussian."""
        logits = self.logits(run, rows, features)
        chosen = _sample_categories(logits, uniform[:, 0], self.temperature)
        which = np.minimum(chosen, len(self.ar_coefficients) - 1)
        centre, sd = self.means[which], self.sds[which]
        if self.shift_and_scale is not None:
            adapted = np.where(which[:, None] >= self.absolute_components, self.shift_and_scale(features[0]), 0)
            size = np.exp(adapted[:, -1:].clip(-MAX_LOG_SCALE, MAX_LOG_SCALE))
            centre, sd = adapted[:, :-1] + size * centre, size * sd
        centre = centre + self.ar_coefficients[which] * run.location[rows]
        returns = (chosen >= len(self.ar_coefficients))[:, None]
        back = run.previous_locations[rows, np.maximum(chosen - len(self.ar_coefficients), 0)]
        sd = np.where(returns, self.return_sd, sd)
        normal = ndtri(uniform[:, 1:].astype(float).clip(1e-6, 1 - 1e-6)).astype(np.float32)
        return np.asarray(np.where(returns, back, centre) + np.float32(self.temperature) * normal * sd)

    def logits(
        self, run: SamplerState, rows: Int[ndarray, " S"], features: Float[ndarray, "V S W"]
    ) -> Float[ndarray, "S M"]:
        """Logits of the Gaussians, followed by those of the previous locations, with guidance."""
        previous_locations, dwell_bins = run.previous_locations[rows], run.dwell_bins[rows]
        away, off = (
            previous_locations - run.location[rows, None],
            previous_locations - run.longest_dwell_location[rows, None],
        )
        candidate = self.candidate(np.concatenate([away, off, np.log1p(dwell_bins)[..., None]], axis=-1))
        scored = self.score(self.gelu(candidate + self.recency + self.known(features)[:, :, None]))[..., 0]
        logits = np.concatenate([self.mixture_logits(features), scored], axis=2)
        guided = _extrapolate(logits, self.guidance.location)
        missing = np.pad(dwell_bins == 0, ((0, 0), (guided.shape[1] - dwell_bins.shape[1], 0)))
        return np.where(missing, np.float32(MASKED_LOGIT), guided)


def _extrapolate(values: Float[ndarray, " V *N"], factor: float) -> Float[ndarray, "*N"]:
    """Values under the condition, moved away from those under the neutral one if they are given."""
    if len(values) == 1:
        return np.asarray(values[0])
    given, neutral = values
    return np.asarray(neutral + np.float32(factor) * (given - neutral))


def _sample_categories(
    logits: Float[ndarray, "S M"], uniform: Float[ndarray, " S"], temperature: float
) -> Int[ndarray, " S"]:
    """The numpy version of `sample_categorical` in categorical_sampling.py."""
    if temperature == 0:
        return np.asarray(logits.argmax(-1))
    scaled = logits.astype(float) / temperature
    cumulative = np.exp(scaled - scaled.max(-1, keepdims=True)).cumsum(-1)
    chosen = (cumulative < uniform.astype(float)[:, None] * cumulative[:, -1:]).sum(-1)
    return np.asarray(np.minimum(chosen, logits.shape[-1] - 1))
