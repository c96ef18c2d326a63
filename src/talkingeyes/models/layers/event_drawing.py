"""Free runs of an event process (event_process.py): events drawn one after the other, in numpy.

Every event changes what the next depends on, so a run is a loop of small steps, in which a call of torch costs more
than its arithmetic does: in numpy a run takes a fraction of the time (docs/log.md). The formulas are those that the
process learns with; tests/test_event_drawing.py holds each draw to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.special import expit, ndtri

from talkingeyes.models.layers.draw import draw
from talkingeyes.models.layers.event_returns import NEVER
from talkingeyes.models.layers.event_steps import SHORTEST
from talkingeyes.models.layers.small_steps import SmallGRU, SmallLinear, array, gelu

if TYPE_CHECKING:
    from talkingeyes.models.layers.event_process import EventProcess

# Bins that are looked at together, at most, and in mean gaps between events: heads have some three, gaze twelve.
MOST_LOOKED_AT, LOOKED_AT = 16, 2.0


@dataclass(frozen=True)
class Drawn:
    """What was drawn in N bins: whether an event happened, when in its bin (0 to 1), and the place since then."""

    event: Bool[ndarray, "B N"]
    phase: Float[ndarray, "B N"]
    place: Float[ndarray, "B N D"]


@dataclass
class Run:
    """Between two bins: what is remembered, the present place, headings of the last S steps to it, bins since the last
    event, the last R places left."""

    state: Float[ndarray, "B W"]
    place: Float[ndarray, "B D"]
    home: Float[ndarray, "B D"]  # the place that held longest; the present one where none was left yet
    headings: Float[ndarray, "B S H"]
    age: Int[ndarray, " B"]
    left: Float[ndarray, "B R D"]
    held: Float[ndarray, "B R"]  # bins; 0: no place was left yet

    def go(self, rows: Int[ndarray, " S"], place: Float[ndarray, "S D"]) -> None:
        """Some rows leave the place where they are for another; the oldest that was left is forgotten."""
        old, age = self.place[rows], self.age[rows]
        if self.headings.shape[1]:
            step = np.where(age[:, None] > 0, place - old, 0)  # to the first place leads no step
            self.headings[rows] = _latest(_heading(step), self.headings[rows])
        self.left[rows] = left = _latest(old, self.left[rows])
        self.held[rows] = held = _latest(age.astype(np.float32), self.held[rows])
        longest = held.argmax(-1)
        order = np.arange(len(rows))
        self.home[rows] = np.where(held[order, longest][:, None] > 0, left[order, longest], place)
        self.place[rows] = place
        self.age[rows] = 0


def _heading(step: Float[ndarray, "S D"]) -> Float[ndarray, "S H"]:
    """As event_steps.py has it."""
    length = np.sqrt(np.einsum("sd,sd->s", step, step))[:, None] + np.float32(SHORTEST)
    return np.concatenate([step / length, np.log(length)], axis=1)


def _latest(new: Float[ndarray, "S ..."], past: Float[ndarray, "S R ..."]) -> Float[ndarray, "S R ..."]:
    """As many as before: the new one first, without the oldest."""
    return np.concatenate([new[:, None], past[:, :-1]], axis=1)


class Drawing:
    """The weights of a process as free runs use them. Uniform numbers decide: D + 3 a bin."""

    def __init__(self, process: EventProcess, temperature: float) -> None:
        """The temperature narrows the choice of a place and the Gaussians."""
        self.means, follow = array(process.means()), array(process.follow)
        width, (count, numbers) = process.settings.width, self.means.shape
        self.follow = np.concatenate([np.zeros((count - len(follow), numbers), np.float32), follow])
        self.temperature, self.returns = temperature, process.settings.returns
        self.start, self.age, self.nth = array(process.start), array(process.age.weight), array(process.returns.nth)
        enter, self.enter_bias = array(process.enter.weight).T.copy(), array(process.enter.bias)
        self.enter_heard, self.enter_known = enter[:width], enter[width:]
        self.steps, self.fixed = process.settings.steps, process.settings.fixed
        self.adapt = SmallLinear(process.adapt) if process.adapt is not None else None
        self.most_log_size = process.most_log_size
        self.trunk = SmallLinear(process.trunk[2])  # type: ignore[arg-type]
        self.hazard, self.weigh = SmallLinear(process.hazard), SmallLinear(process.weigh)
        self.remember = SmallGRU(process.token, process.remember)
        of = process.returns
        self.candidate, self.known, self.score = SmallLinear(of.candidate), SmallLinear(of.known), SmallLinear(of.score)
        self.sds, self.return_sd = map(array, process.clean_sds())

    def sample(self, heard: Float[ndarray, "_ N W"], uniform: Float[ndarray, "B N U"]) -> Drawn:
        """The same as bin after bin, but from event to event; all rows hear what is heard, or each its own.

        Nothing that a hazard depends on changes between two events but the condition and the age, so several bins are
        looked at together.
        """
        # Beyond the last bin nothing is heard and nothing happens.
        entered = np.pad(heard @ self.enter_heard, ((0, 0), (0, MOST_LOOKED_AT), (0, 0)))
        least = np.pad(uniform[..., 0], ((0, 0), (0, MOST_LOOKED_AT)), constant_values=2.0)
        batch, count = uniform.shape[:2]
        heard, entered = (np.broadcast_to(each, (batch, *each.shape[1:])) for each in (heard, entered))
        run = self.begin(heard[:, 0], uniform[:, 0])
        event, place = np.zeros((batch, count), bool), np.zeros((batch, count, run.place.shape[1]), np.float32)
        event[:, 0], place[:, 0] = True, run.place
        at = np.zeros(batch, int)  # the last bin that is known, a row each
        look, events = MOST_LOOKED_AT, 0
        while len(rows := np.flatnonzero(at < count - 1)):
            ahead = np.arange(1, look + 1)
            bins = at[rows, None] + ahead
            features = self._features(run, rows, entered[rows[:, None], bins], run.age[rows, None] + ahead)
            happens = least[rows[:, None], bins] < self._hazard(features)
            moved = happens.any(1)
            first = np.where(moved, happens.argmax(1), look - 1)
            at[rows] += first + 1
            run.age[rows] += first + 1
            if len(new := rows[moved]):
                where = at[new]
                self._move(run, new, features[moved, first[moved]], heard[new, where], uniform[new, where, 2:])
                event[new, where], place[new, where] = True, run.place[new]
                events += len(new)
                look = min(1 + int(LOOKED_AT * at.sum() / events), MOST_LOOKED_AT)
        since = np.maximum.accumulate(np.where(event, np.arange(count), 0), axis=1)
        return Drawn(event, uniform[..., 1], np.take_along_axis(place, since[..., None], axis=1))

    def begin(self, heard: Float[ndarray, "B W"], uniform: Float[ndarray, "B U"]) -> Run:
        """The first bin, which holds an event always."""
        batch, numbers = len(heard), self.follow.shape[1]
        still = np.repeat(_heading(np.zeros((batch, numbers), np.float32))[:, None], self.steps, axis=1)
        run = Run(
            np.repeat(self.start[None], batch, axis=0),
            np.zeros((batch, numbers), np.float32),
            np.zeros((batch, numbers), np.float32),
            still,
            np.zeros(batch, int),
            np.zeros((batch, self.returns, numbers), np.float32),
            np.zeros((batch, self.returns), np.float32),
        )
        rows = np.arange(batch)
        features = self._features(run, rows, (heard @ self.enter_heard)[:, None], run.age[:, None])[:, 0]
        self._move(run, rows, features, heard, uniform[:, 2:])
        return run

    def advance(self, run: Run, heard: Float[ndarray, "B W"], uniform: Float[ndarray, "B U"]) -> Bool[ndarray, " B"]:
        """One bin more, as a stream has them: whether an event happens in it; the run moves on."""
        run.age += 1
        every = np.arange(len(heard))
        features = self._features(run, every, (heard @ self.enter_heard)[:, None], run.age[:, None])[:, 0]
        event: Bool[ndarray, " B"] = uniform[:, 0] < self._hazard(features)
        if len(rows := np.flatnonzero(event)):
            self._move(run, rows, features[rows], heard[rows], uniform[rows, 2:])
        return event

    def _features(
        self, run: Run, rows: Int[ndarray, " S"], entered: Float[ndarray, "S N W"], age: Int[ndarray, "S N"]
    ) -> Float[ndarray, "S N W"]:
        """Of N bins of some rows, of which what is heard has entered."""
        place = run.place[rows]
        headings = run.headings[rows].reshape(len(rows), -1)
        known = np.concatenate([run.state[rows], place, place - run.home[rows], headings], axis=1) @ self.enter_known
        entered = entered + (known + self.enter_bias)[:, None] + self.age[np.minimum(age, len(self.age) - 1)]
        return gelu(self.trunk(gelu(entered)))

    def _hazard(self, features: Float[ndarray, "*N W"]) -> Float[ndarray, "*N"]:
        return np.asarray(expit(self.hazard(features)[..., 0]))

    def _move(
        self,
        run: Run,
        rows: Int[ndarray, " S"],
        features: Float[ndarray, "S W"],
        heard: Float[ndarray, "S W"],
        uniform: Float[ndarray, "S U"],
    ) -> None:
        """An event happens in some rows: where it leads, and what is remembered of it."""
        old = run.place[rows]
        new = self._place(run, rows, features, uniform)
        since = np.log1p(run.age[rows, None].astype(np.float32))
        event = np.concatenate([new, new - old, since, heard], axis=1)
        run.state[rows] = self.remember(event, run.state[rows])
        run.go(rows, new)

    def _place(
        self, run: Run, rows: Int[ndarray, " S"], features: Float[ndarray, "S W"], uniform: Float[ndarray, "S U"]
    ) -> Float[ndarray, "S D"]:
        """Where an event leads: one Gaussian, then a number of it."""
        logits = self.logits(run, rows, features)
        chosen = draw(torch.from_numpy(logits), torch.from_numpy(uniform[:, 0]), self.temperature).numpy()
        which = np.minimum(chosen, len(self.follow) - 1)
        centre, sd = self.means[which], self.sds[which]
        if self.adapt is not None:
            adapted = np.where(which[:, None] >= self.fixed, self.adapt(features), 0)
            size = np.exp(adapted[:, -1:].clip(-self.most_log_size, self.most_log_size))
            centre, sd = adapted[:, :-1] + size * centre, size * sd
        centre = centre + self.follow[which] * run.place[rows]
        returns = (chosen >= len(self.follow))[:, None]
        back = run.left[rows, np.maximum(chosen - len(self.follow), 0)]
        sd = np.where(returns, self.return_sd, sd)
        normal = ndtri(uniform[:, 1:].astype(float).clip(1e-6, 1 - 1e-6)).astype(np.float32)
        return np.asarray(np.where(returns, back, centre) + np.float32(self.temperature) * normal * sd)

    def logits(self, run: Run, rows: Int[ndarray, " S"], features: Float[ndarray, "S W"]) -> Float[ndarray, "S M"]:
        """Of the Gaussians, and after them of the places that were left."""
        left, held = run.left[rows], run.held[rows]
        away, off = left - run.place[rows, None], left - run.home[rows, None]
        candidate = self.candidate(np.concatenate([away, off, np.log1p(held)[..., None]], axis=-1))
        candidate += self.nth + self.known(features)[:, None]
        scored = self.score(gelu(candidate))[..., 0]
        return np.concatenate([self.weigh(features), np.where(held > 0, scored, NEVER)], axis=1)
