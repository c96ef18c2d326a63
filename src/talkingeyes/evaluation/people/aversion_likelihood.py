"""How likely the recorded aversions of people are under a model that was given their turns.

The model's probability that gaze is averted at each moment is the share of many samples, smoothed. A logistic map of
its logit (Platt 1999), fitted to the other units (pairs), takes away how much the model averts gaze and how sure it is,
so that its timing is left. The figure is the log-likelihood of the recorded states less that of the same model given
the turns of SHIFT_S before (with a map of its own), and less that of a constant rate; in nats per second, with one
state a second.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.special import logit

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, ratio_statistic
from talkingeyes.evaluation.people.conversations import RATE_HZ, ConversationGaze
from talkingeyes.evaluation.people.timing import SHIFT_S

SMOOTHING_S = 0.5  # standard deviation
FIT_STEP = 5  # frames, of the states that a map is fitted to
NO_PENALTY = 1e6  # scikit-learn's C


def likelihood_gains(
    people: Sequence[ConversationGaze],
    averted: Sequence[Float[ndarray, " _"]],
    samples: int,
    settings: BootstrapSettings,
) -> dict[str, Estimate]:
    """Gain over the shifted turns (`shifted`) and over a constant rate (`constant`), with intervals over units.

    `averted`: for each person the share of `samples` that are averted, at RATE_HZ, for the first T frames.
    """
    states = [
        (each.averted[: len(share)], each.known[: len(share)]) for each, share in zip(people, averted, strict=True)
    ]
    units = sorted({each.unit for each in people})
    owner = np.concatenate(
        [np.full(known.sum(), units.index(each.unit)) for each, (_, known) in zip(people, states, strict=True)]
    )
    outcome = np.concatenate([state[known] for state, known in states])
    scores = [smoothed_logit(share, samples) for share in averted]
    shift = round(SHIFT_S * RATE_HZ)
    inputs = {
        "own": np.concatenate([score[known] for score, (_, known) in zip(scores, states, strict=True)]),
        "shifted": np.concatenate(
            [np.roll(score, shift)[known] for score, (_, known) in zip(scores, states, strict=True)]
        ),
        "constant": np.zeros(len(outcome)),
    }
    found = {name: _held_out(each, outcome, owner, len(units)) for name, each in inputs.items()}
    counts = np.bincount(owner, minlength=len(units)).astype(float)
    return {
        name: bootstrap(ratio_statistic(found["own"] - found[name], counts), len(units), settings)
        for name in ("shifted", "constant")
    }


def smoothed_logit(share: Float[ndarray, " T"], samples: int) -> Float[ndarray, " T"]:
    """Logit of the smoothed share, with half a sample of each state more (it is never 0 or 1)."""
    smooth = gaussian_filter1d(np.asarray(share, float), SMOOTHING_S * RATE_HZ, mode="nearest")
    return np.asarray(logit((smooth * samples + 0.5) / (samples + 1)))


def _held_out(score: Float[ndarray, " N"], outcome: ndarray, owner: ndarray, units: int) -> Float[ndarray, " U"]:
    """Log-likelihood of each unit under the map that is fitted to the others."""
    from sklearn.linear_model import LogisticRegression

    total = np.zeros(units)
    for unit in range(units):
        own = owner == unit
        fitted = LogisticRegression(C=NO_PENALTY).fit(score[~own][::FIT_STEP, None], outcome[~own][::FIT_STEP])
        log_probability = fitted.predict_log_proba(score[own, None])
        total[unit] = log_probability[np.arange(own.sum()), outcome[own].astype(int)].sum()
    return total
