"""The short run of `make reliability`: some damaged files of the kinds that are read quickly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import fuzz
from fuzz_targets import FORM_OF_SUFFIX, Target, targets, write_faces, write_good_files
from mutations import FORMS, mutate

QUICK = (
    "import lips.vrma",
    "import tracked.npz",
    "import torch.pt",
    "import frames.jsonl",
    "import pyfeat.csv",
    "map map.yaml",
)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_faces(tmp_path_factory.mktemp("good"))


@pytest.mark.parametrize("target", [each for each in targets() if each.name in QUICK], ids=lambda each: each.name)
def test_damaged_files_are_one_line_errors(good: Path, target: Target) -> None:
    assert fuzz(target, good, count=8, seed=3, keep=None) == {}


def test_a_reader_that_fails_is_noticed(good: Path) -> None:
    """A file that is not there is refused; one that is good should not be."""
    assert fuzz(Target("none", "text", "map.yaml", "import none.npz -o out.npz"), good, 1, 0, None).keys() == {-1}


def test_a_mutation_is_that_of_its_number() -> None:
    content = b'{"a": [1, 2, {"b": "c"}]}'
    made = [mutate(content, "json", np.random.default_rng([1, number])) for number in range(50)]
    assert made == [mutate(content, "json", np.random.default_rng([1, number])) for number in range(50)]
    assert len(set(made)) > 30


@pytest.mark.long
def test_every_kind_of_file_can_be_damaged(tmp_path: Path) -> None:
    write_good_files(tmp_path)
    for target in targets():
        content = (tmp_path / target.file).read_bytes()
        made = {mutate(content, target.form, np.random.default_rng([2, number])) for number in range(20)}
        assert len(made - {content}) > 10, target
    assert {each.form for each in targets()} == set(FORMS) & ({"binary"} | set(FORM_OF_SUFFIX.values()))
