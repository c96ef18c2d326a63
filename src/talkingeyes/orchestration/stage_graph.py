"""The graph of stages: what every stage reads, imports and writes, as declared in dvc.yaml alone.

`dvc repro` uses dvc.yaml itself; the result store (result_store.py) reads it through this module, so both use the same
graph.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from talkingeyes.core.errors import InputError

REPOSITORY_ROOT = Path(__file__).resolve().parents[3]
# The corpus made by this project.
DEFAULT_CORPUS = "data/synthesize"


@dataclass(frozen=True)
class StageCall:
    """One call of a stage, for one item if the stage runs over several."""

    stage: str
    item: str | None
    inputs: tuple[str, ...]  # paths under data/, or of an external corpus
    code_deps: tuple[str, ...]  # imported packages and files
    sections: tuple[str, ...]  # dotted keys of the composition

    @property
    def address(self) -> str:
        """Its name in DVC."""
        return self.stage if self.item is None else f"{self.stage}@{self.item}"

    @property
    def folder(self) -> Path:
        """Output folder, relative to a workspace."""
        return Path("data", self.stage, self.item or "")

    @property
    def names(self) -> tuple[str, ...]:
        """Arguments of the stage's function."""
        return () if self.item is None else (self.item,)

    def reads(self, other: StageCall) -> bool:
        """Whether it reads the output of another call, or a part of it."""
        return any(path.is_relative_to(other.folder) or other.folder.is_relative_to(path) for path in self._paths())

    def _paths(self) -> list[Path]:
        return [Path(each) for each in self.inputs]


def stage_calls(
    params: Mapping[str, Any], order: Iterable[Sequence[str]], path: Path = REPOSITORY_ROOT / "dvc.yaml"
) -> list[StageCall]:
    """The calls (stage, or stage and item) of a pipeline in the given order, with their declarations in dvc.yaml."""
    stages = yaml.safe_load(path.read_text())["stages"]
    return [_call(stages[stage], stage, rest[0] if rest else None, params) for stage, *rest in order]


def required_calls(calls: Sequence[StageCall], target: str) -> list[StageCall]:
    """The calls that `target` depends on, and `target` last.

    `target` is an address such as train@talkingeyes_events, or a stage with all items.

    Raises InputError for an unknown target.
    """
    wanted = [call for call in calls if target in (call.address, call.stage)]
    if not wanted:
        addresses = ", ".join(call.address for call in calls)
        raise InputError(f"target: should be a stage or one of {addresses}; got {target!r}")
    found: dict[str, StageCall] = {}
    while wanted:
        call = wanted.pop()
        if call.address not in found:
            found[call.address] = call
            wanted += [other for other in calls if other is not call and call.reads(other)]
    return [call for call in calls if call.address in found]


def get_section(params: Mapping[str, Any], key: str) -> Any:
    """The node at a dotted key. Raises InputError if it is missing."""
    node: Any = params
    for part in key.split("."):
        if not isinstance(node, Mapping) or part not in node:
            raise InputError(f"params: should contain {key}, got none; `make params` writes it from conf/")
        node = node[part]
    return node


def _call(definition: Mapping[str, Any], stage: str, item: str | None, params: Mapping[str, Any]) -> StageCall:
    own = definition.get("do", definition)
    scope = _scope(definition, item)
    deps = [each for each in (_filled(text, scope, params) for text in own.get("deps", [])) if each]
    code_deps = tuple(each for each in deps if each.startswith(("src/", "pipelines/")))
    inputs = tuple(each for each in deps if each not in code_deps)
    if stage == "train" and item is not None:  # a model may combine trained models, or be initialised from one
        model = get_section(params, f"model.{item}")
        others = [*model.get("source_models", ()), *filter(None, [model.get("init_from")])]
        inputs += tuple(f"data/train/{each}" for each in others)
    sections = tuple(filter(None, (_filled(each, scope, params) for each in own.get("params", []))))
    return StageCall(stage, item, inputs, code_deps, sections)


def _scope(definition: Mapping[str, Any], item: str | None) -> dict[str, str]:
    """Values of ${item}, ${item.x} and ${key}."""
    if item is None:
        return {}
    if "matrix" in definition:
        return {f"item.{next(iter(definition['matrix']))}": item}
    rows = dict(definition["foreach"])
    if item in rows:
        return {"key": item, "item": rows[item]}
    # An item that only the composition contains (an experiment may add a model) has the dependencies of the last item,
    # with its own name substituted.
    last = list(rows)[-1]
    return {"key": item, "item": re.sub(rf"\b{re.escape(last)}\b", item, rows[last])}


def _filled(text: str, scope: Mapping[str, str], params: Mapping[str, Any]) -> str:
    """The text with every ${reference} replaced; empty if one of them is null (a model without a tokenizer reads
    none)."""
    for reference in re.findall(r"\$\{([\w.]+)\}", text):
        value = scope[reference] if reference in scope else get_section(params, reference)
        inner = "" if value is None else _filled(str(value), scope, params)
        if not inner:
            return ""
        text = text.replace(f"${{{reference}}}", inner)
    return text
