"""The paper's tables: metrics of a sound, order of rows, the page, canonical correlation; rows are computed once."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from toy import CHANNELS, recordings
from toy_workspace import toy_workspace, train_random

from pipelines import critic, paper_table_rows, table_runs, tables
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.multi_seed import ClipStatistic, MultiSeedStatistic, nanmean_statistic
from talkingeyes.evaluation.tables.definitions import TABLES, TITLES, Column, PaperTable
from talkingeyes.evaluation.tables.page import as_json, markdown, table_result
from talkingeyes.evaluation.tables.rank_order import rank_order
from talkingeyes.evaluation.tables.row_metrics import high_frequency_motion, range_rad, row_metrics
from talkingeyes.models.condition.conditioner import NO_CONDITIONING
from talkingeyes.models.gaze.canonical_correlation import (
    CanonicalCorrelationSettings,
    Example,
    fit_canonical_correlation,
    generate_gaze,
)
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import Report
from talkingeyes.orchestration.stage_graph import StageCall
from talkingeyes.training.canonical_gaze import CanonicalModelSettings, fit_canonical_gaze, save_canonical
from talkingeyes.training.checkpoint import load
from talkingeyes.training.motion_generators import load_generator

BOOTSTRAP = BootstrapSettings(n_resamples=200, confidence_level=0.95, seed=0)
CANONICAL = CanonicalCorrelationSettings(
    speech_components=5,
    lags_frames=(-1, 0, 1),
    context_frames=1,
    fourier_features=64,
    kernel_width=1.0,
    canonical_components=6,
    ridge=1e-4,
)


def seeds_of(*values):
    """One metric under several seeds."""
    return MultiSeedStatistic(tuple(nanmean_statistic(np.asarray(each, float)) for each in values))


def test_rank_order_counts_pairs_and_their_significance():
    random = np.random.default_rng(0)
    noise = random.normal(0, 0.1, 40)
    ours = {
        "a": seeds_of(3 + noise),
        "b": seeds_of(1 + noise),
        "c": seeds_of(2 + noise),
        "d": seeds_of(2.001 + 9 * noise),
    }
    came = rank_order({"a": 0.9, "b": 0.5, "c": 0.4, "d": 0.1, "absent": 7.0}, ours, BOOTSTRAP)
    assert came is not None
    by_names = {(pair.higher, pair.lower): pair for pair in came.pairs}
    assert set(by_names) == {("a", "b"), ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("c", "d")}
    assert by_names["a", "b"].agrees
    assert by_names["a", "b"].is_significant
    assert not by_names["b", "c"].agrees
    assert by_names["b", "c"].is_significant, "one apart in every clip"
    assert not by_names["c", "d"].is_significant
    assert came.tau == pytest.approx((came.agreement_count - (6 - came.agreement_count)) / 6)
    assert not came.all_agree
    right = rank_order({"a": 3.0, "c": 2.0, "b": 1.0}, ours, BOOTSTRAP)
    assert right is not None
    assert (right.all_agree, right.tau) == (True, 1.0)
    assert rank_order({"a": 1.0, "b": 1.0}, ours, BOOTSTRAP) is None, "equal in the paper: no order"


def test_equal_rows_do_not_agree():
    still = seeds_of(np.zeros(5))
    came = rank_order({"a": 1.0, "b": 0.5}, {"a": still, "b": still}, BOOTSTRAP)
    assert came is not None
    assert (came.agreement_count, came.tau, came.pairs[0].is_significant) == (0, 0.0, False)


def test_seeds_are_averaged_on_the_same_clips():
    alike = seeds_of([1.0] * 5, [3.0] * 5).estimate(BOOTSTRAP)
    assert (alike.value, alike.seed_min, alike.seed_max) == (2.0, 1.0, 3.0)
    assert (alike.low, alike.high) == (2.0, 2.0), "the interval is of clips, not of seeds"
    apart = seeds_of(np.arange(5.0), 4 - np.arange(5.0)).estimate(BOOTSTRAP)
    assert (apart.low, apart.high) == (2.0, 2.0), "both seeds on the same draw of clips"
    assert seeds_of(np.arange(5.0)).estimate(BOOTSTRAP).low < 1.5


TABLE = PaperTable(
    "Table X: toys",
    "Which?",
    (Column("Div.", "gaze/diversity"),),
    (Column("still", "gaze/still_fraction", 2),),
    {"vae": (0.25,), "talkingeyes_paper": (0.5,), "talkingeyes_events": None},
)


def test_page_has_our_values_published_values_and_order():
    ours = {
        name: {"gaze/diversity": seeds_of([value] * 3, [value + 0.1] * 3)}
        for name, value in (("vae", 0.4), ("talkingeyes_paper", 0.1), ("talkingeyes_events", 0.2))
    }
    came = table_result(TABLE, {**ours, "truth": {"gaze/diversity": seeds_of([0.3])}}, BOOTSTRAP)
    page = markdown(TABLE, {"test": came})
    assert "**0.450**<br><sub>0.450 to 0.450; seeds 0.400 to 0.500</sub><br>paper 0.250" in page
    assert page.index("| Truth |") < page.index("| VAE")
    assert "| Div. | no | 0 of 1 | -1.00 | TalkingEyes as written > VAE | – |" in page
    plain = as_json(TABLE, {"test": came})
    assert plain["rows"]["vae"]["paper"] == {"gaze/diversity": 0.25}
    assert plain["rows"]["talkingeyes_events"]["paper"] is None
    assert plain["orders"]["test"]["gaze/diversity"]["agreeing"] == 0
    json.dumps(plain)


def test_every_row_is_a_model_with_a_title_and_the_papers_numbers_stand_in_conf(repository):
    params = compose([f"experiment=[{','.join(TABLES)}]"])
    for name, table in TABLES.items():
        alone = compose([f"experiment={name}"])
        text = (repository / "conf" / "experiment" / f"{name}.yaml").read_text()
        assert re.search(r"# Question:.*\n# Command:.*\n# Expected:", text)
        for row, sound_metrics in table.rows.items():
            assert alone["model"][row] == params["model"][row], "equal names, equal models"
            assert row in TITLES
            for number in sound_metrics or ():
                assert f"{number:g}" in text or f"{number:.5f}" in text, (name, row, number)
    paper = params["model"]["talkingeyes_paper"]
    for row in ("codes_256", "codes_512", "codes_2048"):
        codes = params["pretrain"][params["model"][row]["tokenizer"]]["network"]["quantiser"]["codes"]
        assert row == f"codes_{codes}"
        assert {**params["model"][row], "tokenizer": paper["tokenizer"]} == paper
    assert params["pretrain"][paper["tokenizer"]]["network"]["quantiser"]["codes"] == 1024


def test_what_is_asked():
    wanted = tables.options(["tables=table7,table3", "seeds=1", "experiment=tiny", "machine.jobs=1"])
    assert wanted.words["tables"] == ["table7", "table3"]
    assert (wanted.seeds, wanted.overrides) == ([1], ["experiment=[table7,table3,tiny]", "machine.jobs=1"])
    assert tables.options([]).overrides == ["experiment=[table3,table5,table6,table7]"]
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
    random, truth = (row_metrics([figures[name]], "test") for name in ("random", "truth"))
    assert random["gaze/l2"].count == 4
    assert len(figures["random"]["long"]["test"]) == paper_table_rows.LONG_MOTIONS
    assert truth["gaze/range_ratio"].estimate(BOOTSTRAP).value == pytest.approx(1.0)
    assert 0 < random["head/power_fraction_above_5hz"].estimate(BOOTSTRAP).value < 1
    assert "gaze/diversity" in random
    both = row_metrics([figures["random"], figures["random"]], "unseen")
    assert len(both["head/corr"].by_seed) == 2
    page = table_result(TABLES["table3"], {"random": random, "truth": truth}, BOOTSTRAP)
    assert page.cells["random"]["gaze/l2"].value == random["gaze/l2"].estimate(BOOTSTRAP).value


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
    params, asked = compose(["experiment=table3", f"result_store={tmp_path}"]), []

    class Stop(Exception):
        pass

    def get_or_run(params, call, upstream):
        asked.append(call.address)
        if call.stage == "sample":
            raise Stop

    monkeypatch.setattr(table_runs, "_obtain", get_or_run)
    kind = table_runs.RowSpec(
        "toy_row", (), (), ("evaluate",), lambda call, workspace: Report(), ("canonical_correlation",), ()
    )
    with pytest.raises(Stop):
        table_runs._row(kind, {}, (params, "canonical_correlation"))
    assert asked == ["train@talkingeyes_paper", "train@canonical_correlation", "sample@canonical_correlation"]
    assert [call.address for call in table_runs.shared_calls(params, ["canonical_correlation"], critic=True)] == [
        "synthesize", "fit", "embed", "pretrain@gaze_frames", "critic",
    ]  # fmt: skip


def related(count, seed, frames=200):
    """Motions whose gaze is a function of head and speech, partly nonlinear."""
    random = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        speech, head = random.normal(size=(frames, 5)), random.normal(size=(frames, 3)) * 0.2
        gaze = np.zeros((frames, 2, 3))
        gaze[..., 0] = (0.3 * speech[:, 0] - head[:, 0])[:, None]
        gaze[..., 1] = (0.5 * np.tanh(head[:, 1] * 3) - 0.2 * head[:, 1])[:, None]
        made.append(Example(speech, head, gaze))
    return made


def test_canonical_correlation_finds_dependence_on_head_and_speech():
    examples = related(12, seed=0)
    relation = fit_canonical_correlation(CANONICAL, examples, seed=0)
    assert (np.diff(relation.correlations) <= 1e-12).all()
    assert relation.correlations[0] > 0.99
    new = related(3, seed=1)
    ours = np.concatenate([generate_gaze(CANONICAL, relation, each.speech, each.head) for each in new])
    true = np.concatenate([each.gaze for each in new])
    assert ((ours - true) ** 2).mean() < 0.1 * ((true - true.mean(0)) ** 2).mean()
    few = fit_canonical_correlation(CANONICAL.model_copy(update={"canonical_components": 1}), examples, seed=0)
    worse = np.concatenate([generate_gaze(CANONICAL, few, each.speech, each.head) for each in new])
    assert ((worse - true) ** 2).mean() > ((ours - true) ** 2).mean()


def test_canonical_model_is_a_generator_and_loads(tmp_path, workspace):
    head = load(workspace.data("train", "random"))
    clips = [replace(each, speech=each.speech[:, :5]) for each in recordings(6, seed=4)]
    names = json.loads(workspace.data("embed", "embedding.json").read_text())["channels"]
    settings = CanonicalModelSettings(
        kind="canonical_correlation", parts=("head", "gaze"), tokenizer=None, source_models=("random",), gaze=CANONICAL
    )
    normaliser = Normaliser(tuple(names), np.zeros(5, np.float32), np.ones(5, np.float32))
    model = fit_canonical_gaze(settings, clips, normaliser, seed=0)
    save_canonical(tmp_path, settings, model, head)
    generator, speech = load_generator(tmp_path), clips[0].speech
    many, one = generator.generate(speech, [3, 4], 25.0), generator.generate(speech, [4], 25.0)
    assert np.array_equal(many.gaze[1], one.gaze[0])
    assert np.array_equal(
        many.head, load_generator(workspace.data("train", "random")).generate(speech, [3, 4], 25.0).head
    )
    assert np.allclose(many.gaze, model.generate_gaze(speech, many.head, [], NO_CONDITIONING))
    assert not np.allclose(many.gaze[0], many.gaze[1]), "another head, another gaze"
    for frames in (1, 3, 40):
        assert generator.generate(speech[:frames], [1], 25.0).gaze.shape == (1, frames, 2, 3)


def test_a_measured_statistic_is_one_of_its_clips():
    assert ClipStatistic(lambda drawn: float(drawn.sum()), 4).point_estimate() == 6.0
    assert CHANNELS > 5, "the toys have as many channels as the workspace"
