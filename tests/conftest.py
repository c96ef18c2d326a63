"""Common setup of all tests: one thread, no telemetry, no display, reproducible hypothesis examples."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from checked_calls import check_again
from filelock import FileLock
from hypothesis import settings

from talkingeyes.orchestration.run import configure_environment

configure_environment()
os.environ["MPLBACKEND"] = "Agg"
os.environ["HF_HUB_OFFLINE"] = "1"
# Lets processes started in other folders import this checkout: the package, the stages (not installed), these tests.
ROOT = Path(__file__).resolve().parents[1]
os.environ["PYTHONPATH"] = os.pathsep.join(str(ROOT / folder) for folder in ("src", ".", "tests", "tests/helpers"))

settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Check types in the first calls of this test, whatever others have called."""
    check_again()


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder shared by all processes of this test run."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def tiny(repository: Path, shared_folder: Path) -> Path:
    """A workspace with the output of the whole chain on the tiny corpus, run once for all processes of a test run."""
    root = shared_folder / "tiny"
    with FileLock(root.with_suffix(".lock")):
        if not (root / "data" / "report" / "table3.md").exists():
            command = [sys.executable, "-m", "pipelines.experiment", "experiment=tiny", f"workspace={root}"]
            ended = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False, timeout=550)
            assert ended.returncode == 0, ended.stderr[-4000:]
    return root


@pytest.fixture(scope="module")
def models_loaded_once() -> Iterator[None]:
    """Load each model, with the packaged face that a toy model gets, once for all tests of a file."""
    from talkingeyes.animation.animator import Animator  # not before jaxtyping checks what is imported

    load, loaded = Animator.load, dict[Path, Animator]()

    def load_once(model: Path) -> Animator:
        place = model.resolve()
        if place not in loaded:
            loaded[place] = load(model)
        return loaded[place]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Animator, "load", load_once)
        yield
