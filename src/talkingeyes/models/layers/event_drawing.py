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
from talkingeyes.models.layers.small_steps import SmallGRU, SmallLinear, array, gelu

if TYPE_CHECKING:
    from talkingeyes.models.layers.event_process import EventProcess

LOOK = 8  # bins that are looked at together; between two events lie some three (heads) to twelve (gaze)


@dataclass(frozen=True)
class Drawn:
    """What was drawn in N bins: whether an event happened, when in its bin (0 to 1), and the place since then."""

    event: Bool[ndarray, "B N"]
    phase: Float[ndarray, "B N"]
    place: Float[ndarray, "B N D"]


@dataclass
class Run:
    """Between two bins: what is remembered, the present place, bins since the last event, the last R places left."""

    state: Float[ndarray, "B W"]
    place: Float[ndarray, "B D"]
    age: Int[ndarray, " B"]
    left: Float[ndarray, "B R D"]
    held: Float[ndarray, "B R"]  # bins; 0: no place was left yet

    def home(self, rows: Int[ndarray, " S"]) -> Float[ndarray, "S D"]:
        """The place that held longest; the present one where none was left yet."""
        held = self.held[rows]
        longest = held.argmax(-1)
        found = self.left[rows, longest]
        return np.asarray(np.where(held.max(-1)[:, None] > 0, found, self.place[rows]))

    def leave(self, rows: Int[ndarray, " S"]) -> None:
        """Some rows leave the place where they are; the oldest that was left is forgotten."""
        self.left[rows] = np.concatenate([self.place[rows, None], self.left[rows, :-1]], axis=1)
        self.held[rows] = np.concatenate([self.age[rows, None], self.held[rows, :-1]], axis=1)


class Drawing:
    """The weights of a process as free runs use them. Uniform numbers decide: D + 3 a bin."""

    def __init__(self, process: EventProcess, temperature: float) -> None:
        """The temperature narrows the choice of a place and the Gaussians."""
        self.means, self.follow = array(process.means()), array(process.follow)
        width, (count, numbers) = process.settings.width, self.means.shape
        self.temperature, self.returns = temperature, process.settings.returns
        self.start, self.age, self.nth = array(process.start), array(process.age.weight), array(process.returns.nth)
        enter, self.enter_bias = array(process.enter.weight).T.copy(), array(process.enter.bias)
        self.enter_state, self.enter_heard = enter[:width], enter[width : 2 * width]
        self.enter_place, self.enter_home = enter[2 * width : 2 * width + numbers], enter[2 * width + numbers :]
        self.trunk = SmallLinear(process.trunk[2])  # type: ignore[arg-type]
        self.hazard, self.weigh = SmallLinear(process.hazard), SmallLinear(process.weigh)
        self.token, self.remember = SmallLinear(process.token), SmallGRU(process.remember)
        of = process.returns
        self.candidate, self.known, self.score = SmallLinear(of.candidate), SmallLinear(of.known), SmallLinear(of.score)
        self.follow = np.concatenate([np.zeros((count - len(self.follow), numbers), np.float32), self.follow])
        self.sds, self.return_sd = (np.exp(array(each)) for each in process.log_sds_in_bounds())

    def sample(self, heard: Float[ndarray, "B N W"], uniform: Float[ndarray, "B N U"]) -> Drawn:
        """The same as bin after bin, but from event to event.

        Nothing that a hazard depends on changes between two events but the condition and the age, so LOOK bins are
        looked at together.
        """
        run = self.begin(heard[:, 0], uniform[:, 0])
        batch, count = heard.shape[:2]
        event, place = np.zeros((batch, count), bool), np.zeros((batch, count, run.place.shape[1]), np.float32)
        event[:, 0], place[:, 0] = True, run.place
        entered = heard @ self.enter_heard
        at = np.zeros(batch, int)  # the last bin that is known, a row each
        ahead = np.arange(1, LOOK + 1)
        while len(rows := np.flatnonzero(at < count - 1)):
            beyond = at[rows, None] + ahead
            bins = np.minimum(beyond, count - 1)
            features = self._features(run, rows, entered[rows[:, None], bins], run.age[rows, None] + ahead)
            happens = (uniform[rows[:, None], bins, 0] < self._hazard(features)) & (beyond < count)
            moved = happens.any(1)
            first = np.where(moved, happens.argmax(1), LOOK - 1)
            place[rows[:, None], bins] = run.place[rows, None]
            at[rows] += first + 1
            run.age[rows] += first + 1
            if len(new := rows[moved]):
                where = at[new]
                self._move(run, new, features[moved, first[moved]], heard[new, where], uniform[new, where, 2:])
                event[new, where], place[new, where] = True, run.place[new]
        return Drawn(event, uniform[..., 1], place)

    def begin(self, heard: Float[ndarray, "B W"], uniform: Float[ndarray, "B U"]) -> Run:
        """The first bin, which holds an event always."""
        batch, numbers = len(heard), self.follow.shape[1]
        run = Run(
            np.repeat(self.start[None], batch, axis=0),
            np.zeros((batch, numbers), np.float32),
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
        known = run.state[rows] @ self.enter_state + place @ self.enter_place
        known += (place - run.home(rows)) @ self.enter_home + self.enter_bias
        entered = entered + known[:, None] + self.age[np.minimum(age, len(self.age) - 1)]
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
        token = self.token(np.concatenate([new, new - old, since, heard], axis=1))
        run.state[rows] = self.remember(token, run.state[rows])
        run.leave(rows)
        run.place[rows], run.age[rows] = new, 0

    def _place(
        self, run: Run, rows: Int[ndarray, " S"], features: Float[ndarray, "S W"], uniform: Float[ndarray, "S U"]
    ) -> Float[ndarray, "S D"]:
        """Where an event leads: one Gaussian, then a number of it."""
        logits = self.logits(run, rows, features)
        chosen = draw(torch.from_numpy(logits), torch.from_numpy(uniform[:, 0]), self.temperature).numpy()
        fixed = np.minimum(chosen, len(self.follow) - 1)
        centre = self.means[fixed] + self.follow[fixed] * run.place[rows]
        back = run.left[rows, np.maximum(chosen - len(self.follow), 0)]
        returns = (chosen >= len(self.follow))[:, None]
        sd = np.where(returns, self.return_sd, self.sds[fixed])
        normal = ndtri(uniform[:, 1:].astype(float).clip(1e-6, 1 - 1e-6)).astype(np.float32)
        return np.asarray(np.where(returns, back, centre) + np.float32(self.temperature) * normal * sd)

    def logits(self, run: Run, rows: Int[ndarray, " S"], features: Float[ndarray, "S W"]) -> Float[ndarray, "S M"]:
        """Of the Gaussians, and after them of the places that were left."""
        left, held = run.left[rows], run.held[rows]
        away, off = left - run.place[rows, None], left - run.home(rows)[:, None]
        candidate = self.candidate(np.concatenate([away, off, np.log1p(held)[..., None]], axis=-1))
        candidate += self.nth + self.known(features)[:, None]
        scored = self.score(gelu(candidate))[..., 0]
        return np.concatenate([self.weigh(features), np.where(held > 0, scored, NEVER)], axis=1)
