"""The result store: no repeated runs, no stale results, no partial or damaged entries."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import yaml
from model_conf import compose

from pipelines.experiment import stage_order
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration import result_store
from talkingeyes.orchestration.run import MethodResult, Report
from talkingeyes.orchestration.stage_graph import required_calls, stage_calls

CHAIN = {
    "stages": {
        "synthesize": {
            "cmd": f"{sys.executable} made.py",
            "deps": ["src/one.py"],
            "params": ["synthesize"],
            "outs": ["data/synthesize"],
        },
        "train": {
            "matrix": {"model": ["a", "b"]},
            "cmd": "true",
            "deps": ["${corpus}", "src/two"],
            "params": ["train", "model.${item.model}"],
            "outs": ["data/train/${item.model}"],
        },
        "report": {"cmd": "true", "deps": ["data/train"], "outs": ["data/report"]},
    }
}
ORDER = [("synthesize",), ("train", "a"), ("train", "b"), ("report",)]
PARAMS = {
    "corpus": "data/synthesize",
    "machine": {"jobs": 1},
    "synthesize": {"clips": 3, "tolerance": 1e-6},
    "train": {"seed": 0},
    "model": {"a": {"width": 1}, "b": {"width": 2}},
}


class Toy:
    """A small checkout with its own chain and a store; `made` lists the stages that ran."""

    def __init__(self, root: Path) -> None:
        self.root, self.store, self.made = root / "checkout", root / "store", []
        (self.root / "src/two").mkdir(parents=True)
        for name in ("src/one.py", "src/two/three.py"):
            (self.root / name).write_text("1")
        (self.root / "dvc.yaml").write_text(yaml.safe_dump(CHAIN))

    def run(self, params=PARAMS, target="report"):
        """Obtain all results that `target` needs; returns the entries by address."""
        result_store._code_md5.cache_clear()
        entries, found = {}, {}
        for call in required_calls(stage_calls(params, ORDER, self.root / "dvc.yaml"), target):
            entry = result_store.get_or_run(self.store, call, params, entries, self.make, self.root)
            entries[call.folder] = found[call.address] = entry
        return found

    def make(self, call, workspace):
        """A stage that records its inputs."""
        self.made.append(call.address)
        seen = sorted(path.as_posix() for path in workspace.root.glob("data/*/*") if path.exists())
        with workspace.output(*call.folder.parts[1:]) as folder:
            (folder / "x").write_text(f"{call.address} {workspace.params} {[Path(each).name for each in seen]}")
        file = workspace.data(*call.folder.parts[1:], "x")
        return Report({"one": 1.0}, [file], [MethodResult(call.stage, {"test/one": 2.0}, [file])])


@pytest.fixture
def toy(tmp_path):
    return Toy(tmp_path)


def merged(**sections):
    return {**PARAMS, **sections}


def test_nothing_runs_twice(toy):
    first = toy.run()
    assert toy.made == ["synthesize", "train@a", "train@b", "report"]
    again = toy.run()
    assert len(toy.made) == 4
    assert {entry.origin for entry in again.values()} == {"store"}
    assert [(e.key, e.report) for e in again.values()] == [(e.key, e.report) for e in first.values()]
    assert all(path.read_text() for path in again["train@a"].report.artifacts)


def test_a_change_runs_what_follows_and_nothing_else(toy):
    toy.run()
    for params, expected in [
        (merged(model={"a": {"width": 1}, "b": {"width": 9}}), ["train@b", "report"]),
        (merged(train={"seed": 1}), ["train@a", "train@b", "report"]),
        (merged(machine={"jobs": 7}), []),
        (merged(synthesize={"clips": 4}), ["synthesize", "train@a", "train@b", "report"]),
        (PARAMS, []),
    ]:
        toy.made.clear()
        toy.run(params)
        assert toy.made == expected


def test_changed_code_runs_again(toy):
    toy.run()
    toy.made.clear()
    (toy.root / "src/two/three.py").write_text("2")
    toy.run()
    assert toy.made == ["train@a", "train@b", "report"]


def test_until_runs_only_what_it_needs(toy):
    toy.run(target="train@b")
    assert toy.made == ["synthesize", "train@b"]
    with pytest.raises(InputError, match=r"^target: should be a stage or one of synthesize, .*; got 'trian'$"):
        toy.run(target="trian")


def test_a_stage_sees_only_what_it_declares(toy):
    made = toy.run()
    asked = f"'machine': {{'jobs': 1}}, 'synthesize': {PARAMS['synthesize']}}}"
    assert asked in (made["synthesize"].output / "x").read_text()
    of_a = (made["train@a"].output / "x").read_text()
    assert "'width': 1" in of_a
    assert "'width': 2" not in of_a
    assert "clips" not in of_a
    assert "['a', 'b']" in (made["report"].output / "x").read_text()


@pytest.mark.parametrize("damage", ["changed", "missing", "no sums", "no record"])
def test_a_damaged_entry_is_named_and_made_again(toy, capsys, damage):
    entry = toy.run()["train@a"]
    content = (entry.output / "x").read_bytes()
    places = {"no sums": entry.output / "SHA256SUMS", "no record": entry.folder / "provenance.json"}
    file = places.get(damage, entry.output / "x")
    if damage == "changed":
        file.write_bytes(content[:-1] + b"?")  # with the same size
    else:
        file.unlink()
    toy.made.clear()
    toy.run()
    assert toy.made == ["train@a"]
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"store: {entry.folder.name} is damaged (")
    assert said.endswith("); it is recreated")
    assert "\n" not in said
    assert (entry.output / "x").read_bytes() == content


@pytest.mark.parametrize("seconds", [1, 2**32])
def test_a_copied_entry_is_not_damaged(toy, seconds):
    """Nor one of a clock that went wrong."""
    entry = toy.run()["train@a"]
    os.utime(entry.output / "x", (seconds, seconds))
    toy.made.clear()
    toy.run()
    assert toy.made == []


def test_a_stage_that_fails_leaves_nothing(toy):
    def fail(call, workspace):
        with workspace.output(call.stage) as folder:
            (folder / "x").write_text("half")
            raise InputError("no")

    call = stage_calls(PARAMS, ORDER, toy.root / "dvc.yaml")[0]
    with pytest.raises(InputError, match="no"):
        result_store.get_or_run(toy.store, call, PARAMS, {}, fail, toy.root)
    assert [path.name for path in toy.store.iterdir() if path.suffix != ".lock"] == []


def test_concurrent_requests_run_a_stage_once(toy):
    def slowly(call, workspace):
        time.sleep(0.2)
        return toy.make(call, workspace)

    call, found = stage_calls(PARAMS, ORDER, toy.root / "dvc.yaml")[0], []

    def want():
        found.append(result_store.get_or_run(toy.store, call, PARAMS, {}, slowly, toy.root).origin)

    both = [threading.Thread(target=want) for _ in range(2)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert sorted(found) == ["made", "store"]
    assert toy.made == ["synthesize"]


MADE = """
from pathlib import Path
import hashlib
Path("data/synthesize").mkdir(parents=True, exist_ok=True)
Path("data/synthesize/sub").mkdir(exist_ok=True)
Path("data/synthesize/sub.x").write_text("one")
Path("data/synthesize/sub/x").write_text("two")
lines = [f"{hashlib.sha256(Path('data/synthesize', n).read_bytes()).hexdigest()}  {n}\\n" for n in ("sub.x", "sub/x")]
Path("data/synthesize/SHA256SUMS").write_text("".join(lines))
"""


@pytest.mark.parametrize("link", ["copy", "symlink", "hardlink"])
def test_matching_dvc_output_is_reused(toy, link):
    (toy.root / "made.py").write_text(MADE)
    (toy.root / "params.yaml").write_text(yaml.safe_dump(PARAMS))
    link_type = ["config", "cache.type", link]
    for command in (["init", "--no-scm", "--quiet"], link_type, ["repro", "--quiet", "synthesize"]):
        subprocess.run([sys.executable, "-m", "dvc", *command], cwd=toy.root, check=True, capture_output=True)
    entry = toy.run(target="train@a")["synthesize"]
    assert (entry.origin, toy.made) == ("dvc", ["train@a"])
    assert (entry.output / "sub/x").read_text() == "two"
    assert toy.run(merged(synthesize={"clips": 4}), "synthesize")["synthesize"].origin == "made"
    # The content does not match dvc.lock.
    (toy.root / "data/synthesize/sub.x").unlink()
    (toy.root / "data/synthesize/sub.x").write_text("other")
    assert toy.run(target="synthesize")["synthesize"].origin == "store"
    (toy.root / "src/one.py").write_text("2")
    assert toy.run(target="synthesize")["synthesize"].origin == "made"


def test_stages_needed_by_a_trial():
    params = compose(["target=validate@talkingeyes_paper"])
    found = [call.address for call in required_calls(stage_calls(params, stage_order(params)), params["target"])]
    assert found == [
        "synthesize",
        "fit",
        "embed",
        "pretrain@gaze_frames",
        "train@talkingeyes_paper",
        "critic",
        "validate@talkingeyes_paper",
    ]


def test_model_reads_its_tokenizer():
    params = compose(["model.talkingeyes_paper.tokenizer=gaze_patches"])
    found = [
        call.address for call in required_calls(stage_calls(params, stage_order(params)), "train@talkingeyes_paper")
    ]
    assert "pretrain@gaze_patches" in found
    assert "pretrain@gaze_frames" not in found


def test_a_model_that_only_an_experiment_names_reads_what_others_do():
    params = compose()
    params["model"]["mine"] = {**params["model"]["talkingeyes"], "tokenizer": "gaze_frames"}
    found = [call.address for call in required_calls(stage_calls(params, stage_order(params)), "evaluate@mine")]
    assert {"pretrain@gaze_frames", "train@mine", "sample@mine"} <= set(found)
    assert not {"train@talkingeyes_events", "sample@talkingeyes_events"} & set(found)
