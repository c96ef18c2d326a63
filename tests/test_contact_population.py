"""Eye contact of synthetic people beside recorded pairs; the estimate finds the population it was made from."""

from pathlib import Path

import numpy as np
import pytest

from pipelines.contact_population import read_people
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.people.contact import (
    Conversation,
    contact_moments,
    estimate_contact,
    read_interviews,
    simulate_contact,
)
from talkingeyes.evaluation.people.conversations import Turns
from talkingeyes.physiology.contact_population import ContactPopulation, contact_habits, read_contact

RECORDED = Path(__file__).resolve().parents[2] / "shared/data/real/gaze"
needs_people = pytest.mark.skipif(not RECORDED.is_dir(), reason="needs recorded people")


def conversation(unit: str, turns: Turns) -> Conversation:
    """Turns of utterances of 2.5 s with short and long pauses between them."""
    seconds = max(span.end_s for span in turns.own + turns.partner)
    spoken = [
        Span(float(start_s), min(float(start_s) + 2.5, turn.end_s))
        for turn in turns.own
        for start_s in np.arange(turn.start_s, turn.end_s, 3.2 if len(turns.own) % 2 else 2.9)
    ]
    annotation = Annotation(speaking=tuple(spoken), listening=turns.partner, partner=turns.partner)
    return Conversation(unit, annotation, turns, seconds)


def alternating(seed: int, seconds: float = 400.0) -> Turns:
    """Turns of 1 to 12 s."""
    rng, times, turns = np.random.default_rng(seed), [0.0], ([], [])
    while times[-1] < seconds:
        times.append(times[-1] + round(np.exp(rng.uniform(0.0, 2.5))))
        turns[len(times) % 2].append(Span(*times[-2:]))
    return Turns.of(*turns)


@needs_people
def test_synthetic_people_look_as_recorded_pairs_do(tmp_path: Path) -> None:
    """Means of both coders in brackets; pauses here are not those of speech, so the bounds are wide."""
    people = read_people(RECORDED, tmp_path)
    talks = [conversation(each.unit, each.turns) for each in people["1"]]
    found = contact_moments(simulate_contact(read_contact("face_to_face"), talks, 2, 0))
    coders = [contact_moments(each) for each in people.values()]
    assert all(each["start_rise"] == pytest.approx(0.15, abs=0.02) for each in coders)  # exchanged persons corrected
    bounds = {"own": 0.06, "partners": 0.06, "looks_away": 3.0, "start_rise": 0.06, "end_fall": 0.06}
    bounds |= {"look": 0.6, "aversion": 0.3, "speaking.away.log_s": 0.2, "listening.away.log_s": 0.2}
    for name, bound in bounds.items():
        assert found[name] == pytest.approx(np.mean([each[name] for each in coders]), abs=bound), name


@pytest.mark.long
def test_the_estimate_finds_its_own_population() -> None:
    truth = read_contact("face_to_face")
    talks = [conversation(str(index), alternating(index)) for index in range(16)]
    people = simulate_contact(truth, talks, 4, 1)
    cues = truth.cues.model_copy(update={"planning": 0.3, "turn_end": 0.35})
    states = {name: law.model_copy(update={"away_s": 0.8, "look_scale": 1.2}) for name, law in truth.states.items()}
    start = truth.model_copy(update={"cues": cues, "states": {**truth.states, **states}})
    found = estimate_contact({"1": people}, talks, start, 0)
    for state in ("speaking", "listening"):
        assert found.states[state].away_s == pytest.approx(truth.states[state].away_s, rel=0.25)
    moments, expected = contact_moments(simulate_contact(found, talks, 4, 2)), contact_moments(people)
    begun = contact_moments(simulate_contact(start, talks, 4, 2))
    assert abs(begun["start_rise"] - expected["start_rise"]) > 0.06  # where it began
    for name in ("own", "partners", "start_rise", "end_fall"):
        assert moments[name] == pytest.approx(expected[name], abs=0.04), name


def test_people_of_a_population_differ_by_its_spread() -> None:
    population = read_contact("face_to_face")
    normal = np.random.default_rng(0).standard_normal((4000, 3))
    people = [contact_habits(population, each) for each in normal]
    shares = np.array([[each.share_speaking, each.share_listening] for each in people])
    logits = np.log(shares / (1 - shares))
    laws = [population.states[state] for state in ("speaking", "listening")]
    np.testing.assert_allclose(np.median(logits, axis=0), [law.logit_share for law in laws], atol=0.07)
    np.testing.assert_allclose(logits.std(axis=0), [law.logit_share_sd for law in laws], rtol=0.12)  # within bounds
    assert np.corrcoef(logits.T)[0, 1] == pytest.approx(population.share_correlation, abs=0.06)
    assert np.log([each.dwell_scale for each in people]).std() == pytest.approx(population.dwell_log_sd, rel=0.05)


def test_interviews_have_unknown_frames_and_a_form(tmp_path: Path) -> None:
    path = tmp_path / "interviews.csv"
    path.write_text("video,target,start_s,end_s\nv1,host,10.0,12.0\nv1,uncertain,13.0,14.0\nv1,camera,16.0,17.0\n")
    (found,) = read_interviews(path)
    assert len(found.averted) == 175 and found.known.sum() == 150
    assert (found.averted & found.known).sum() == 75
    path.write_text("video,start_s,end_s\nv1,1,2\n")
    with pytest.raises(InputError, match="should have a column target"):
        read_interviews(path)


def test_a_damaged_population_is_refused() -> None:
    content = read_contact("face_to_face").model_dump()
    content["states"]["speaking"]["away_s"] = -1.0
    with pytest.raises(ValueError, match="away_s"):
        ContactPopulation.model_validate(content)
