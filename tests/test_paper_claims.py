"""Verdicts on the paper's claims by made-up statistics, and pages of seeds that were computed at different times."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipelines.results import table_runs, tables
from pipelines.results.tables_page import as_json
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.bootstrap import TableEstimate
from talkingeyes.evaluation.papers import talkingeyes_claims as claims
from talkingeyes.evaluation.papers.talkingeyes_claims import CLAIMS, Claim, Verdict, judge
from talkingeyes.evaluation.papers.talkingeyes_results import (
    SeedResult,
    SplitResult,
    from_json,
    interval_with_seeds,
    to_json,
)
from talkingeyes.evaluation.papers.talkingeyes_tables import FAMILIES, REGRESSED, SEQUENCE, TABLES
from talkingeyes.orchestration.run import run_command

STILL = "gaze/still_fraction"
SOUND_METRICS = [
    f"{part}/{name}"
    for part in ("head", "gaze", "gaze_in_space")
    for name in ("diversity", "diversity_truth", "corr", "l2", "speed", "speed_truth", "still_fraction")
]


def claim(text: str) -> Claim:
    return next(each for each in CLAIMS if each.text.startswith(text))


MORE_DIVERSE = claim("The eyes of a VQ-VAE have more Diversity")
HIGHEST = claim("TalkingEyes has the highest Diversity")
NO_EFFECT = replace(claim("The number of codes does not affect the head"), not_judged="")
STANDS_STILL = claim("Without L_reg, the eyes stand still")
LIKE_MEAN = replace(claim("A VAE performs like Mean"), not_judged="")
HEAD_CORR = claim("The head of a VQ-VAE has a lower Corr.")


def around(value: float, width: float = 0.02) -> TableEstimate:
    """An estimate whose interval over speakers is `value` +- `width`, and that over sounds half as wide."""
    return TableEstimate(value, value - width / 2, value + width / 2, value - width, value + width)


def split(name: str, difference: float, width: float = 0.02, still: float = 0.1, value: float = 1.0) -> SplitResult:
    """A table in which all differences and all cells are the same; `still`: fraction of still frames of all rows."""
    table = TABLES[name]
    cells = {column.metric: around(value) for column in table.columns} | {STILL: around(still)}
    rows = dict.fromkeys(("truth", *table.rows), cells)
    return SplitResult(rows, {each.key: around(difference, width) for each in tables.comparisons(name)})


def with_still(one: SplitResult, row: str, fraction: float) -> SplitResult:
    return replace(one, rows={**one.rows, row: {**one.rows[row], STILL: around(fraction)}})


@pytest.mark.parametrize("family", FAMILIES)
def test_verdict_is_that_of_the_interval_over_speakers_and_seeds(family: str) -> None:
    for seeds, expected in (
        ([0.1], claims.REPRODUCED),
        ([0.1, 0.11, 0.09], claims.REPRODUCED),
        ([0.1, 0.2, 0.3], claims.UNDECIDED),  # each is above 0, but the seeds differ
        ([-0.1, -0.11, -0.09], claims.NOT_REPRODUCED),
        ([0.01] * 3, claims.UNDECIDED),
    ):
        assert judge(MORE_DIVERSE, family, [split("table5", value) for value in seeds]).verdict == expected


def test_a_firm_verdict_holds_at_a_higher_level() -> None:
    one = [split("table5", 0.025)]  # 2.5 half-widths of a normal interval: p = 1e-6; 1.25: 0.014
    assert judge(MORE_DIVERSE, REGRESSED, one).verdict == claims.REPRODUCED
    assert judge(MORE_DIVERSE, REGRESSED, one, level=1 - 0.05 / 46).verdict == claims.UNDECIDED
    assert judge(MORE_DIVERSE, REGRESSED, [split("table5", 0.05)], level=1 - 0.05 / 46).verdict == claims.REPRODUCED


def test_an_interval_over_seeds_is_that_of_students_t() -> None:
    exact = [around(value, width=0.0) for value in (0.1, 0.2, 0.3)]
    low, high = interval_with_seeds(exact)
    assert (low, high) == pytest.approx((0.2 - 4.303 * 0.1 / 3**0.5, 0.2 + 4.303 * 0.1 / 3**0.5), abs=1e-4)
    assert interval_with_seeds([around(0.1, width=0.02)]) == pytest.approx((0.08, 0.12))


@pytest.mark.parametrize("text", ["The number of codes does not affect the head", "A VAE performs like Mean"])
def test_what_our_rows_cannot_say_is_not_judged(text: str) -> None:
    of_paper = claim(text)
    for family in FAMILIES:
        assert judge(of_paper, family, [split(of_paper.table, 0.0)]) == Verdict("", of_paper.not_judged)


def test_the_interval_is_that_over_speakers() -> None:
    """An interval over sounds that excludes zero does not suffice."""
    one = split("table5", 0.015)
    found = next(iter(one.differences.values()))
    assert found.low > 0 > found.speakers_low
    assert judge(MORE_DIVERSE, REGRESSED, [one]).verdict == claims.UNDECIDED


def test_reason_has_the_difference_and_its_interval() -> None:
    reason = judge(MORE_DIVERSE, REGRESSED, [split("table5", 0.2), split("table5", 0.2)]).reason
    assert reason == "+0.200 (+0.180 to +0.220), `talkingeyes_paper` − `vae`"


def test_no_difference_is_an_interval_within_the_tolerance() -> None:
    for difference, width, expected in (
        (0.05, 0.02, claims.REPRODUCED),  # within 0.1 of a value of 1, though not zero
        (0.0, 0.2, claims.UNDECIDED),
        (0.15, 0.02, claims.NOT_REPRODUCED),
        (-0.15, 0.02, claims.NOT_REPRODUCED),
        (0.09, 0.02, claims.UNDECIDED),
    ):
        assert judge(NO_EFFECT, SEQUENCE, [split("table7", difference, width)]).verdict == expected
    assert judge(NO_EFFECT, REGRESSED, [split("table7", 0.05, value=0.2)]).verdict == claims.NOT_REPRODUCED


def test_frozen_eyes_decide_nothing_in_the_columns_of_the_eyes() -> None:
    frozen = with_still(split("table5", 0.1), "talkingeyes_paper", 0.9)
    assert judge(MORE_DIVERSE, REGRESSED, [frozen]) == Verdict(claims.UNDECIDED, "the eyes stand still")
    assert judge(MORE_DIVERSE, SEQUENCE, [frozen]).verdict == claims.REPRODUCED, "another row"
    assert judge(HEAD_CORR, REGRESSED, [frozen]).verdict == claims.REPRODUCED, "a column of the head"


def test_rows_that_stand_still_in_the_paper_may_stand_still() -> None:
    still_mean = with_still(split("table3", 0.1), "mean", 1.0)
    assert judge(HIGHEST, REGRESSED, [still_mean]).verdict == claims.REPRODUCED
    assert judge(LIKE_MEAN, REGRESSED, [still_mean]).verdict == claims.UNDECIDED  # 0.1 +- 0.02 of 1.0
    still_without = with_still(split("table6", 0.1), "without_regularity", 1.0)
    assert judge(STANDS_STILL, REGRESSED, [still_without]).verdict == claims.REPRODUCED
    both = with_still(still_without, "talkingeyes_paper", 0.9)
    assert judge(STANDS_STILL, REGRESSED, [both]).reason == "the eyes stand still"


def test_a_claim_of_several_comparisons_needs_all() -> None:
    one = split("table3", 0.1)
    (first, *_) = HIGHEST.comparisons
    for value, expected in ((0.0, claims.UNDECIDED), (-0.1, claims.NOT_REPRODUCED)):
        changed = replace(one, differences={**one.differences, first.key: around(value)})
        assert judge(HIGHEST, REGRESSED, [changed]).verdict == expected


def test_rows_that_a_family_lacks_or_shares() -> None:
    assert judge(STANDS_STILL, SEQUENCE, [split("table6", 0.1)]) == Verdict("", claims.NO_ROW)
    assert judge(LIKE_MEAN, SEQUENCE, [split("table3", 0.1)]) == Verdict("", claims.SAME_ROWS)
    unmeasured = SplitResult(split("table5", 0.1).rows, {})
    assert judge(MORE_DIVERSE, REGRESSED, [unmeasured]) == Verdict(claims.UNDECIDED, claims.NOT_MEASURED)


def test_the_papers_own_numbers_reproduce_its_claims() -> None:
    """The direction of each comparison of a column with numbers is that of the paper."""
    checked = 0
    for each in CLAIMS:
        table = TABLES[each.table]
        metrics = [column.metric for column in table.paper_columns]
        for comparison in each.comparisons:
            numbers = [table.rows.get(row) for row in (comparison.higher, comparison.lower)]
            if comparison.metric not in metrics or None in numbers:
                assert comparison.metric in {column.metric for column in table.columns}
                continue
            higher, lower = (values[metrics.index(comparison.metric)] for values in numbers if values is not None)
            assert abs(higher - lower) < claims.TOLERANCE * lower if each.equal else higher > lower
            checked += 1
    assert checked > 25


def result(name: str, seed: int, configuration: str = "aa") -> SeedResult:
    of_split = split(name, 0.1 + seed, value=1.0 + seed)
    return SeedResult(name, seed, configuration, "rev", {"vae": "800 × 12"}, {"test": of_split, "unseen": of_split})


def write(folder: Path, *results: SeedResult) -> None:
    folder.mkdir(exist_ok=True)
    for each in results:
        (folder / f"{each.table}-{each.seed}.json").write_text(json.dumps(to_json(each)))


def test_a_seed_is_added_to_those_that_are_there(tmp_path: Path) -> None:
    write(tmp_path, result("table5", 1), result("table3", 0))
    before = tables.read_results(tmp_path)
    assert [(name, [each.seed for each in seeds]) for name, seeds in before.items()] == [
        ("table3", [0]),
        ("table5", [1]),
    ]
    write(tmp_path, result("table5", 0))
    results = tables.read_results(tmp_path)
    assert results["table5"] == [result("table5", 0), result("table5", 1)]
    found = as_json(results)["tables"]["table5"]["rows"]["vae"]["unseen"]["gaze/corr"]
    assert (found["value"], found["seed_min"], found["seed_max"]) == (1.5, 1.0, 2.0)
    assert [each["interval_over"] for each in found["intervals"]] == ["sounds", "speakers"]
    assert found["intervals"][1]["low"] == pytest.approx(1.48)
    text = tables.document(results)
    assert "Means over the seeds 0, 1." in text
    assert "| VAE (head: VAE, eyes: VAE) | 1.500 (0.096) |" in text
    assert "**undecided**: +0.600 (-5.753 to +6.953), `talkingeyes_paper` − `vae` |" in text
    assert "| Table V, codes in sequence | +1.00 |" in text


def test_results_survive_their_file() -> None:
    one = result("table7", 2)
    assert from_json(json.loads(json.dumps(to_json(one)))) == one


def test_seeds_of_another_configuration_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, result("table5", 0), result("table5", 1, configuration="bb"))
    with pytest.raises(InputError, match=r"table5-1\.json: should have configuration aa, got bb"):
        tables.read_results(tmp_path)
    write(tmp_path, result("table5", 1), result("table6", 0, configuration="bb"))  # each table has its own
    assert list(tables.read_results(tmp_path)) == ["table5", "table6"]
    (tmp_path / "table5-1.json").write_text("{}")
    with pytest.raises(InputError, match=r"table5-1\.json: should be a result of pipelines.results.tables"):
        tables.read_results(tmp_path)
    # The command stops before it computes anything.
    write(tmp_path / "tables_seeds", result("table5", 0))
    monkeypatch.setattr("sys.argv", ["tables", "seeds=1", "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as stopped:
        run_command(tables.main)
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "remove the file, or give another --out" in line


@pytest.mark.long
def test_a_run_adds_its_seed_to_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`seeds=1` computes seed 1 alone, and writes the page of seeds 0 and 1."""
    computed = []

    def compute(name: str, seed: int, params: dict[str, object], configuration: str) -> SeedResult:
        computed.append((name, seed, params["train"]))
        return result(name, seed, configuration)

    monkeypatch.setattr(tables, "compute", compute)
    configurations = tables.configuration_hashes(tables.options([]).overrides)
    write(tmp_path / "tables_seeds", result("table6", 0, configurations["table6"]))
    monkeypatch.setattr("sys.argv", ["tables", "tables=table6", "seeds=1", "--out", str(tmp_path)])
    tables.main()
    assert computed == [("table6", 1, {"seed": 1})]
    assert sorted(path.name for path in (tmp_path / "tables_seeds").iterdir()) == ["table6-0.json", "table6-1.json"]
    assert "Means over the seeds 0, 1." in (tmp_path / "tables.md").read_text()
    assert json.loads((tmp_path / "tables.json").read_text())["tables"]["table6"]["seeds"] == [0, 1]


@pytest.mark.long
def test_a_table_of_a_seed_is_computed_from_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two speakers with two sounds each; Corr. of the eyes of `sequence` is 0.1 above that of all other rows."""
    (params,) = table_runs.configs_by_seed(["experiment=paper_tables"], [1])
    asked = []

    def compute_rows(
        made: list[dict[str, Any]], kind: table_runs.RowSpec, critic: bool, title: str
    ) -> table_runs.TableRows:
        asked.append((made, kind.models, title))
        by_name = {}
        for row in (*kind.references, *kind.models):
            path = tmp_path / f"{row}.json"
            corr = 0.5 if row == "sequence" else 0.4
            sounds = [
                {"speaker": name, "metrics": dict.fromkeys(SOUND_METRICS, 0.2) | {"gaze/corr": corr + shift}}
                for name, shift in (("a", 0.0), ("a", 0.1), ("b", 0.2), ("b", 0.3))
            ]
            long = [{"speaker": "a", "metrics": {"head/speed_above_5hz": 2.0}}]
            path.write_text(json.dumps({"sounds": {"unseen": sounds}, "long": {"unseen": long}}))
            by_name[row] = [table_runs.RowResult(row, path)]
        return table_runs.TableRows(by_name, {})

    monkeypatch.setattr(tables, "compute_rows", compute_rows)
    found = tables.compute("table6", 1, params, "aa")
    assert asked == [([params], tuple(TABLES["table6"].rows), "table6, seed 1")]
    assert (found.table, found.seed, list(found.splits)) == ("table6", 1, ["unseen"])
    assert found.budgets["sequence"] == found.budgets["without_velocity"] == "800 × 12 windows at 0.002"
    cells = found.splits["unseen"].rows["sequence"]
    assert cells["gaze/corr"].value == pytest.approx(0.65)
    assert cells["gaze/diversity_ratio"].value == pytest.approx(1.0)
    assert cells["head/speed_above_5hz"].value == 2.0
    velocity = judge(claim("Without L_vel, Corr. of the eyes"), SEQUENCE, [found.splits["unseen"]])
    assert velocity.verdict == claims.REPRODUCED
    assert velocity.reason == "+0.100 (+0.100 to +0.100), `sequence` − `sequence_without_velocity`"
    assert (
        judge(claim("Without L_vel, L2 of the head"), REGRESSED, [found.splits["unseen"]]).verdict == claims.UNDECIDED
    )


@pytest.mark.long
def test_configuration_depends_on_rows_but_not_on_seeds_and_folders() -> None:
    base = ["experiment=[paper_tables]"]
    same = tables.configuration_hashes(base)
    assert tables.configuration_hashes([*base, "workspace=elsewhere", "machine.jobs=1"]) == same
    for override, changed in (
        ("model.talkingeyes_events.weights.head_time=0.5", {"table3"}),
        ("model.sequence.weights.head_kl=0.5", {"table3", "table5", "table6"}),
        ("pretrain.gaze_frames.loop.steps=5", set(TABLES)),
        ("synthesize.clips=300", set(TABLES)),
    ):
        found = tables.configuration_hashes([*base, override])
        assert {name for name in TABLES if found[name] != same[name]} == changed, override
