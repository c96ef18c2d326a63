"""Gaze against recorded people: detector, censored measures, distances, the two-sample test and the command."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from toy_people import ANNOTATION, ToyPerson, chain_gaze, people_csv

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.gaze_datasets import CONVERSATION_CM, CONVERSATION_CM_PER_PX, CONVERSATION_RATE_HZ
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.people.comparison import compare_with_people, state_table
from talkingeyes.evaluation.people.fixations import (
    VALIDATION_PEOPLE,
    FixationRecord,
    Person,
    merge_fixations,
    read_people,
    split_people,
)
from talkingeyes.evaluation.people.measures import (
    LONGEST_S,
    MEASURES,
    measure_distance,
    measure_floor,
    measure_person,
    people_values,
    restricted_mean_s,
)
from talkingeyes.evaluation.people.tracker import (
    HALF_RANGE_DEG,
    TRACKER,
    GazeClip,
    Samples,
    Tracker,
    detect_screen_fixations,
    record_again,
    record_person,
    track,
    uniform_gaze_deg,
)
from talkingeyes.evaluation.people.two_sample import Sequences, reference_auc, sequences_of, two_sample_auc
from talkingeyes.physiology.gaze_population import STATES
from talkingeyes.workflows.evaluate_people import conversational_state, evaluate_people, people_text

CLEAN = Tracker(noise_deg=0.0, drift_deg=1e-9, loss_per_s=(0.0, 0.0))
SETTINGS = BootstrapSettings(n_resamples=40, confidence_level=0.95, seed=0)


def record(centres, durations=None, segments=None):
    """A record of successive fixations without gaps."""
    centres = np.array(centres, float).reshape(-1, 2)
    durations = np.full(len(centres), 0.3) if durations is None else np.array(durations, float)
    segments = np.zeros(len(centres), int) if segments is None else np.array(segments)
    return FixationRecord(segments, np.cumsum(durations) - durations, durations, centres)


def chain_person(name, seed, tracker=TRACKER, seconds=90.0, **rates):
    """A person who speaks in the first half of each of three clips."""
    rng = np.random.default_rng([seed, 7])
    clips = []
    for _ in range(3):
        gaze = chain_gaze(seconds, rng, **rates)
        state = (np.arange(len(gaze)) >= len(gaze) / 2).astype(int)
        clips.append(GazeClip(50.0, gaze, state, np.zeros(len(gaze), bool)))
    return record_person(name, clips, tracker, rng)


@pytest.fixture(scope="module")
def population():
    """Ten people of one kind; they differ in how often they leave and return."""
    rng = np.random.default_rng(1)
    return [
        chain_person(f"{i:02d}", i, leaving=0.5 * rng.uniform(0.7, 1.4), returning=1.5 * rng.uniform(0.7, 1.4))
        for i in range(10)
    ]


def samples(gaze_deg, lost=()):
    px = np.tan(np.radians(gaze_deg)) * CONVERSATION_CM / CONVERSATION_CM_PER_PX
    flags = np.isin(np.arange(len(px)), list(lost))
    return Samples(px, np.zeros(len(px), int), flags)


def test_detector_follows_the_rules_of_the_data_set():
    gaze = np.zeros((60, 2))
    gaze[20:29] = 5.0  # nine samples: too short
    gaze[29:50] = [10.0, 0.0]
    gaze[50:] = [0.0, 0.6]
    found = detect_screen_fixations(samples(gaze))["speaking"]
    assert np.rint(found.onset_s * CONVERSATION_RATE_HZ).tolist() == [0, 29]  # the last of a run is left out
    assert np.rint(found.duration_s * CONVERSATION_RATE_HZ).tolist() == [20, 21]
    assert found.centre_deg[1] == pytest.approx([10.0, 0.0], abs=1e-9)
    cut = detect_screen_fixations(samples(gaze, lost=[40]))["speaking"]
    assert np.rint(cut.onset_s * CONVERSATION_RATE_HZ).tolist() == [0]  # 29 is now the last of its run, and so is 41


@pytest.mark.parametrize(("extent_deg", "count"), [(0.6, 0), (0.9, 3)])
def test_dispersion_of_thirty_pixels_splits(extent_deg, count):
    gaze = np.zeros((200, 2))
    gaze[:, 1] = np.repeat(np.arange(5) % 2, 40) * extent_deg
    assert len(detect_screen_fixations(samples(gaze))["speaking"]) == (4 if count else 0)


def test_tracker_loses_blinks_and_gaze_off_the_screen():
    gaze = np.zeros((100, 2))
    gaze[60:80] = [60.0, 0.0]
    lost = np.arange(100) < 10
    clip = GazeClip(90.0, gaze, np.zeros(100, int), lost)
    seen = track(clip, np.zeros(2), CLEAN, np.random.default_rng(0))
    assert np.flatnonzero(seen.lost).tolist() == [*range(10), *range(60, 80)]


def test_noise_and_losses_have_the_size_that_is_stated():
    count = 90 * 900
    still = GazeClip(90.0, np.zeros((count, 2)), np.ones(count, int), np.zeros(count, bool))
    with_blinks = Tracker(loss_per_s=(1.43, 0.91))
    found = detect_screen_fixations(track(still, np.zeros(2), with_blinks, np.random.default_rng(0)))["listening"]
    near, ends = np.hypot(*found.shifts_deg.T), found.onset_s + found.duration_s
    spans = ends[found.is_last] - found.onset_s[found.is_first]
    assert 0.6 < found.continues.sum() / spans.sum() < 1.0
    assert 0.25 < np.median(near) < 0.4 and near.max() < 1.5
    assert 1.0 < spans.mean() < 1.6
    assert len(merge_fixations(found)) == len(spans)  # noise alone is merged away


def test_merging_joins_near_fixations_and_cuts_at_gaps():
    plain = record([[0, 0], [1, 0], [0.5, 0.5], [4, 0], [4, 1]], [0.2, 0.2, 0.4, 0.3, 0.3])
    merged = merge_fixations(plain)
    assert merged.duration_s == pytest.approx([0.8, 0.6]) and merged.continues.tolist() == [True]
    assert merged.centre_deg[0] == pytest.approx([0.5, 0.25])
    apart = FixationRecord(
        plain.segment, plain.onset_s + np.array([0, 1, 1, 1, 1]) / 2, plain.duration_s, plain.centre_deg
    )
    assert merge_fixations(apart).segment.tolist() == [0, 1, 1]
    empty = merge_fixations(record([]))
    assert len(empty) == 0 and not len(empty.is_first) and not len(empty.is_last)


def test_restricted_mean_respects_censoring():
    rng = np.random.default_rng(0)
    true, cut = rng.exponential(0.8, 4000), rng.exponential(0.7, 4000)
    expected = 0.8 * (1 - np.exp(-LONGEST_S / 0.8))
    found = restricted_mean_s(np.minimum(true, cut), true > cut)
    assert found == pytest.approx(expected, rel=0.06)
    assert np.minimum(true, cut).mean() < 0.7 * expected  # what ignoring the cuts would give
    assert np.isnan(restricted_mean_s(np.ones(9), np.zeros(9, bool)))


def test_rates_are_recovered_from_cut_recordings():
    person = chain_person("a", 0, CLEAN, seconds=900.0, leaving=0.3, returning=0.8)
    found = measure_person(person, "listening")
    # Stays below 100 ms are no fixations, so both are somewhat low.
    assert 0.24 < found["leaving_rate"] < 0.32 and 0.65 < found["return_rate"] < 0.85
    assert found["away_share"] == pytest.approx(0.3 / 1.1, abs=0.04)
    assert person.home_deg == pytest.approx([0, 0], abs=0.3)


def test_measures_are_missing_where_there_is_too_little():
    person = Person("a", {state: record([[0, 0], [9, 0]]) for state in STATES})
    assert np.isnan(list(measure_person(person, "speaking").values())).all()


def test_people_of_a_kind_are_close_and_baselines_are_not(population):
    others = [chain_person(f"x{i}", 100 + i) for i in range(6)]
    rng = np.random.default_rng(0)
    eyes = []
    for i in range(6):
        gaze = uniform_gaze_deg(4500, 50.0, rng)
        state = (np.arange(4500) >= 2250).astype(int)
        eyes.append(record_person(f"u{i}", [GazeClip(50.0, gaze, state, np.zeros(4500, bool))] * 3, TRACKER, rng))
    for state in STATES:
        values = people_values(population, state)
        same, uniform = (measure_distance(values, group, state, SETTINGS) for group in (others, eyes))
        assert same.mean_ratio.value < 0.9 and uniform.mean_ratio.value > 2
        assert same.mean_ratio.low < same.mean_ratio.high < uniform.mean_ratio.low
        assert same.largest[1] < uniform.largest[1] and uniform.largest[1] > 3
        assert 0.2 < np.nanmean(measure_floor(values, 0)) < 0.8
        assert measure_distance(values, population, state, SETTINGS).mean_ratio.value == 0


def test_few_speakers_are_pooled(population):
    values = people_values(population, "speaking")
    found = measure_distance(values, population[:2], "speaking", SETTINGS)
    assert all(each.pooled for each in found.distances.values())


def test_no_person_weighs_more_than_another(population):
    long = chain_person("00", 0, seconds=360.0)
    values = people_values([long, *population[1:]], "speaking")
    index = [measure.name for measure in MEASURES].index("away_share")
    assert values.medians[index] == pytest.approx(np.median(values.values[index]))


def test_classifier_tells_only_what_differs(population):
    people = sequences_of(population, "speaking")
    same = sequences_of([chain_person(f"x{i}", 200 + i) for i in range(8)], "speaking")
    wide = sequences_of([chain_person(f"y{i}", 300 + i, spread=13.0) for i in range(8)], "speaking")
    assert two_sample_auc(people, same, SETTINGS).value < 0.68
    told = two_sample_auc(people, wide, SETTINGS)
    assert told.value > 0.85 and told.low <= told.value <= told.high
    reference = reference_auc(people, SETTINGS)
    assert reference.low <= reference.value <= reference.high and 0.25 < reference.value < 0.7
    with pytest.raises(InputError, match="needs 20 sequences of 10 fixations, got 5"):
        two_sample_auc(Sequences(people.features[:5], people.owner[:5]), same, SETTINGS)
    three = people.owner < 3
    with pytest.raises(InputError, match="needs 4 people"):
        two_sample_auc(Sequences(people.features[three], people.owner[three]), same, SETTINGS)


def test_classifier_cannot_know_people_by_their_durations_on_another_grid(population):
    people = sequences_of(population, "speaking")
    moved = [
        Person(
            each.name,
            {
                k: FixationRecord(r.segment, r.onset_s, r.duration_s * 1.0004, r.centre_deg)
                for k, r in each.records.items()
            },
        )
        for each in population
    ]
    assert np.array_equal(people.features[:, 8:13], sequences_of(moved, "speaking").features[:, 8:13])


def test_people_recorded_again_are_as_before(population):
    rng = np.random.default_rng(0)
    again = [record_again(person, TRACKER, rng) for person in population]
    names = [measure.name for measure in MEASURES]
    for state in STATES:
        before, after = (people_values(each, state).medians for each in (population, again))
        for name in ("away_share", "horizontal_spread", "vertical_spread", "horizontal_share"):
            assert after[names.index(name)] == pytest.approx(before[names.index(name)], rel=0.25)


def test_uniform_gaze_stays_in_its_range_and_jumps():
    gaze = uniform_gaze_deg(5000, 25.0, np.random.default_rng(0))
    jumps = (np.diff(gaze, axis=0) != 0).any(axis=1).sum()
    assert (np.abs(gaze) <= HALF_RANGE_DEG).all() and 0.25 < jumps / 200 < 0.6


def test_states_come_from_turns_and_long_silences():
    state = conversational_state(ANNOTATION, 120, 10.0)  # speaks from 2 to 5 and from 6 to 9 s
    assert np.flatnonzero(np.diff(state)).tolist() == [19, 89] and state[0] == STATES.index("listening")


# The command.


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return people_csv(tmp_path_factory.mktemp("people") / "people.csv")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """Twelve sounds with their true motion, two of them for training."""
    root = tmp_path_factory.mktemp("corpus")
    clips = []
    for seed in range(12):
        made = ToyPerson(seed, seconds=30.0).at(25.0)
        motion = Motion.of(25.0, made.head, made.gaze, lid=made.lid)
        name, split = f"c{seed}", "train" if seed < 2 else "test"
        clips.append(
            Clip(f"{name}-t0", name, 0, "a", split, motion.seconds, 25.0, "", 0, "en", "", "toy", "CC0-1.0", "")
        )
        ANNOTATION.save(make_shard_path(root / "annotations", name, ".json"))
        motion.save(make_shard_path(root / "truth", f"{name}-t0", ".npz"))
    Corpus(root).write_index(clips)
    return root


def test_people_are_read_by_state(table):
    people = read_people(table)
    assert [each.name for each in people] == [f"{i:02d}" for i in range(6)]
    assert all(len(each.records[state]) > 20 for each in people for state in STATES)
    assert split_people(people) == (people, [])


def test_people_with_fixations_in_one_state_are_taken(table, corpus, tmp_path):
    heading, *rows = table.read_text().splitlines()
    (tmp_path / "one.csv").write_text("\n".join([heading, *(row for row in rows if "SPEAK" in row)]))
    found = evaluate_people(corpus / "truth", tmp_path / "one.csv", reference=corpus)
    assert found.content["states"]["listening"]["people"]["auc"] is None
    (tmp_path / "none.csv").write_text(table.read_text().replace("SPEAK", "DIALOGUE").replace("LISTEN", "DIALOGUE"))
    with pytest.raises(InputError, match="should hold fixations of people who speak or listen"):
        read_people(tmp_path / "none.csv")


def test_command_shows_the_baselines_first_and_writes_json(corpus, table, tmp_path):
    found = evaluate_people(corpus / "truth", table, tmp_path / "out", reference=corpus, n_resamples=20)
    content = json.loads((tmp_path / "out" / "people.json").read_text())
    assert content == json.loads(json.dumps(found.content))
    for state in STATES:
        rows = content["states"][state]["rows"]
        assert list(rows) == ["re-recorded", "uniform", "random", "truth", "motions"]
        assert rows["truth"]["measures"]["away_share"]["value"] == rows["motions"]["measures"]["away_share"]["value"]
        assert rows["random"]["measures"]["away_share"] != rows["truth"]["measures"]["away_share"]
    assert content["tracker"]["noise_deg"] == TRACKER.noise_deg
    text = people_text(found)
    assert "while listening" in text and "mean ratio (at most 0.5)" in text
    assert len(state_table(content, "speaking")) == len(MEASURES) + 5
    with pytest.raises(InputError, match="--force"):
        evaluate_people(corpus / "truth", table, tmp_path / "out", reference=corpus, n_resamples=20)


def test_other_motions_are_rows_beside_the_same_baselines(corpus, table):
    alone = evaluate_people(corpus / "truth", table, reference=corpus, n_resamples=20)
    both = evaluate_people(
        corpus / "truth", table, reference=corpus, n_resamples=20, others={"again": corpus / "truth"}
    )
    for state in STATES:
        rows = both.content["states"][state]["rows"]
        assert rows == alone.content["states"][state]["rows"] | {"again": rows["motions"]}


def test_two_sample_test_without_scikit_learn_is_a_note(corpus, table, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    monkeypatch.setattr("talkingeyes.evaluation.people.two_sample.MIN_SEQUENCES", 4)
    found = evaluate_people(corpus / "truth", table, reference=corpus, n_resamples=20)
    assert found.content["states"]["speaking"]["rows"]["motions"]["auc"] is None
    assert "two-sample test: needs scikit-learn" in people_text(found)


def test_comparison_takes_people_without_a_state(population):
    silent = [Person("s", {"speaking": population[0].records["speaking"], "listening": record([])})]
    content = compare_with_people(population, {"motions": silent}, SETTINGS)
    row = content["states"]["listening"]["rows"]["motions"]
    assert row["mean_ratio"] is None and row["measures"] == {} and "needs 20 sequences" in row["reason"]


def test_speech_of_other_sounds_is_detected(table, tmp_path):
    made = ToyPerson(0, seconds=60.0).at(25.0)
    rng, rate = np.random.default_rng(0), 16000
    speech = rng.normal(0, 1e-4, rate * 60).astype(np.float32)
    for start in range(0, 30, 3):
        speech[start * rate : (start + 2) * rate] *= 1000
    (tmp_path / "motions").mkdir()
    Motion.of(25.0, made.head, made.gaze, lid=made.lid).save(tmp_path / "motions" / "mine_sample_00.npz")
    soundfile.write(tmp_path / "mine.wav", speech, rate)
    found = evaluate_people(tmp_path / "motions", table, sound=tmp_path, n_resamples=20)
    rows = {state: found.content["states"][state]["rows"] for state in STATES}
    assert list(rows["speaking"]) == ["re-recorded", "uniform", "motions"]
    assert all(5 < rows[state]["motions"]["seconds"] < 30 for state in STATES)


def test_a_frozen_gaze_has_no_shifts(corpus, table, tmp_path):
    for index in range(12):
        still = Motion.of(25.0, np.zeros((750, 3)), np.zeros((750, 2, 3)))
        still.save(tmp_path / f"c{index}-t0.npz")
    found = evaluate_people(tmp_path, table, reference=corpus, n_resamples=20)
    row = found.content["states"]["listening"]["rows"]["motions"]
    assert row["measures"]["away_share"]["value"] == 0 and row["measures"]["shift_rate"]["value"] == 0
    assert row["largest"]["ratio"] > 1.5 and "step_median" not in row["measures"]


def test_mistakes_are_one_line(corpus, table, tmp_path):
    with pytest.raises(InputError, match="needs the sounds of the motions; give --reference CORPUS or --sound DIR"):
        evaluate_people(corpus / "truth", table)
    with pytest.raises(InputError, match="should be a folder, got none"):
        evaluate_people(tmp_path / "nowhere", table, reference=corpus)
    with pytest.raises(InputError, match="at least 20 and 0, got 5 and 0"):
        evaluate_people(corpus / "truth", table, reference=corpus, n_resamples=5)
    with pytest.raises(InputError, match="should hold the sounds of the motions, got none of c0-t0"):
        evaluate_people(corpus / "truth", table, sound=tmp_path)
    heading, row, *rows = table.read_text().splitlines()
    for place, cell in ((3, "-1"), (5, "1e15"), (5, "-20"), (5, ""), (6, "nan"), (7, "1e308")):
        cells = [cell if index == place else each for index, each in enumerate(row.split(","))]
        (tmp_path / "row.csv").write_text("\n".join([heading, ",".join(cells), *rows]))
        with pytest.raises(InputError, match=r"row\.csv: row 2: a fixation should be on a screen, begin within a day"):
            read_people(tmp_path / "row.csv")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="should have a column"):
        evaluate_people(corpus / "truth", tmp_path / "other.csv", reference=corpus)
    np.savez(tmp_path / "c2-t0.npz", fps=25.0, lid=np.zeros((100, 2)))
    with pytest.raises(
        InputError, match=r"the motions should hold gaze and head, got none \(.*got no head and no gaze"
    ):
        evaluate_people(tmp_path, table, reference=corpus)


def test_command_needs_no_torch(corpus, table):
    code = "import sys; from talkingeyes.cli.main import main; main(); sys.exit('torch' in sys.modules)"
    options = ["evaluate", corpus / "truth", "--people", table, "--reference", corpus, "--n-resamples", "20"]
    done = subprocess.run([sys.executable, "-c", code, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("while speaking")
    options[options.index("--reference") : options.index("--reference") + 2] = ["--evaluators", corpus]
    done = subprocess.run([sys.executable, "-c", code, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "should not be given with --people" in done.stderr


def test_uniform_eyes_are_far_from_the_figures_of_recorded_people(request):
    """With the aggregate figures of the twelve people, which the repository holds."""
    content = json.loads((request.config.rootpath / "docs/results/people.json").read_text())
    rng, count = np.random.default_rng(3), 25 * 600
    state = (np.arange(count) >= count / 2).astype(int)
    clip = GazeClip(25.0, uniform_gaze_deg(count, 25.0, rng), state, np.zeros(count, bool))
    person = record_person("u", [clip], TRACKER, rng)
    for name in STATES:
        people, ours = content["states"][name]["people"]["measures"], measure_person(person, name)
        ratios = {key: abs(ours[key] - each["median"]) / each["between_people"] for key, each in people.items()}
        assert ratios["away_share"] > 1 and ratios["shift_rate"] > 1 and np.nanmax(list(ratios.values())) > 2


def test_recorded_people_are_twelve_and_four_are_kept_for_validation(request):
    path = request.config.rootpath.parent / "shared/data/real/gaze/conversation_fixations.csv.gz"
    if not path.is_file():
        pytest.skip("no real recordings here")
    train, validation = split_people(read_people(path))
    assert len(train) == 8 and tuple(each.name for each in validation) == VALIDATION_PEOPLE
    content = json.loads((request.config.rootpath / "docs/results/people.json").read_text())
    for state in STATES:
        figures = content["states"][state]["people"]["measures"]
        found = people_values([*train, *validation], state).medians
        assert found == pytest.approx([figures[measure.name]["median"] for measure in MEASURES], rel=1e-6)
