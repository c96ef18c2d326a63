"""The paper's tables: metrics of a sound, order of rows; rows are computed once."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from model_conf import compose
from toy_workspace import toy_workspace, train_random

from pipelines import critic
from pipelines.results import paper_table_rows, table_runs, tables
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    difference,
    estimate,
    estimate_over_seeds,
    mean_of_known,
    nanmean_statistic,
    ratio_of_known,
)
from talkingeyes.evaluation.papers.talkingeyes_claims import ordered_pairs, rank_order
from talkingeyes.evaluation.papers.talkingeyes_results import (
    high_frequency_motion,
    range_rad,
    row_metrics,
    split_result,
)
from talkingeyes.evaluation.papers.talkingeyes_tables import FAMILIES, REGRESSED, SEQUENCE, TABLES, TITLES, PaperTable
from talkingeyes.evaluation.text_tables import Column
from talkingeyes.orchestration.run import Report
from talkingeyes.orchestration.stage_graph import StageCall

BOOTSTRAP = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)


def over_seeds(*values):
    """The estimate of one metric under several seeds."""
    return estimate_over_seeds([nanmean_statistic(np.asarray(each, float)) for each in values], BOOTSTRAP)


TABLE = PaperTable(
    "Table X: toys",
    "Which?",
    (Column("Div.", "gaze/diversity"),),
    (Column("still", "gaze/still_fraction", 2),),
    {"mean": (0.1,), "talkingeyes_paper": (0.9,), "vae": (0.5,), "random": (0.4,), "sequence": None, "similar": (0.5,)},
    {"talkingeyes_paper": "sequence", "random": None},
)
SPEAKERS = [f"speaker {number // 4}" for number in range(40)]


def one_seed(values, family=REGRESSED):
    """Results of one split with one seed: Diversity of each sound, by row."""
    rows = {name: {"gaze/diversity": mean_of_known(np.asarray(each, float), SPEAKERS)} for name, each in values.items()}
    return split_result(TABLE, rows, ordered_pairs(TABLE, family, "gaze/diversity"), BOOTSTRAP)


def test_rank_order_counts_pairs_and_their_significance():
    noise = np.random.default_rng(0).normal(0, 0.1, 40)
    ours = {
        "talkingeyes_paper": 3 + noise,
        "vae": 1 + noise,
        "random": 2 + noise,
        "mean": 2.001 + 9 * noise,
    }
    came = rank_order(TABLE, REGRESSED, "gaze/diversity", [one_seed(ours)] * 3)
    assert came is not None
    by_names = {(pair.higher, pair.lower): pair for pair in came.pairs}
    full, vae, random, mean = "talkingeyes_paper", "vae", "random", "mean"
    assert set(by_names) == {(full, vae), (full, random), (full, mean), (vae, random), (vae, mean), (random, mean)}
    assert by_names[full, vae].agrees
    assert by_names[full, vae].is_significant
    assert not by_names[vae, random].agrees
    assert by_names[vae, random].is_significant, "one apart in every sound"
    assert not by_names[random, mean].is_significant
    assert came.tau == pytest.approx((came.agreement_count - (6 - came.agreement_count)) / 6)


def test_a_pair_is_significant_over_speakers_and_seeds():
    noise = np.random.default_rng(0).normal(0, 0.1, 40)
    apart, alike = ({"vae": 1 + off + noise, "random": 1 + np.roll(noise, 7)} for off in (1.0, 0.0))
    for seeds, expected in (([apart] * 3, True), ([apart, alike, apart], False), ([alike] * 3, False)):
        came = rank_order(TABLE, REGRESSED, "gaze/diversity", [one_seed(each) for each in seeds])
        assert came is not None
        assert came.pairs[0].is_significant == expected


def test_families_share_baselines_and_exchange_partners():
    pairs = {(pair.higher, pair.lower) for pair in ordered_pairs(TABLE, SEQUENCE, "gaze/diversity")}
    assert pairs == {("sequence", row) for row in ("vae", "mean", "similar")} | {("vae", "mean"), ("similar", "mean")}
    assert rank_order(TABLE, SEQUENCE, "gaze/diversity", [one_seed({"vae": np.ones(40)}, SEQUENCE)]) is None


def test_equal_rows_do_not_agree():
    still = one_seed({"talkingeyes_paper": np.zeros(40), "vae": np.zeros(40)})
    came = rank_order(TABLE, REGRESSED, "gaze/diversity", [still])
    assert came is not None
    assert (came.agreement_count, came.tau, came.pairs[0].is_significant) == (0, 0.0, False)


def test_intervals_over_speakers_take_all_sounds_of_a_speaker():
    by_speaker = np.repeat(np.random.default_rng(0).normal(size=10), 4)
    one = estimate(mean_of_known(by_speaker, SPEAKERS), BOOTSTRAP)
    assert one.value == pytest.approx(by_speaker.mean())
    assert one.speakers_high - one.speakers_low > 1.5 * (one.high - one.low), "four alike sounds are not four people"
    alone = estimate(mean_of_known(by_speaker, [f"{number:02}" for number in range(40)]), BOOTSTRAP)
    assert (alone.speakers_low, alone.speakers_high) == (alone.low, alone.high)
    shifted = difference(mean_of_known(by_speaker + 1, SPEAKERS), mean_of_known(by_speaker, SPEAKERS), BOOTSTRAP)
    assert shifted.speakers_low == pytest.approx(1.0), "both rows on the same speakers"
    half = difference(mean_of_known(np.full(40, 3.0), SPEAKERS), mean_of_known(np.ones(40), SPEAKERS), BOOTSTRAP, 0.5)
    assert half.value == pytest.approx(0.5)


def test_sounds_without_a_value_are_left_out():
    values = np.array([1.0, np.nan, 3.0])
    assert estimate(mean_of_known(values, ["a", "b", "c"]), BOOTSTRAP).value == pytest.approx(2.0)
    ratio = ratio_of_known(values, np.array([2.0, 5.0, 2.0]), ["a", "b", "c"])
    assert estimate(ratio, BOOTSTRAP).value == pytest.approx(1.0)


def test_seeds_are_averaged_on_the_same_clips():
    alike = over_seeds([1.0] * 5, [3.0] * 5)
    assert (alike.value, alike.seed_min, alike.seed_max) == (2.0, 1.0, 3.0)
    assert (alike.low, alike.high) == (2.0, 2.0), "the interval is of clips, not of seeds"
    apart = over_seeds(np.arange(5.0), 4 - np.arange(5.0))
    assert (apart.low, apart.high) == (2.0, 2.0), "both seeds on the same draw of clips"
    assert over_seeds(np.arange(5.0)).low < 1.5


def test_every_row_is_a_model_with_a_title_and_the_papers_numbers_stand_in_conf(repository):
    models = compose(["experiment=paper_tables"])["model"]
    text = (repository / "conf" / "experiment" / "paper_tables.yaml").read_text()
    assert re.search(r"# Question:.*\n(#.*\n)?# Command:.*\n# Expected:", text)
    for name, table in TABLES.items():
        assert set(table.partners) <= set(table.rows)
        for row, numbers in table.rows.items():
            assert row in models
            assert row in TITLES
            for number in numbers or ():
                assert f"{number:g}" in text or f"{number:.5f}" in text, (name, row, number)
        for partner in filter(None, table.partners.values()):
            assert partner in table.rows
            assert table.rows[partner] is None, "the paper's numbers are those of the row with regressed features"


def test_both_families_train_alike_and_a_row_differs_in_its_subject_alone():
    params = compose(["experiment=paper_tables"])
    models, codebooks = params["model"], params["pretrain"]
    own_budget = {"talkingeyes", "talkingeyes_events"}
    rows = {row for table in TABLES.values() for row in table.rows} - own_budget
    budgets = [models[row]["loop"] for row in rows if "loop" in models[row]]
    assert len(budgets) == 17
    assert all(each == budgets[0] for each in budgets)
    for base, row, weights in (
        ("talkingeyes_paper", "without_velocity", {"head_velocity": 0.0, "gaze_velocity": 0.0}),
        ("talkingeyes_paper", "without_regularity", {"gaze_regularity": 0.0}),
        ("sequence", "sequence_without_velocity", {"head_velocity": 0.0}),
    ):
        assert models[row] == {**models[base], "weights": {**models[base]["weights"], **weights}}
    assert models["sequence_vae_gaze"]["head"] == models["sequence"]["head"]
    assert models["sequence_vqvae_head"]["gaze"] == models["sequence"]["gaze"]
    for family, base in (("regressed", "talkingeyes_paper"), ("sequence", "sequence")):
        shared = codebooks[models[base]["tokenizer"]]
        for count in (2048, 1024, 512, 256):
            row = models[f"{family}_{count}"]
            assert {**row, "tokenizer": models[base]["tokenizer"]} == models[base]
            quantiser = {**shared["network"]["quantiser"], "codes": count}
            assert codebooks[row["tokenizer"]] == {**shared, "network": {**shared["network"], "quantiser": quantiser}}


@pytest.mark.long
def test_codebooks_of_table_7_have_the_seed_of_the_training():
    for seed, params in enumerate(table_runs.configs_by_seed(["experiment=paper_tables"], [0, 1])):
        assert params["pretrain"]["gaze_frames"]["seed"] == params["pretrain"]["gaze_patches"]["seed"] == 0
        for row in TABLES["table7"].rows:
            assert params["pretrain"][params["model"][row]["tokenizer"]]["seed"] == seed


def test_what_is_asked():
    wanted = tables.options(["tables=table7,table3", "seeds=1", "experiment=tiny", "machine.jobs=1"])
    assert wanted.words["tables"] == ["table7", "table3"]
    assert (wanted.seeds, wanted.overrides) == ([1], ["experiment=[paper_tables,tiny]", "machine.jobs=1"])
    assert tables.options([]).overrides == ["experiment=[paper_tables]"]
    assert tables.options([]).words["tables"] == list(TABLES)
    with pytest.raises(InputError, match=r"^tables: should be among table3, table5, table6, table7; got 'table4'$"):
        tables.options(["tables=table4"])


def test_high_frequency_motion_is_above_5_hz():
    times = np.arange(1500) / 25
    head, gaze = np.zeros((1500, 3)), np.zeros((1500, 2, 3))
    head[:, 1] = np.radians(2) * np.sin(2 * np.pi * 1 * times)
    gaze[..., 1] = (np.radians(2) * np.sin(2 * np.pi * 8 * times))[:, None]
    measured = high_frequency_motion(head, gaze, 25.0)
    assert measured["head/power_fraction_above_5hz"] < 1e-3
    assert measured["gaze/power_fraction_above_5hz"] > 0.999
    # Differences at 25 frames per second are lower than the true speed by sin(x) / x with x = pi 8 / 25.
    x = np.pi * 8 / 25
    expected = 2 * 2 * np.pi * 8 * np.sin(x) / x / np.sqrt(2) / np.sqrt(2)  # two of four components move
    assert measured["gaze/speed_above_5hz"] == pytest.approx(expected, rel=0.02)
    assert high_frequency_motion(np.zeros((50, 3)), np.zeros((50, 2, 3)), 25.0)["head/speed_above_5hz"] == 0.0


def test_range_is_middle_95_percent_of_rotation():
    motion = np.linspace(0, 1, 1001)[None, :, None] * np.array([1.0, 3.0])
    assert range_rad(motion) == pytest.approx(0.95 * 2)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """Samples of toy recordings, critics, and a trained baseline."""
    made = toy_workspace(tmp_path_factory.mktemp("workspace"))
    critic.run(made)
    train_random(made)
    return made


def test_a_row_is_measured_sound_by_sound_and_on_long_motions(workspace):
    figures = {}
    for row in ("truth", "random", "mismatched"):
        paper_table_rows.measure_row(StageCall("table_metrics", row, (), (), ()), workspace)
        figures[row] = json.loads(workspace.data("table_metrics", row, "metrics.json").read_text())
    random, truth = (row_metrics(figures[name], "test") for name in ("random", "truth"))
    speakers = {each["speaker"] for each in figures["random"]["sounds"]["test"]}
    assert len(random["gaze/l2"].speakers) == 4
    assert set(random["gaze/l2"].speakers) == speakers
    assert [each["speaker"] for each in figures["random"]["long"]["test"]] == sorted(speakers)
    assert estimate(truth["gaze/range_ratio"], BOOTSTRAP).value == pytest.approx(1.0)
    assert 0 < estimate(random["head/power_fraction_above_5hz"], BOOTSTRAP).value < 1
    assert "gaze/diversity" in random
    pairs = [pair for family in FAMILIES for pair in ordered_pairs(TABLES["table3"], family, "gaze/l2")]
    found = split_result(TABLES["table3"], {"random": random, "truth": truth, "mean": random}, pairs, BOOTSTRAP)
    assert found.rows["random"]["gaze/l2"] == estimate(random["gaze/l2"], BOOTSTRAP)
    assert [each.value for each in found.differences.values()] == [0.0]


def test_measured_rows_are_not_recomputed(tmp_path):
    measured = []

    def measure_row(call, workspace):
        measured.append(call.item)
        with workspace.output(call.stage, *call.names) as folder:
            (folder / table_runs.METRICS_FILE).write_text("{}")
        return Report()

    params = {
        "corpus": "data/synthesize",
        "result_store": str(tmp_path / "store"),
        "evaluate": {"seed": 0},
        "machine": {},
    }
    kind = table_runs.RowSpec("toy_row", (), (), ("evaluate",), measure_row, (), ("truth",))
    first, again = (table_runs._row(kind, {}, (params, "truth")) for _ in range(2))
    assert measured == ["truth"]
    assert first == again
    assert first.figures.is_file()
    table_runs._row(kind, {}, ({**params, "evaluate": {"seed": 1}}, "truth"))
    assert measured == ["truth", "truth"]


def test_components_of_a_model_are_trained_first(monkeypatch, tmp_path):
    params, asked = compose(["experiment=posegan", f"result_store={tmp_path}"]), []

    class Stop(Exception):
        pass

    def get_or_run(params, call, upstream):
        asked.append(call.address)
        if call.stage == "sample":
            raise Stop

    monkeypatch.setattr(table_runs, "_obtain", get_or_run)
    kind = table_runs.RowSpec(
        "toy_row", (), (), ("evaluate",), lambda call, workspace: Report(), ("posegan_then_gaze",), ()
    )
    with pytest.raises(Stop):
        table_runs._row(kind, {}, (params, "posegan_then_gaze"))
    assert asked == ["train@posegan", "train@talkingeyes_events", "train@posegan_then_gaze", "sample@posegan_then_gaze"]
    shared = table_runs.shared_calls(params, ["posegan_then_gaze", "talkingeyes_paper"], critic=True)
    assert [call.address for call in shared] == ["synthesize", "fit", "embed", "pretrain@gaze_frames", "critic"]


def test_seeds_with_other_clips_are_left_out():
    found = over_seeds([1.0, 3.0], [2.0, 4.0], [9.0, np.nan])
    assert (found.value, found.seed_min, found.seed_max) == (2.5, 2.0, 3.0)
