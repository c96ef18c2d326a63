"""Estimate a population of eye contact from recorded conversations, by moments.

Synthetic people are sampled on the recorded turns, and the parameters are those whose moments are nearest to people's:
how long looks last, how much of the time people look away in own turns and in the partner's, the share averted around
starts and ends of own turns, and how people differ in these. The targets are means over the coders; distances are in
standard errors over pairs. Gauss-Newton steps with damping (Levenberg 1944; Marquardt 1963); all simulations of a run
use the same random numbers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import expit, logit
from scipy.stats import norm
from scipy.stats.qmc import Sobol

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.containers import read_csv
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.measures.metric import safe_divide
from talkingeyes.evaluation.measures.partner_gaze import AT_ONSET_S, BEFORE_ONSET_S, averted_around, share_in_window
from talkingeyes.evaluation.people.conversations import OWN, PARTNERS, RATE_HZ, ConversationGaze, Turns
from talkingeyes.evaluation.people.timing import LAGS_S, MEASURES, Sums
from talkingeyes.physiology.contact_population import ContactCues, ContactPopulation, ContactState, StateContact
from talkingeyes.synthesis.gaze_aversion import gaze_intervals
from talkingeyes.synthesis.speakers import sample_style, with_contact

STATES: tuple[ContactState, ContactState] = ("speaking", "listening")
ROLES = {"speaking": OWN, "listening": PARTNERS, "interview": OWN}
MIN_DWELLS = 8  # of a person, for its mean and spread
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
ROUNDS, STEP, TAKES, RESAMPLES, TRIES = 10, 0.3, 4, 30, 5
STATE_PARAMETERS = ("logit_share_sd", "away_s", "away_log_sd", "look_log_sd", "look_scale")
# Choices: spread of cues around their mean times, and cues of short pauses by those of long ones, which turns to the
# second do not show.
DEVIATION_S, FLOOR, PAUSE = 0.5, 0.55, 0.35
LENGTHS_S = {"short": (0.0, 2.5), "middle": (2.5, 4.5), "long": (4.5, np.inf)}  # of own turns
CURVE_STEP = 3  # lags


@dataclass(frozen=True)
class Conversation:
    """A person's speech in a conversation, its turns as they are recorded, and its length."""

    unit: str
    annotation: Annotation
    turns: Turns
    seconds: float


def read_interviews(path: Path) -> list[ConversationGaze]:
    """Gaze of interviewed people: at the host or the camera, averted, or unknown, from the first look to the last.

    A table with the columns video, target (uncertain: not known), start_s, end_s. Raises InputError for another form.
    """
    table = read_csv(path)
    if missing := {"video", "target", "start_s", "end_s"} - set(table.column_names):
        raise InputError(f"{path}: should have a column {min(missing)}, got {', '.join(table.column_names)}")
    rows = table.to_pylist()
    found = []
    for video in sorted({row["video"] for row in rows}):
        looks = [
            (round(float(row["start_s"]) * RATE_HZ), round(float(row["end_s"]) * RATE_HZ), row["target"])
            for row in rows
            if row["video"] == video
        ]
        first, last = min(look[0] for look in looks), max(look[1] for look in looks)
        averted, known = np.ones(last - first, bool), np.ones(last - first, bool)
        for start, end, target in looks:
            (known if target == "uncertain" else averted)[start - first : end - first] = False
        turns = Turns((Span(0.0, (last - first) / RATE_HZ),), ())
        found.append(ConversationGaze(video, averted, known, turns))
    return found


def simulate_contact(
    population: ContactPopulation, conversations: Sequence[Conversation], takes: int, seed: int
) -> list[ConversationGaze]:
    """Gaze of `takes` (a power of 2) people of the population in each conversation, spread evenly over people."""
    people = Sobol(3, rng=np.random.default_rng(seed)).random(takes * 2 ** (len(conversations) - 1).bit_length())
    found = []
    for index, each in enumerate([each for each in conversations for _ in range(takes)]):
        rng = np.random.default_rng([seed, index])
        style = with_contact(sample_style(rng), population, norm.ppf(people[index]))
        averted = np.zeros(int(each.seconds * RATE_HZ), bool)
        for interval in gaze_intervals(each.annotation, style, each.seconds, rng):
            if interval.averted and interval.end_s > 0:
                averted[max(0, round(interval.start_s * RATE_HZ)) : round(interval.end_s * RATE_HZ)] = True
        found.append(ConversationGaze(each.unit, averted, np.ones(len(averted), bool), each.turns))
    return found


def contact_moments(people: Sequence[ConversationGaze]) -> dict[str, float]:
    """Moments of a group of people by name: the measures of timing, and by state those of looks and people."""
    sums = Sums.of(people)
    pooled = sums.chosen(np.arange(len(sums.units)))
    moments = {each.name: each.compute(pooled) for each in MEASURES if each.name != "neithers"}
    for state in STATES:
        moments |= state_moments(people, state)
    for name, (least_s, most_s) in LENGTHS_S.items():
        moments[f"start_rise.{name}"] = _start_rise(people, least_s, most_s)
    for kind, curve in zip(("start", "end"), turn_curves(people)[:, ::CURVE_STEP], strict=True):
        moments |= {
            f"{kind}.{lag_s:.1f}": float(share) for lag_s, share in zip(LAGS_S[::CURVE_STEP], curve, strict=True)
        }
    shares = np.array([[_averted_share(each, ROLES[state]) for each in people] for state in STATES])
    return moments | {"share_correlation": float(np.corrcoef(*shares)[0, 1])}


def state_moments(people: Sequence[ConversationGaze], state: ContactState) -> dict[str, float]:
    """Moments in one state: share of gaze at the partner and duration of looks, with their spreads."""
    role = ROLES[state]
    logits = -np.asarray(logit([_averted_share(each, role) for each in people]))
    moments = {"logit_share": float(logits.mean()), "logit_share_sd": float(logits.std(ddof=1))}
    for averted, name in ((False, "look"), (True, "away")):
        moments |= _dwell_moments([_log_dwells(each, role, averted) for each in people], name)
    return {f"{state}.{name}": value for name, value in moments.items()}


def _start_rise(people: Sequence[ConversationGaze], least_s: float, most_s: float) -> float:
    """Rise of averted gaze at starts of own turns of a length."""
    curve = np.zeros((2, len(LAGS_S)))
    for each in people:
        chosen = [span.start_s for span in each.turns.own if least_s <= span.end_s - span.start_s < most_s]
        curve += averted_around(each.averted, each.known, RATE_HZ, np.array(chosen), LAGS_S)
    after, before = (share_in_window(curve, window, LAGS_S) for window in (AT_ONSET_S, BEFORE_ONSET_S))
    return float(after - before)


def _averted_share(gaze: ConversationGaze, role: int) -> float:
    """Share of averted frames in a role, with half a second of both states more (it is never 0 or 1)."""
    inside = gaze.known & (gaze.turns.role(len(gaze.averted)) == role)
    half = 0.5 * RATE_HZ
    return float((gaze.averted[inside].sum() + half) / (inside.sum() + 2 * half))


def _log_dwells(gaze: ConversationGaze, role: int, averted: bool) -> Float[ndarray, " N"]:
    """Log durations of complete looks that begin in a role."""
    change = np.flatnonzero(np.diff(gaze.steady)) + 1
    first = change[:-1]
    chosen = (gaze.steady[first] == averted) & (gaze.turns.role(len(gaze.averted))[first] == role)
    return np.asarray(np.log(np.diff(change)[chosen] / RATE_HZ))


def _dwell_moments(people: Sequence[Float[ndarray, " _"]], name: str) -> dict[str, float]:
    """Mean and quantiles over all, and standard deviations within and between people."""
    pooled = np.concatenate(people)
    enough = [each for each in people if len(each) >= MIN_DWELLS]
    within = np.array([each.var(ddof=1) for each in enough])
    between = np.var([each.mean() for each in enough], ddof=1) - np.mean(within / [len(each) for each in enough])
    return {
        f"{name}.log_s": float(pooled.mean()),
        f"{name}.within": float(np.sqrt(within.mean())),
        f"{name}.between": float(np.sqrt(max(0.0, between))),
        **{f"{name}.log_q{100 * each:.0f}": float(np.quantile(pooled, each)) for each in QUANTILES},
    }


def turn_curves(people: Sequence[ConversationGaze]) -> Float[ndarray, "2 L"]:
    """Share averted by lag from starts and ends of own turns."""
    averted, counted = np.moveaxis(Sums.of(people).curves.sum(axis=0), 1, 0)
    return np.asarray(safe_divide(averted, counted)).reshape(2, len(LAGS_S))


def estimate_contact(
    coders: Mapping[str, Sequence[ConversationGaze]],
    conversations: Sequence[Conversation],
    start: ContactPopulation,
    seed: int,
) -> ContactPopulation:
    """Estimate speaking, listening and cues from people by coder; `conversations` are the same turns with speech."""
    target, error = target_moments(coders, seed, contact_moments)
    shares = [target[f"{state}.logit_share"] for state in STATES]

    def moments(values: Float[ndarray, " P"]) -> dict[str, float]:
        return contact_moments(simulate_contact(_population(values, start, shares), conversations, TAKES, seed))

    return _population(_fit(_values(start), moments, target, error), start, shares)


def estimate_interview(
    people: Sequence[ConversationGaze],
    monologues: Sequence[Conversation],
    population: ContactPopulation,
    seed: int,
) -> ContactPopulation:
    """The population with its interview estimated from people; `monologues` is speech without a partner."""

    def of(sample: Sequence[ConversationGaze]) -> dict[str, float]:
        return state_moments(sample, "interview")

    target, error = target_moments({"all": people}, seed, of)

    def changed(values: Float[ndarray, " P"]) -> ContactPopulation:
        named = dict(zip(STATE_PARAMETERS, np.exp(values).tolist(), strict=True))
        law = StateContact(logit_share=target["interview.logit_share"], **named)
        return population.model_copy(update={"states": {**population.states, "interview": law}})

    start = _state_values(population.states["interview"])
    return changed(
        _fit(start, lambda values: of(simulate_contact(changed(values), monologues, TAKES, seed)), target, error)
    )


def _fit(
    values: Float[ndarray, " P"],
    moments: Callable[[Float[ndarray, " P"]], Mapping[str, float]],
    target: Mapping[str, float],
    error: Mapping[str, float],
) -> Float[ndarray, " P"]:
    """Values whose moments are nearest to the target, in standard errors."""

    def residuals(at: Float[ndarray, " P"]) -> Float[ndarray, " M"]:
        got = moments(at)
        return np.array([(got[name] - target[name]) / error[name] for name in target])

    left, damping = residuals(values), 1.0
    for _ in range(ROUNDS):
        slopes = np.stack([(residuals(values + step) - left) / STEP for step in STEP * np.eye(len(values))], axis=1)
        normal = slopes.T @ slopes
        for _ in range(TRIES):
            change = -np.linalg.solve(normal + damping * np.diag(normal.diagonal() + 1.0), slopes.T @ left)
            found = residuals(values + change)
            if found @ found < left @ left:
                values, left, damping = values + change, found, damping * 0.2
                break
            damping *= 5.0
    return values


def target_moments(
    coders: Mapping[str, Sequence[ConversationGaze]],
    seed: int,
    moments: Callable[[Sequence[ConversationGaze]], dict[str, float]],
) -> tuple[dict[str, float], dict[str, float]]:
    """Moments of recorded people, means over the coders, and their standard errors over pairs."""
    rng, units = np.random.default_rng(seed), sorted({each.unit for people in coders.values() for each in people})

    def mean(chosen: Mapping[str, int]) -> dict[str, float]:
        found = [
            moments([each for each in people for _ in range(chosen.get(each.unit, 0))]) for people in coders.values()
        ]
        return {name: float(np.mean([each[name] for each in found])) for name in found[0]}

    draws = [mean(Counter(rng.choice(units, len(units)).tolist())) for _ in range(RESAMPLES)]
    return mean(dict.fromkeys(units, 1)), {name: float(np.std([each[name] for each in draws])) for name in draws[0]}


def _values(population: ContactPopulation) -> Float[ndarray, " P"]:
    """The free parameters as unbounded numbers."""
    states = [_state_values(population.states[state]) for state in STATES]
    cues = population.cues
    others = [
        np.arctanh(population.share_correlation),
        np.log(population.dwell_log_sd),
        logit(cues.planning),
        logit(cues.turn_end),
        np.log(cues.planned_s),
        cues.aversion_start_s[0],
        cues.aversion_end_s[0],
        np.mean(cues.return_s),
    ]
    return np.concatenate([*states, others])


def _state_values(law: StateContact) -> Float[ndarray, " P"]:
    return np.log([getattr(law, name) for name in STATE_PARAMETERS])


def _population(values: Float[ndarray, " P"], start: ContactPopulation, shares: Sequence[float]) -> ContactPopulation:
    """The inverse of `_values`; people's shares are the recorded ones."""
    count = len(STATE_PARAMETERS)
    states = {
        state: StateContact(logit_share=share, **dict(zip(STATE_PARAMETERS, np.exp(own).tolist(), strict=True)))
        for state, share, own in zip(STATES, shares, (values[:count], values[count : 2 * count]), strict=True)
    }
    correlation, dwell, planning, turn_end, planned, begin_s, end_s, back_s = values[2 * count :].tolist()
    cues = ContactCues(
        planning=float(expit(planning)),
        floor=FLOOR * float(expit(planning)),
        turn_end=float(expit(turn_end)),
        pause=PAUSE * float(expit(turn_end)),
        planned_s=float(np.exp(planned)),
        aversion_start_s=(begin_s, DEVIATION_S),
        aversion_end_s=(end_s, DEVIATION_S),
        return_s=(back_s - DEVIATION_S, back_s + DEVIATION_S),
    )
    return ContactPopulation(
        source=start.source,
        states={**start.states, **states},
        share_correlation=float(np.tanh(correlation)),
        dwell_log_sd=float(np.exp(dwell)),
        cues=cues,
    )
