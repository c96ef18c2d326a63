"""A copy of the project for the commands of the docs: tracked files, a finished tiny chain, files named in the docs.

Its .venv has the programs of this environment, each run through docs_program.py. Files that are named in the docs but
do not exist (SPEECH.wav, VIDEOS, a FLAME file) are made by PLACEHOLDER_COMMANDS, with commands of the project where
possible.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from docs_pages import REPOSITORY

WRAPPED_PROGRAMS = ("python", "talkingeyes", "mlflow")
PROGRAM = '#!/bin/sh\nexec {python} -SE {root}/tests/helpers/docs_program.py {bin} {name} "$@"\n'
# Placeholders that cannot be file names, and their replacements.
SUBSTITUTIONS = [
    (r"(?<=\s|=)/shared/", "shared/"),
    (
        r"data/sample/talkingeyes_events/0/CLIP\.npz",
        "$(find data/sample/talkingeyes_events -name '*.npz' | sort | head -n 1)",
    ),
]
DATA = """
make params
git init --quiet && git config user.name docs && git config user.email docs@localhost
rm dvc.lock
dvc commit --quiet --force synthesize fit embed pretrain train critic validate sample evaluate report
git add --all && git commit --quiet -m docs
"""
PLACEHOLDER_COMMANDS = """
SOUND=$(find data/synthesize/speech -name '*.flac' | sort | head -n 1)
python tests/helpers/placeholder_files.py "$SOUND"
cp SPEECH.wav speech.wav; cp SPEECH.wav other.wav
mkdir lines && cp SPEECH.wav lines/one.wav && cp SPEECH.wav lines/two.wav
talkingeyes animate SPEECH.wav -o take --samples 2 --no-previews --model data/train/talkingeyes_events
cp take/sample_00.npz MOTION.npz; cp take/sample_01.npz OTHER.npz; cp take/sample_01.npz other.npz
cp take/sample_01.npz clip.npz
talkingeyes export OTHER.npz -f vhap --model FLAME_FILE -o TRACKED.npz
talkingeyes export OTHER.npz -f livelink -o OTHER.csv
NAME=$(basename "$SOUND" .flac); ln -s data/synthesize CORPUS
mkdir YOUR_FILES SOUNDS && cp OTHER.csv "YOUR_FILES/$NAME-t0.csv" && cp SPEECH.wav "SOUNDS/$NAME-t0.wav"
mkdir DIALOGUES && cp both.wav "DIALOGUES/$NAME-t0.wav"
printf 'pair,person,coder,start_ms,end_ms\np,a,1,0,2000\np,b,1,0,9000\n' > CONTACT
printf 'pair,start_s,end_s,speaker\np,0,4,a\np,4,9,b\n' > TURNS
mkdir -p build/experiment shared
cp mlflow.db build/experiment/ && cp -r VIDEOS shared/videos && cp VIDEOS/person_0/talk.mp4 VIDEO
mkdir ONE_CLIP && cp "$(find data/sample/talkingeyes_events -name '*.npz' | sort | head -n 1)" ONE_CLIP
"""
# Before each page: the default chain, if an earlier page ran another one in its place.
RESTORE = """
git diff --quiet -- params.yaml dvc.lock || {
    git checkout --quiet -- params.yaml dvc.lock data/report
    dvc checkout --quiet --force --allow-missing
}
"""
# The failing command is named; background services end with the page.
TRAPS = """
set -euo pipefail
trap 'echo "failed: $BASH_COMMAND" >&2' ERR
trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
"""


def copy_project(root: Path, tiny: Path) -> Path:
    """Copy the project to `root` and prepare it for the commands of any page."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, check=True, capture_output=True).stdout
    for name in listed.decode().split("\0"):
        if name and (REPOSITORY / name).is_file():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(REPOSITORY / name, root / name)
    _programs(root / ".venv" / "bin", root)
    (root / ".venv" / ".stamp").touch()  # marks the environment as set up
    for folder in tiny.joinpath("data").iterdir():
        shutil.copytree(folder, root / "data" / folder.name, dirs_exist_ok=True)
    shutil.copy(tiny / "mlflow.db", root)
    for workspace in ("tiny", "experiment", "smoke_test", "posegan", "sweep"):  # all workspaces share one store
        (root / "build" / workspace).mkdir(parents=True)
        (root / "build" / workspace / "store").symlink_to(tiny / "store")
    said = run_bash(DATA + PLACEHOLDER_COMMANDS, root)
    assert said.returncode == 0, said.stdout[-2000:] + said.stderr[-4000:]
    return root


def _programs(folder: Path, root: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "activate").write_text("")
    for program in Path(sys.executable).parent.iterdir():
        if program.name not in (*WRAPPED_PROGRAMS, "activate"):
            (folder / program.name).symlink_to(program)
    for name in WRAPPED_PROGRAMS:
        words = {"python": sys.executable, "root": root, "bin": Path(sys.executable).parent}
        text = PROGRAM.format(name=name, **{key: shlex.quote(str(value)) for key, value in words.items()})
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)


def run_bash(text: str, root: Path) -> subprocess.CompletedProcess[str]:
    """Run lines with bash in the copy; stops at the first that fails and names it."""
    for pattern, instead in SUBSTITUTIONS:
        text = re.sub(pattern, instead, text)
    environment = {**os.environ, "PATH": f"{root}/.venv/bin:{os.environ['PATH']}", "PYTHONPATH": f"{root}/src:{root}"}
    return subprocess.run(
        ["bash", "-c", TRAPS + text],
        cwd=root,
        env=environment,
        check=False,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )
