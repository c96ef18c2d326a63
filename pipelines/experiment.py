"""The whole chain in one process: python -m pipelines.experiment [overrides], e.g. experiment=tiny train.seed=1.

Composes conf/ with Hydra overrides, writes params.yaml into the folder that the key `workspace` names, and calls there
the same stage functions as dvc.yaml does, in the same order.
"""

import importlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from talkingeyes.config import compose, write_params
from talkingeyes.run import Workspace, perform, shell

REFERENCES = ("truth", "fitted", "mismatched")


def calls(params: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """The stages in order, each with the item that it is called for."""
    models = list(params["model"])
    yield from (("synthesize",), ("fit",), ("embed",))
    yield from (("pretrain", prior) for prior in params["pretrain"])
    yield from (("train", model) for model in models)
    yield ("critic",)
    yield from (("sample", model) for model in models)
    yield from (("evaluate", row) for row in (*REFERENCES, *models))
    yield ("report",)


def run_chain(workspace: Workspace) -> None:
    """Run every stage. A corpus from elsewhere takes the place of `synthesize`."""
    own = workspace.corpus == workspace.data("synthesize")
    for stage, *names in calls(workspace.params):
        if stage == "synthesize" and not own:
            continue
        print("==", stage, *names, file=sys.stderr)
        perform(stage, importlib.import_module(f"pipelines.{stage}").run, workspace, *names)


def main() -> None:
    """Compose, then run."""
    params = compose(sys.argv[1:])
    root = Path(params["workspace"])
    write_params(root / "params.yaml", params)
    run_chain(Workspace.open(root))


if __name__ == "__main__":
    shell(main)
