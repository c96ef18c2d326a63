"""Reference ranges: each statistic recovers known values, and reports insufficient data."""

import json

import numpy as np
import pytest
from toy_people import people

from pipelines.results import reference_ranges, regenerated_takes
from pipelines.results import reference_ranges_page as page
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Events, HeadMovement, Motion, Saccade
from talkingeyes.evaluation.detectors.behaviour import behaviour
from talkingeyes.evaluation.measures import blinks, eye_head, lids_and_jaw, movement, partner_gaze, saccades
from talkingeyes.evaluation.measures.pooled import (
    ClipData,
    FrameProsody,
    Measurement,
    join_pools,
    measurement,
    no_measurement,
)
from talkingeyes.evaluation.measures.pooled import speaking_turns as turns
from talkingeyes.evaluation.reference_ranges import measurements, probes
from talkingeyes.evaluation.reference_ranges.ranges import RANGES_BY_SECTION, REFERENCE_RANGES
from talkingeyes.physiology import saccades as main_sequence_model
from talkingeyes.physiology.blinks import blink_closure


def space(yaw_deg, fps=25.0):
    """Eyes and head of a person with a given yaw of gaze in space and a still head."""
    gaze = rotation.angles_to_gaze(np.radians(np.stack([yaw_deg, np.zeros(len(yaw_deg))], axis=1)))
    still = np.zeros((len(yaw_deg), 3))
    return behaviour(fps, {"head": still, "gaze": np.repeat(gaze[:, None], 2, axis=1)})


def test_range_names_match_measurements_and_bounds_are_ordered():
    names = [fact.name for fact in REFERENCE_RANGES]
    assert len(set(names)) == len(names)
    assert all(fact.low <= fact.high and fact.source for fact in REFERENCE_RANGES)


def test_main_sequence_is_found():
    amplitude = np.repeat(np.arange(1.5, 39), 8)
    rng = np.random.default_rng(0)
    peak = 520 * -np.expm1(-amplitude / 11) * np.exp(0.1 * rng.standard_normal(len(amplitude)))
    found = saccades.main_sequence(amplitude, peak)
    assert found.vmax_deg_s == pytest.approx(520, rel=0.05) and found.constant_deg == pytest.approx(11, rel=0.1)
    pool = {
        "x.amplitude_deg": amplitude,
        "x.peak_deg_s": 100 * amplitude**0.6,
        "x.duration_s": 0.025 + 0.0024 * amplitude,
    }
    assert saccades.log_slope(pool, "x", 0.5, 40.0).value == pytest.approx(0.6)
    line = saccades.main_sequence_model(pool, "x")
    assert line["duration_slope"].value == pytest.approx(2.4, rel=1e-3)
    assert line["duration_intercept"].value == pytest.approx(25, rel=1e-3)


def saccading(fps, seed):
    """Ten saccades of about ten degrees, back and forth."""
    rng = np.random.default_rng(seed)
    chain, at = [], np.zeros(2)
    for onset in 0.5 + 0.8 * np.arange(10) + rng.uniform(0, 0.04, 10):
        goal = np.radians([10.0, 0.0]) if not at.any() else np.zeros(2)
        chain.append(main_sequence_model.sample_saccade(onset, at, goal, rng))
        at = goal
    kinematics = main_sequence_model.gaze_path(chain, (0.0, 0.0), np.arange(round(9 * fps)) / fps)
    return space(np.degrees(kinematics[:, 0]), fps)


def test_rendered_saccades_follow_the_main_sequence():
    fine = join_pools(
        saccades.extract_at_rate("at500", one, saccades.detect_rendered(one))
        for one in (saccading(500.0, seed) for seed in range(12))
    )
    found = saccades.main_sequence_model(fine, "at500")
    assert found["peak_shape"].value == pytest.approx(1.65, abs=0.06)
    assert 1000 * np.median(fine["at500.duration_s"]) == pytest.approx(50.0, abs=2.0)
    pairs = join_pools(
        saccades.match_frame_rates("same25", saccades.detect_rendered(saccading(500.0, s)), saccading(25.0, s).saccades)
        for s in range(12)
    )
    assert saccades.peak_ratio(pairs, "same25", 9.0, 11.0).value == pytest.approx(0.60, abs=0.05)


def test_too_few_events_are_reported():
    pool = saccades.extract_pool(saccading(25.0, 0))
    found = saccades.fraction_below(pool, 5.0)
    assert found.value is None and found.reason == "too few saccades: got 10, needs 100"
    assert measurement(np.nan, 5, "things").reason == "undefined"
    assert measurements.benchmark_metric({}, "head/sd_yaw").reason == "no head"


def test_head_follows_after_the_eyes():
    events = Events(
        saccades=(Saccade(1.0, 0.05, (0.0, 0.0), (0.3, 0.0), 0.4), Saccade(3.0, 0.05, (0.3, 0.0), (0.0, 0.0), 0.4)),
        head_movements=(HeadMovement(1.03, 0.5, (0.0, 0.1, 0.0)), HeadMovement(3.02, 0.5, (0.1, 0.0, 0.0))),
    )
    pool = eye_head.extract_events(events)
    assert pool["lag.s"] == pytest.approx([0.03])  # the second has another direction


def test_head_contribution_and_vergence():
    times = np.arange(250) / 25
    yaw = np.radians(np.where(times > 4, 20.0, 0.0))
    turned = np.radians(10.0) * np.clip((times - 4) / 0.5, 0, 1)
    heads = np.stack([np.zeros(250), turned, np.zeros(250)], axis=1)
    both = np.stack([np.stack([yaw, 0 * yaw], axis=1)] * 2, axis=1)
    both[:, 0, 0] += np.radians(-1.0)
    both[:, 1, 0] += np.radians(1.0)
    gaze = rotation.eye_in_head(heads, both)
    pool = eye_head.extract_pool(behaviour(25.0, {"head": heads, "gaze": gaze}), np.radians(0.5))
    assert pool["shift.eccentricity_deg"] == pytest.approx([20], abs=0.2)
    assert pool["shift.head_deg"] == pytest.approx([10], abs=0.2)
    assert eye_head.vergence_deg(pool).value == pytest.approx(2.5, abs=0.05)
    assert eye_head.within_motor_range(pool).value == 100.0


def test_truncated_dwells_are_censored():
    rng = np.random.default_rng(1)
    length, seen = rng.exponential(3.0, 4000), rng.uniform(1.0, 8.0, 4000)
    cut = length > seen
    assert partner_gaze.kaplan_meier_median(np.minimum(length, seen), cut) == pytest.approx(3 * np.log(2), abs=0.12)
    assert np.isnan(partner_gaze.kaplan_meier_median(np.ones(9), np.ones(9, bool)))


def test_looking_at_utterances():
    times = np.arange(500) / 25
    yaw = np.where((times > 4.2) & (times < 6) | (times > 11.0) & (times < 13), 12.0, 0.0)
    annotation = Annotation(speaking=(Span(5.0, 9.0), Span(12.0, 15.0)), listening=(Span(9.5, 11.5),))
    pool = partner_gaze.extract_pool("a", space(yaw), annotation)
    assert pool["utterance.start_averted"].tolist() == [1, 1] and pool["utterance.end_averted"].tolist() == [0, 0]
    assert pool["aversion.before_onset_s"] == pytest.approx([-0.8, -1.0], abs=0.09)
    looked, listened = pool["look.listening_s"][0]
    assert listened == pytest.approx(2.0) and looked == pytest.approx(1.5, abs=0.1)
    assert [span.start_s for span in turns(annotation)] == [5.0, 12.0]


def test_head_and_prosody():
    rng = np.random.default_rng(0)
    level = rng.standard_normal(400)
    pitch = np.radians(0.5 * level + rng.standard_normal(400))
    heads = np.stack([-pitch, np.zeros(400), np.zeros(400)], axis=1)
    gaze = rotation.eye_in_head(heads, np.zeros((400, 2, 2)))
    seen = behaviour(25.0, {"head": heads, "gaze": gaze})
    frame_prosody = FrameProsody(10 * level - 40, np.full(400, np.nan))
    pool = movement.extract_pool(seen, Annotation(speaking=(Span(0.0, 16.0),)), frame_prosody)
    true = np.corrcoef(pitch, level)[0, 1]
    products = join_pools([pool] * 4)
    assert movement.frame_correlation(products).value == pytest.approx(abs(true), abs=0.01)
    assert true < pool["cca.r"][0] < 0.8
    assert movement.canonical_correlation(heads, heads[:, :1]) == pytest.approx(1.0)


def blinking(fps, onsets):
    found = [Blink(at, 0.09, 0.03, 0.21, 1.0) for at in onsets]
    lid = np.repeat(blink_closure(found, np.arange(round(20 * fps)) / fps)[:, None], 2, axis=1)
    still = np.zeros((len(lid), 3))
    return behaviour(fps, {"head": still, "gaze": np.repeat(still[:, None], 2, axis=1), "lid": lid})


def test_blink_kinematics_are_measured():
    pool = join_pools(blinks.extract_kinematics(blinking(500.0, np.arange(0.5, 19, 0.6))) for _ in range(2))
    found = blinks.blink_kinematics(pool)
    assert found["blink_length"].value == pytest.approx(320, abs=25)
    assert 60 < found["blink_down"].value < 95 and 150 < found["blink_up"].value < 220
    assert found["blink_faster"].value > 1.0


def test_blinks_at_the_ends_of_phrases_and_over_people():
    annotation = Annotation(speaking=(Span(1.0, 9.0), Span(10.0, 19.0)))
    pool = join_pools(blinks.extract_pool(f"{n}", blinking(25.0, [4.0, 9.1, 9.4, 19.2]), annotation) for n in range(20))
    near, near_s, amid, amid_s = pool["phrase.counts"].sum(axis=0)
    assert (near, amid) == (60, 20) and near_s == pytest.approx(40, abs=2) and amid_s == pytest.approx(320, abs=2)
    assert blinks.phrase_end_ratio(pool).value == pytest.approx((60 / near_s) / (20 / amid_s))
    assert blinks.mean_rate(pool)["blink_rate"].reason == "too few speakers with a minute: got 0, needs 5"
    people_rates = np.exp(np.random.default_rng(0).normal(3.1, 0.3, 400))
    assert blinks.log_normal_p(people_rates.tolist()).value > 0.05
    assert blinks.log_normal_p(np.exp(people_rates**2 / 400).tolist()).value < 0.01


def test_lids_that_follow_gaze():
    rng = np.random.default_rng(0)
    angles = np.radians(rng.uniform([-20, -20], [20, 12], (1000, 2)))
    pitch = np.degrees(angles[:, 1])
    pool = {
        "lid.whose": np.repeat(["a left", "b left"], 500),
        "lid.angles_rad": angles,
        "lid.height_deg": np.where(pitch < 0, 1.0, 0.8) * pitch + np.repeat([3.0, -3.0], 500),
    }
    gains = lids_and_jaw.lid_gains(pool)
    assert gains["lid_down"].value == pytest.approx(1.0) and gains["lid_up"].value == pytest.approx(0.8)
    assert 0.95 < lids_and_jaw.lid_r_squared(pool).value < 1.0
    assert lids_and_jaw.eye_aspect_ratio(1.0) < 0.12 and lids_and_jaw.eye_aspect_ratio(0.0) > 0.25


def test_jaw_that_follows_the_envelope():
    times = np.arange(500) / 25
    opening = 0.1 + 0.1 * np.sin(2 * np.pi * 4.3 * times)
    motion = Motion.of(
        25.0, np.zeros((500, 3)), np.zeros((500, 2, 3)), jaw=np.stack([opening, 0 * times, 0 * times], 1)
    )
    seen = behaviour(25.0, {"head": motion.head, "gaze": motion.gaze})
    frame_prosody = FrameProsody(20 * np.log10(np.roll(opening, 1) + 0.01), np.full(500, np.nan))
    pool = join_pools(
        [lids_and_jaw.extract_jaw(motion, seen, Annotation(speaking=(Span(0.0, 20.0),)), frame_prosody)] * 6
    )
    assert lids_and_jaw.jaw_envelope(pool).value == pytest.approx(1.0, abs=1e-2)
    assert lids_and_jaw.jaw_peak_hz(pool).value == pytest.approx(4.3, abs=0.1)
    assert lids_and_jaw.jaw_opening_p95(pool).value == pytest.approx(0.2, abs=0.005)


def test_probes_detect_predictable_targets():
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((4, 6))
    weights[:, :2] = 0  # without the eyes
    people_x = [np.c_[rng.standard_normal((400, 3)), np.ones(400)] for _ in range(6)]
    people_y = [x @ weights + rng.standard_normal((400, 6)) for x in people_x]
    grams = [probes.gram_matrices(x, y) for x, y in zip(people_x, people_y, strict=True)]
    others = [probes.fit_ridge(grams[:index] + grams[index + 1 :]) for index in range(6)]
    score_probe = [probes.score_probe(x, y, weights) for x, y, weights in zip(people_x, people_y, others, strict=True)]
    found = probes.measure_probes(score_probe)
    assert abs(found["eye_r2"].value) < 0.02 and found["head_r2"].value > 0.3 and found["averted_auc"].value > 0.6


def test_features_include_context():
    speech = np.arange(200.0)[:, None] * [1.0, 10.0]
    wide = probes.with_context(speech, [1], 25.0)
    assert wide.shape == (200, 2 + 10 + 1)
    assert wide[100, 2:12].tolist() == [10 * (100 + round(lag * 25)) for lag in probes.LAGS_S if lag]


def test_variance_between_takes():
    rng = np.random.default_rng(0)
    kinematics = np.sin(np.linspace(0, 20, 500))[:, None]
    match_frame_rates, apart = np.stack([kinematics] * 4), rng.standard_normal((8, 500, 1))
    pool = {
        "takes.same": np.stack([probes.between_take_variance(match_frame_rates)] * 3),
        "takes.apart": np.stack([probes.between_take_variance(apart)] * 3),
    }
    assert probes.between_take_fraction(pool, "same").value == pytest.approx(0.0)
    assert probes.between_take_fraction(pool, "apart").value == pytest.approx(1.0, abs=0.05)
    assert probes.between_take_fraction(pool, "jaw").reason == "too few sounds with several takes: got 0, needs 3"


def test_style_icc_increases_with_differences_between_people():
    rng = np.random.default_rng(0)
    groups = [rng.normal(rng.normal(0, 2.0), 1.0, 5) for _ in range(400)]
    assert probes.intraclass_correlation(groups) == pytest.approx(0.8, abs=0.04)


def test_extract_gives_the_sums_of_the_benchmark():
    pool = join_pools(measurements.extract(ClipData("a", one.at())) for one in people(8))
    assert pool["head.frames"].sum() == sum(
        measurements.benchmark_sums(one.at())["head.frames"][0] for one in people(8)
    )
    found = measurements.measure_gaze(pool)
    assert found["vor_yaw"].value == pytest.approx(-1.0, abs=0.05) and found["torsion"].value < 1e-6


def test_page_has_status_and_reasons_for_missing_values():
    found = {
        "below_5": Measurement(0.5, 900, "saccades"),
        "rate": Measurement(9.0, 900, "saccades"),
        "partner_gaze": no_measurement("no one"),
    }
    by_section = page.table_rows(found, {"T": {"rate": Measurement(1.5, 300, "saccades")}})
    rows = {row[0]: row[3:7] for of_section in by_section.values() for row in of_section}
    assert next(row for name, row in rows.items() if name.startswith("P(A < 5"))[:2] == ("0.5", "within")
    assert rows["saccade rate, 1/s"] == ("9", "**outside**", "900 saccades", "T 1.5")
    assert rows["partner gaze while talking, mean over speakers"][:3] == ("-", "-", "no one")
    assert list(by_section) == list(RANGES_BY_SECTION)
    assert page.status_counts(found) == f"1 within, 1 outside, {len(REFERENCE_RANGES) - 2} without a value"


FEW = ("synthesize.clips=12", "synthesize.takes=2")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    from model_conf import compose
    from toy_corpus import make_tiny_corpus

    from talkingeyes.orchestration.config import write_params

    root = tmp_path_factory.mktemp("reference_ranges")
    make_tiny_corpus(root, *FEW)
    write_params(root / "params.yaml", compose(["synthesize=tiny", "machine.jobs=1", *FEW]))
    return root


@pytest.mark.long
def test_a_corpus_without_features_and_fit(tiny, monkeypatch, capsys):
    monkeypatch.chdir(tiny)
    monkeypatch.setattr("sys.argv", ["reference_ranges"])
    monkeypatch.setattr(reference_ranges, "MAX_NATIVE_CLIPS", 3)
    monkeypatch.setattr(reference_ranges, "CANDIDATES", 2)
    reference_ranges.main()
    said = capsys.readouterr().out
    assert "the stage embed has not run" in said and "the stage fit has not run" in said and "too few" in said
    for name in (
        "reference_ranges.md",
        "reference_ranges.csv",
        *(f"pictures/reference-ranges-{each}.png" for each in ("main-sequence", "distributions", "timeline")),
    ):
        assert (tiny / "docs/results" / name).stat().st_size > 1000
    assert str(tiny) not in (tiny / "docs/results/reference_ranges.md").read_text()


def test_take_of_another_corpus_is_an_error(tiny):
    from talkingeyes.orchestration.run import Workspace

    workspace = Workspace.open(tiny)
    source = reference_ranges.source_of(workspace, workspace.corpus)
    clip = source.corpus.clips[0]
    path = next((tiny / "data/synthesize/truth").rglob(f"{clip.id}.events.json"))
    whole = path.read_text()
    path.write_text(json.dumps({**json.loads(whole), "blinks": []}))
    with pytest.raises(InputError, match="should have the regenerated events"):
        regenerated_takes.reproduce_take(source.corpus, source.settings, clip)
    path.write_text(whole)


def test_bad_input_is_one_line(tiny, monkeypatch):
    monkeypatch.chdir(tiny)
    monkeypatch.setattr("sys.argv", ["reference_ranges", "nowhere"])
    with pytest.raises(InputError, match="not a readable corpus index"):
        reference_ranges.main()
