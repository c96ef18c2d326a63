"""The benchmark: metrics recover known properties, report missing values, and do not depend on grouping of clips."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from toy_people import ANNOTATION, ToyPerson, people

from pipelines.report import learnt_counts
from pipelines.results.benchmark_page import metrics_csv, page
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.benchmark import comparison as tallies
from talkingeyes.evaluation.benchmark.comparison import Accumulator, Comparison, bootstrap_weights, extract
from talkingeyes.evaluation.benchmark.metric_class import ORIGINS, class_of, code_of, count_learnt
from talkingeyes.evaluation.benchmark.registry import METRICS, VERSION
from talkingeyes.evaluation.benchmark.table import as_json, as_text, from_json, markdown, to_csv
from talkingeyes.evaluation.bootstrap import BootstrapSettings, resample_indices
from talkingeyes.evaluation.detectors.behaviour import behaviour, with_references
from talkingeyes.evaluation.measures import partner_gaze
from talkingeyes.evaluation.measures.metric import Bins
from talkingeyes.models.gaze.saccade_rendering import eyes_towards, render_saccades
from talkingeyes.physiology.saccades import peak_speed

# Values of version 1 for the toy people: metrics, and averted frames around speech (too few for metrics).
GOLDEN = {
    "saccades/rate": 0.9222222,
    "main_sequence/peak_speed_ratio": 0.995972,
    "fixations/duration_median": 0.8935484,
    "partner_gaze/fraction": 0.6176667,
    "eye/range_yaw": 28.48318,
    "head_eye/slope_yaw": -0.9917227,
    "head_eye/head_lag": 0.5418796,
    "blinks/duration_median": 0.2411905,
    "blinks/at_shifts": 1.114918,
    "blinks/at_phrase_ends": 1.051808,
    "gaze_in_space/speed": 7.508088,
    "eye/spectrum_slope": -2.520694,
    "head/speech_speed_ratio": 0.9958583,
}
GOLDEN_TOTALS = {"onset.averted": 1888, "offset.averted": 1926}
SETTINGS = BootstrapSettings(n_resamples=100, confidence_level=0.95, seed=0)
COUNT = 60


def counted(motions, fps=25.0):
    found = Accumulator(fps)
    for motion in motions:
        found.add(extract([motion]))
    return found


def rows(motions, reference, paired=True):
    fps = motions[0].fps
    compared = Comparison(counted(motions, fps), reference, SETTINGS, paired)
    return {row.metric.name: row for row in compared.rows()}


@pytest.fixture(scope="module")
def true():
    plain = [person.at() for person in people(COUNT)]
    return [replace(each, reference=each) for each in plain]


@pytest.fixture(scope="module")
def reference(true):
    return counted(true)


@pytest.fixture(scope="module")
def own(true, reference):
    return rows(true, reference)


def mirrored(motion):
    flip = np.array([1.0, -1.0, -1.0])
    return replace(motion, head=motion.head * flip, gaze=motion.gaze[:, ::-1] * flip)


def test_metric_names_are_unique_and_descriptions_complete():
    assert len({metric.name for metric in METRICS}) == len(METRICS) > 60
    for metric in METRICS:
        assert metric.formula and metric.source and metric.caveat and metric.min_count > 0, metric.name


def test_the_version_changes_with_the_definitions():
    """If this fails, raise document.VERSION (its comment says which part) and set the new hash here."""
    definitions = [
        (each.name, each.unit, each.formula, each.direction, each.min_count, each.count_key, each.rate_dependent)
        for each in METRICS
    ]
    found = hashlib.sha256(json.dumps(definitions).encode()).hexdigest()[:12]
    assert (VERSION, found) == ("1.0", "5274023ee41f")


def test_the_version_changes_with_the_values(own, reference):
    """If this fails, raise the first number of document.VERSION and set the new values here."""
    assert VERSION.startswith("1.")
    assert {name: own[name].value.value for name in GOLDEN} == pytest.approx(GOLDEN, rel=1e-4)
    assert {name: reference.totals()[name].sum() for name in GOLDEN_TOTALS} == GOLDEN_TOTALS


def test_truth_does_not_differ_from_itself(own):
    assert not any(row.worse for row in own.values() if row.metric.compute)
    assert own["saccades/rate"].difference.value == 0
    assert own["saccades/amplitude_distance"].value.value == pytest.approx(0, abs=1e-12)


def test_metrics_recover_known_properties(own):
    value = {name: row.value.value for name, row in own.items() if row.value}
    assert value["saccades/rate"] == pytest.approx(1.05, abs=0.15)
    assert value["main_sequence/peak_speed_ratio"] == pytest.approx(1, abs=0.05)
    assert value["head_eye/slope_yaw"] == pytest.approx(-1, abs=0.02)
    assert value["blinks/rate"] == pytest.approx(24, abs=3)
    assert value["reference_correlation/aversion_yaw"] == pytest.approx(1, abs=1e-6)
    assert value["eye/torsion"] == pytest.approx(0, abs=1e-9)
    assert 0.8 < value["gaze_in_space/still_fraction"] < 0.97


@pytest.mark.parametrize("fps", [25.0, 60.0, 120.0])
def test_truth_follows_main_sequence_at_every_rate(fps):
    found = rows([person.at(fps) for person in people(30)], counted([ToyPerson(1).at(fps)], fps))
    assert found["main_sequence/peak_speed_ratio"].value.value == pytest.approx(1, abs=0.06)
    native = np.degrees(peak_speed(np.radians(5.0)))
    assert native > 200  # of which 25 frames per second show less than half
    assert (found["saccades/duration"].value is None) == (fps < 60)


@pytest.mark.long
def test_mirrored_and_flipped_motion_is_detected(true, reference, own):
    both = rows([mirrored(each) for each in true], reference)
    assert both["reference_correlation/aversion_yaw"].value.value < -0.9
    assert both["reference_correlation/head_roll"].value.value < -0.9
    assert not both["head_eye/slope_yaw"].worse
    head = rows([replace(each, head=each.head * [1, -1, 1]) for each in true], reference)
    assert head["head_eye/slope_yaw"].value.value > 0.5
    assert head["head_eye/slope_yaw"].worse
    down = rows([replace(each, head=each.head * [-1, 1, 1]) for each in true], reference)
    assert down["head_eye/slope_pitch"].value.value > 0.5
    assert own["head_eye/slope_pitch"].value.value < -0.5


def test_a_frozen_face_has_no_saccades(true, reference):
    still = rows([replace(each, head=each.head * 0, gaze=each.gaze * 0) for each in true], reference)
    assert still["saccades/rate"].reason == "needs 30 saccades: the motions have 0"
    assert still["gaze_in_space/still_fraction"].value.value == 1
    assert still["partner_gaze/fraction"].value.value == 1
    assert still["head/spectrum_slope"].value is None


def test_still_face_gives_no_values_from_rounding_errors(true, reference):
    rng = np.random.default_rng(0)

    def still(each):
        dust = 1e-16 * rng.standard_normal((len(each), 9))
        head, gaze = (
            np.array([0.1, -0.2, 0.05]) + dust[:, :3],
            np.array([0.07, 0.13, 0.0]) + dust[:, 3:].reshape(-1, 2, 3),
        )
        return replace(each, head=head, gaze=gaze)

    found = rows([still(each) for each in true], reference)
    spectra = [f"{part}/{of}" for part in ("eye", "gaze_in_space", "head") for of in ("spectrum_slope", "above_5_hz")]
    together = ["head_eye/slope_yaw", "head_eye/slope_pitch", "head_eye/correlation", "eye/conjugacy"]
    for name in [*spectra, *together, "eye/pitch_skew", "head/pitch_velocity_skew", "head/speech_speed_ratio"]:
        assert found[name].value is None, name
    assert found["head/speed"].value.value == pytest.approx(0, abs=1e-9)
    assert found["head/speed"].worse


def test_jitter_and_smoothing_are_detected(true, reference):
    rng = np.random.default_rng(0)
    noisy = rows([replace(each, gaze=each.gaze + rng.normal(0, 0.004, each.gaze.shape)) for each in true], reference)
    assert noisy["gaze_in_space/still_fraction"].value.value < 0.3
    assert noisy["eye/conjugacy"].worse
    kernel = np.ones(5) / 5
    smooth = [replace(each, gaze=np.apply_along_axis(np.convolve, 0, each.gaze, kernel, mode="same")) for each in true]
    assert rows(smooth, reference)["main_sequence/peak_speed_ratio"].value.value < 0.7


def test_missing_fields_are_reported(true, reference):
    found = rows([replace(each, lid=None, annotation=None) for each in true], reference)
    assert found["blinks/rate"].reason == "needs lid: missing in the motions"
    assert found["speech_onset/rise"].reason == "needs annotation: missing in the motions"
    assert found["saccades/rate"].value is not None


def test_other_rates_are_compared_by_rate_independent_metrics(reference):
    found = rows([person.at(60.0) for person in people(COUNT)], reference, paired=False)
    assert found["main_sequence/peak_speed_ratio"].difference is not None
    assert found["gaze_in_space/still_fraction"].value is not None
    assert found["gaze_in_space/still_fraction"].reference is None
    assert found["gaze_in_space/speed_distance"].reason == "not compared: 60 frames per second, reference 25"


def test_few_clips_are_reported_as_too_few(true, reference):
    found = rows(true[:2], reference, paired=False)
    assert found["speech_onset/rise"].reason.startswith("needs 350 speech onsets: the motions have")
    assert found["eye/vergence"].reason == "needs 1500 frames: the motions have 600"


def test_events_at_the_edges_of_a_clip_are_no_events():
    annotation = Annotation(
        speaking=(Span(0.0, 1.0), Span(1.1, 2.5), Span(3.0, 4.0), Span(7.0, 10.0)),
        listening=(Span(4.0, 7.0), Span(9.9, 10.0)),
        pauses=(Span(2.5, 3.0, "hesitation"), Span(0.0, 0.1, "hesitation"), Span(8.0, 8.2, "comma")),
        fillers=(Span(8.4, 8.6),),
    )
    assert partner_gaze.event_times(annotation, 10.0) == {
        "onset": [3.0, 7.0],
        "offset": [2.5, 4.0],
        "turn_start": [7.0],
        "turn_end": [4.0],
        "hesitation": [2.5],
        "filler": [8.4],
    }


def test_gaze_that_leaves_at_starts_and_returns_at_ends_of_turns_is_measured(reference):
    annotation = Annotation(speaking=(Span(0.0, 4.0), Span(8.0, 12.0)), listening=(Span(4.0, 8.0),))
    times_s = np.arange(300) / 25.0
    away_rad = np.radians(15.0) * ((times_s < 4.2) & (times_s > 1.8) | (times_s > 7.6) & (times_s < 10.0))
    gaze = rotation.angles_to_gaze(np.repeat(np.stack([away_rad, np.zeros(300)], axis=-1)[:, None], 2, axis=1))
    motion = behaviour(25.0, {"head": np.zeros((300, 3)), "gaze": gaze}, None, annotation)
    found = rows([motion] * 60, reference, paired=False)
    assert found["turn_start/rise"].value.value == pytest.approx(1.0, abs=0.05)
    assert found["turn_end/rise"].value.value == pytest.approx(-1.0, abs=0.05)
    assert found["hesitation/rise"].reason == "needs 100 hesitations: the motions have 0"


def test_nan_frames_are_invalid_and_not_counted():
    motion = ToyPerson(3).at()
    gaze = motion.gaze.copy()
    gaze[40:50] = np.nan
    holed = behaviour(25.0, {"head": motion.head, "gaze": gaze})
    assert holed.valid.sum() == len(holed) - 10
    assert np.isfinite(holed.gaze).all()
    sums = tallies.LAYOUT.totals(extract([holed])[None])
    assert sums["state.frames"][0] == len(holed) - 10


@pytest.mark.parametrize(
    ("fields", "fps", "message"),
    [
        ({}, 25.0, "should have one of head, gaze, lid, got none"),
        ({"head": np.zeros((50, 2))}, 25.0, r"head: should have shape \(50, 3\)"),
        ({"head": np.zeros((50, 3)), "lid": np.zeros((49, 2))}, 25.0, "lid: should have shape"),
        ({"head": np.zeros((5, 3))}, 25.0, "should last at least 1 s, got 5 frames"),
        ({"head": np.full((50, 3), np.nan)}, 25.0, "should have a valid frame"),
    ],
)
def test_bad_motion_is_one_line_error(fields, fps, message):
    with pytest.raises(InputError, match=message):
        behaviour(fps, fields)


def test_resamples_are_those_of_the_bootstrap():
    drawn = resample_indices(7, SETTINGS)
    assert (bootstrap_weights(7, SETTINGS) == np.array([np.bincount(each, minlength=7) for each in drawn])).all()


def test_groups_do_not_change_the_values(true, reference, monkeypatch):
    expected = reference.totals()
    monkeypatch.setattr(tallies, "MAX_GROUPS", 10)
    few = counted(true)
    assert len(few.groups) == 10
    for name, total in few.totals().items():
        np.testing.assert_allclose(total, expected[name], rtol=1e-9, atol=1e-9)


def test_takes_are_compared_with_each_other():
    takes = with_references([ToyPerson(seed).at() for seed in (1, 2, 3)])
    sums = tallies.LAYOUT.totals(extract(takes)[None])
    assert sums["gaze.sounds"][0] == sums["gaze.judged_sounds"][0] == 1
    assert sums["gaze.diversity"][0] > 0.05
    assert with_references(takes[:1])[0].reference is takes[0].reference


def test_the_page_is_fresh(repository):
    assert (repository / "docs" / "benchmark.md").read_text() == page(repository / "docs")
    assert (repository / "docs" / "benchmark_metrics.csv").read_text() == metrics_csv()


def test_classes_name_metrics_once():
    named = [metric for origin in ORIGINS for metric in origin.metrics]
    assert len(set(named)) == len(named)
    assert set(named) <= {metric.name for metric in METRICS}
    assert {class_of(metric.name) for metric in METRICS} == {"learnt", "corrected", "rule", "construction"}
    assert (class_of("saccades/rate"), code_of("saccades/rate")) == ("learnt", "")


def test_metrics_by_construction_hold_for_random_events():
    """Locations and times without any structure, rendered as by the default model, under moving heads."""
    rng = np.random.default_rng(0)
    times_s = np.arange(300) / 25

    def motion():
        onsets = np.cumsum(rng.uniform(0.4, 1.5, (1, 8)), axis=1)
        locations = np.append(rng.normal(0, 0.12, (1, 8, 2)), np.full((1, 8, 1), -0.06), axis=2)
        signal = render_saccades(np.ones((1, 8), bool), onsets, locations, times_s)
        phase = 2 * np.pi * (rng.uniform(0.2, 0.8, 3) * times_s[:, None] + rng.random(3))
        head = 0.06 * np.sin(phase)[None]
        return behaviour(25.0, {"head": head[0], "gaze": eyes_towards(head, signal)[0]})

    made = [motion() for _ in range(60)]
    found = {name: row.value.value for name, row in rows(made, counted(made)).items() if row.value}
    assert found["main_sequence/peak_speed_ratio"] == pytest.approx(1.0, abs=0.05)
    assert found["main_sequence/slope"] == pytest.approx(0.0, abs=0.05)
    assert found["eye/torsion"] == pytest.approx(0.0, abs=1e-6)
    assert found["eye/conjugacy"] > 0.95
    assert found["head_eye/slope_yaw"] == pytest.approx(-1.0, abs=0.05)
    assert found["head_eye/slope_pitch"] == pytest.approx(-1.0, abs=0.05)
    assert found["head_eye/correlation"] < -0.95


def test_learnt_metrics_are_counted(own, true, reference):
    assert count_learnt(list(own.values())).worse == 0
    still = [replace(each, gaze=np.zeros_like(each.gaze), head=np.zeros_like(each.head)) for each in true]
    table = list(rows(still, reference).values())
    found = count_learnt(table)
    assert 0 < found.worse <= found.compared
    compared = [row for row in table if row.worse is not None]
    assert found.compared == sum(class_of(row.metric.name) == "learnt" for row in compared) < len(compared)
    assert f"Still: {found.worse} of {found.compared}." in learnt_counts({"Still": table})


def test_quantiles_and_distances_of_bins():
    rng = np.random.default_rng(0)
    one, other = rng.normal(5, 1, 20000), rng.normal(6, 1, 20000)
    bins = Bins(0.0, 12.0, 240)
    counts = np.stack([bins(one), bins(other)])
    assert bins.quantile(counts, 0.9) == pytest.approx([np.quantile(one, 0.9), np.quantile(other, 0.9)], abs=0.02)
    assert bins.distance(counts[:1], counts[1:]) == pytest.approx([1.0], abs=0.03)
    assert bins.fraction_below(counts, 6.0)[1] == pytest.approx(0.5, abs=0.02)


def test_tables_hold_every_row_and_read_back(own):
    table = list(own.values())
    content = json.loads(as_json(table, {"sounds": COUNT}))
    assert from_json(content) == table
    assert len(to_csv(table).splitlines()) == len(as_text(table).splitlines()) == len(METRICS) + 1
    page = markdown({"truth": table, "again": table}, {"truth": "Truth"})
    assert page.splitlines()[0] == "| metric | unit | Truth | again |"
    assert ANNOTATION.speaking[0].start_s == 2.0
