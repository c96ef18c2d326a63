"""Populations of gaze: estimates, simulated people through the tracker, and synthetic people."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.evaluation.people import population
from talkingeyes.evaluation.people.fixations import FixationRecord, Person
from talkingeyes.evaluation.people.population import (
    Estimate,
    as_mapping,
    estimate_population,
    over_people,
    simulate_people,
    standard_errors,
)
from talkingeyes.physiology.blinks import PHYSIOLOGICAL
from talkingeyes.physiology.gaze_population import (
    PERSON_PARAMETERS,
    PLACE_SD_DEG,
    STATES,
    GazeHabits,
    GazePopulation,
    SharedParameters,
    read_population,
    sample_habits,
)
from talkingeyes.synthesis.speakers import sample_style, with_habits
from talkingeyes.synthesis.take import Take, sample_take

POPULATION = read_population("remote_call")
SECONDS = 60.0


def recorded(habits: GazeHabits, name: str, rng: np.random.Generator) -> Person:
    """A person recorded without noise, in segments of two to six fixations."""
    records = {}
    for state in STATES:
        how, place, away = habits.states[state], np.zeros(2), False
        rows: list[tuple[int, float, float, np.ndarray]] = []
        segment, left, time_s = 0, 3, 0.0
        for _ in range(600):
            dwell_s = how.dwell_s(away, rng)
            left -= 1
            rows.append((segment, time_s, dwell_s if left else dwell_s * rng.random(), place))
            time_s += dwell_s
            if left == 0:
                segment, left = segment + 1, int(rng.integers(2, 7))
            away = how.looks_away_next(away, how.partner_share, rng)
            place = how.place_deg(away, place, rng)
        columns = [np.array(each) for each in zip(*rows, strict=True)]
        records[state] = FixationRecord(columns[0], columns[1], columns[2], columns[3])
    return Person(name, records)


@pytest.fixture(scope="module")
def simulated() -> list[Person]:
    """Eight people of the population, as the tracker records them."""
    return simulate_people(POPULATION, 8, seed=0)


class TestEstimates:
    @pytest.mark.long
    def test_estimates_recover_a_population_that_is_seen_without_noise(self) -> None:
        rng = np.random.default_rng(0)
        people = [recorded(sample_habits(POPULATION, rng), str(index), rng) for index in range(20)]
        found = estimate_population(people, "test")
        for state in STATES:
            for name in ("log_s_partner", "log_s_away", "logit_leave"):
                true, got = POPULATION.states[state].people[name], found.states[state].people[name]
                assert abs(got.mean - true.mean) < 4 * true.sd / np.sqrt(20) + 0.1, (state, name)
            shared, got_shared = POPULATION.states[state].shared, found.states[state].shared
            assert got_shared.log_s_sd_partner == pytest.approx(shared.log_s_sd_partner, rel=0.1)
            assert got_shared.log_s_sd_away == pytest.approx(shared.log_s_sd_away, rel=0.1)
            assert got_shared.place_share > 0.7 * shared.place_share
            assert abs(got_shared.step_flatness - shared.step_flatness) < 0.3

    def test_spread_over_people_excludes_the_error_of_each(self) -> None:
        rng = np.random.default_rng(0)
        true = rng.normal(1.0, 0.5, 4000)
        error = rng.choice([0.3, 0.6], 4000)
        found = over_people(
            [Estimate(*each) for each in zip(true + error * rng.standard_normal(4000), error, strict=True)]
        )
        assert found.mean == pytest.approx(1.0, abs=0.05)
        assert found.sd == pytest.approx(0.5, abs=0.03)
        same = over_people([Estimate(2.0, 0.1)] * 5)
        assert (same.mean, same.sd) == (pytest.approx(2.0), 0.0)

    def test_the_tracker_misses_shifts_and_lengthens_fixations(self, simulated) -> None:
        seen = estimate_population(simulated, "test")
        people = [sample_habits(POPULATION, np.random.default_rng([0, index])) for index in range(8)]
        for state in STATES:
            true = np.mean([each.states[state].parameters["log_s_partner"] for each in people])
            assert seen.states[state].people["log_s_partner"].mean > true + 0.1

    def test_standard_errors_are_those_of_drawing_other_people(self, simulated, monkeypatch) -> None:
        monkeypatch.setattr(population, "RESAMPLES", 20)
        same = standard_errors([simulated[0]] * 8, "speaking", seed=0)
        assert max(same.values()) < 1e-9
        found = standard_errors(simulated, "speaking", seed=0)
        assert list(found) == [*PERSON_PARAMETERS, *SharedParameters.model_fields]
        spread = POPULATION.states["speaking"].people["logit_leave"].sd
        assert 0.1 * spread < found["logit_leave"] < spread
        assert 0 < found["step_median_deg"] < 0.5 * POPULATION.states["speaking"].shared.step_median_deg

    def test_a_population_can_be_written_and_read(self) -> None:
        assert GazePopulation.model_validate(as_mapping(POPULATION)) == POPULATION


class TestPeople:
    def test_the_packaged_population_is_whole(self) -> None:
        size = len(STATES) * len(PERSON_PARAMETERS)
        correlation = np.array(POPULATION.correlation)
        assert correlation.shape == (size, size)
        np.testing.assert_allclose(correlation, correlation.T)
        np.testing.assert_allclose(np.diag(correlation), 1.0)
        assert np.linalg.eigvalsh(correlation).min() > 0
        for state in STATES:
            assert tuple(POPULATION.states[state].people) == PERSON_PARAMETERS
            assert all(each.standard_error > 0 for each in POPULATION.states[state].people.values())
            errors = POPULATION.states[state].standard_errors
            assert set(errors) == {*PERSON_PARAMETERS, *SharedParameters.model_fields}
            assert min(errors.values()) > 0

    def test_sampled_people_have_the_spread_of_the_population(self) -> None:
        people = [sample_habits(POPULATION, np.random.default_rng(index)) for index in range(2000)]
        for state in STATES:
            for name, wanted in POPULATION.states[state].people.items():
                values = [each.states[state].parameters[name] for each in people]
                assert np.mean(values) == pytest.approx(wanted.mean, abs=0.1 * wanted.sd + 1e-9)
                assert np.std(values) == pytest.approx(wanted.sd, rel=0.1, abs=1e-9)

    def test_places_are_at_the_partner_or_away(self) -> None:
        how, rng = sample_habits(POPULATION, np.random.default_rng(1)).states["speaking"], np.random.default_rng(2)
        for away in (False, True):
            places = np.array([how.place_deg(away, np.zeros(2), rng) for _ in range(200)])
            assert ((np.hypot(*places.T) > 4.0) == away).all()

    def test_people_go_back_to_a_few_places(self) -> None:
        for seed in range(5):
            how = sample_habits(POPULATION, np.random.default_rng(seed)).states["listening"]
            rng, known = np.random.default_rng([seed, 1]), {False: how.partner_places_deg, True: how.away_places_deg}
            for away, share in ((False, 0.95), (True, how.shared.place_share - 0.15)):
                places = np.array([how.place_deg(away, np.array([60.0, 0.0]), rng) for _ in range(200)])
                nearest = np.hypot(*(places[:, None] - known[away]).transpose(2, 0, 1)).min(axis=1)
                assert (nearest < 4 * PLACE_SD_DEG).mean() > share


def take(annotation: Annotation, seed: int, coupling: float = 1.0) -> Take:
    """A take of a person of the population."""
    rng = np.random.default_rng(seed)
    style = with_habits(sample_style(rng), "remote_call", np.random.default_rng([1, seed]))
    assert style.habits is not None
    return sample_take(annotation, style, SECONDS, rng, PHYSIOLOGICAL)


def averted(takes: list[Take], times_s: np.ndarray) -> np.ndarray:
    """Share of the takes with averted gaze at each time."""
    return np.mean(
        [
            np.any(
                [(times_s >= each.start_s) & (times_s < each.end_s) & each.averted for each in one.gaze_intervals], 0
            )
            for one in takes
        ],
        axis=0,
    )


class TestTakes:
    def test_states_follow_each_other_to_the_end(self) -> None:
        states = take(Annotation(speaking=(Span(0.0, SECONDS),)), 0).gaze_intervals
        assert states[0].start_s <= 0 and states[-1].end_s >= SECONDS
        for one, other in pairwise(states):
            assert one.end_s == other.start_s and one.averted != other.averted

    def test_gaze_is_averted_less_while_listening(self) -> None:
        times = np.arange(2.0, SECONDS - 2.0, 0.1)
        speaking = averted([take(Annotation(speaking=(Span(-9.0, SECONDS + 9),)), seed) for seed in range(15)], times)
        listening = averted([take(Annotation(listening=(Span(-9.0, SECONDS + 9),)), seed) for seed in range(15)], times)
        assert listening.mean() < speaking.mean() - 0.15

    def test_speech_leads_gaze_away_at_the_start_of_a_turn(self) -> None:
        turns = Annotation(speaking=(Span(30.0, 50.0),), listening=(Span(-9.0, 29.5),))
        found = averted([take(turns, seed) for seed in range(50)], np.arange(0.0, 50.0, 0.1))
        assert found[290:310].mean() > found[50:250].mean() + 0.2

    def test_gaze_goes_as_far_as_in_the_recordings(self) -> None:
        ends = [
            np.degrees(each.end_rad)
            for seed in range(30)
            for each in take(Annotation(speaking=(Span(0.0, SECONDS),)), seed).events.saccades
        ]
        low, high = np.array(POPULATION.range_deg)
        far = np.abs(ends).max(axis=0)
        assert far[0] > 27.5 and far[1] > 18.5, "farther than the literature's speakers"
        assert (far <= np.maximum(-low, high) + 5.0).all(), "the partner is a few degrees off"

    def test_gaze_is_that_of_the_saccades(self) -> None:
        one = take(Annotation(speaking=(Span(0.0, SECONDS),)), 3)
        onsets = np.array([each.onset_s for each in one.events.saccades])
        assert (np.diff(onsets) > 0.15).all()
        assert 1.0 < len(onsets) / SECONDS < 4.0
