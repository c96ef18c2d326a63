"""A small synthetic corpus for tests."""

from pathlib import Path

from model_conf import compose

from pipelines import synthesize
from talkingeyes.orchestration.run import Workspace


def make_tiny_corpus(folder: Path, *overrides: str, jobs: int = 1) -> Path:
    """Synthesise the `tiny` corpus, with Hydra overrides such as `synthesize.clips=12`, in the workspace `folder`."""
    params = compose(["synthesize=tiny", f"machine.jobs={jobs}", *overrides])
    synthesize.run(Workspace(folder, params))
    return folder / "data" / "synthesize"
