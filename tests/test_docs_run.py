"""Runs the commands of the docs: page by page, in order, in a copy of the project with a tiny chain.

Run     pytest -n 0 -m slow tests/test_docs_run.py [-k tutorial]     (all pages: see docs/tutorial.md for the time)

docs_program.py lists the reduced settings; docs_project.py makes files that are named in the docs but do not exist.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from docs_pages import PAGES, REPOSITORY, lines, name_of, unread_commands
from docs_project import RESTORE, copy_project, run_bash

# Commands that cannot run on test machines: they need other programs, other machines, a GPU or recordings of people.
ELSEWHERE = {
    "ray start --head --port=6379 --include-dashboard=false": "a cluster (Ray on one machine: test_launchers.py)",
    "ray start --address=HEAD:6379": "a cluster",
    "python -m pipelines.experiment machine.backend=ray machine.ray_address=auto machine.jobs=256 target=embed "
    "workspace=/shared/te corpus=/shared/corpus": "a cluster",
    "python -m pipelines.experiment -m sweep=loss_weights hydra/launcher=ray_cluster hydra.sweeper.n_jobs=64 "
    "workspace=/shared/te corpus=/shared/corpus": "a cluster",
    "python -m pipelines.experiment machine.backend=ray machine.ray_address=auto machine.jobs=256 target=embed "
    "workspace=/shared/te corpus=data/track fit=video": "a cluster",
    "python -m pipelines.experiment machine=gpu": "a card (without one: test_ddp.py)",
    "blender --background --python docs/recipes/blender_import.py -- head.glb head.blend --sound SPEECH.wav": "Blender",
    "npm install three && cp docs/recipes/three_player.html head.glb SPEECH.wav . && python3 -m http.server "
    "-b 127.0.0.1": "npm",
    "npm install three @pixiv/three-vrm @pixiv/three-vrm-animation && cp docs/recipes/vrm_player.html AVATAR.vrm "
    "motion.vrma SPEECH.wav . && python3 -m http.server -b 127.0.0.1": "npm",
    "npm install three @pixiv/three-vrm @met4citizen/talkinghead": "npm",
    "cp docs/recipes/{vrm_live,talkinghead_live}.html docs/recipes/{live_avatar,stream_client}.js AVATAR.vrm "
    "AVATAR.glb . && python3 -m http.server -b 127.0.0.1": "avatars, not part of the project (test_live_pages.py)",
    "talkingeyes track me.mp4 -o data/me": "a video of one person",
    "python -m pipelines.results.own_person data/me": "a video of one person (a synthetic person: test_own_person.py)",
    "talkingeyes animate speech.wav --model build/own_person/data/train/own_person -o build/me": "the same",
    "python docs/recipes/vtube_studio_stream.py take/sample_00.npz": "VTube Studio",
    "python local_viewer.py --point_path AVATAR/point_cloud.ply --motion_path motion.npz": "GaussianAvatars",
}
# Commands that need files that the reader writes, or take hours.
OF_ITS_OWN = {"docs/extend.md": "test_extend.py", "docs/reliability.md": "tests/reliability, a short run"}
RUN = [page for page in PAGES if lines(page) and name_of(page) not in OF_ITS_OWN]


@pytest.fixture(scope="module")
def project(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One copy for all pages, so that pages can use the output of earlier ones."""
    return copy_project(tmp_path_factory.mktemp("docs"), tiny)


@pytest.mark.slow
@pytest.mark.timeout(3600)  # docs/data.md runs the whole chain through DVC
@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_the_commands_of_a_page_run(page: Path, project: Path) -> None:
    said = run_bash(RESTORE + "\n".join(line for line in lines(page) if line not in ELSEWHERE), project)
    assert said.returncode == 0, said.stdout[-3000:] + said.stderr[-5000:]


@pytest.mark.slow
def test_tutorial_writes_the_stated_files(project: Path) -> None:
    page = REPOSITORY / "docs/tutorial.md"
    if not (project / "build/first").exists():
        test_the_commands_of_a_page_run(page, project)
    for made in ("first/sample_01.mp4", "first.glb", "first.csv", "figures/benchmark.json"):
        assert (project / "build" / made).stat().st_size > 0, made


def test_commands_that_are_not_run_are_in_the_docs_and_listed() -> None:
    found = {line for page in RUN for line in lines(page)}
    assert ELSEWHERE.keys() <= found
    assert set(OF_ITS_OWN) <= {name_of(page) for page in PAGES}
    assert sum(len(lines(page)) for page in RUN) >= 50


def test_no_block_hides_commands_from_these_tests() -> None:
    pages = [*PAGES, REPOSITORY / "CONTRIBUTING.md"]
    assert {name_of(page): hidden for page in pages if (hidden := unread_commands(page.read_text()))} == {}
