"""Licences of all dependencies: the page docs/results/licences.md, from what the installed packages state.

Run     python -m pipelines.results.licences
Reads   requirements.lock and the metadata of the packages in this environment
Writes  docs/results/licences.md
"""

from __future__ import annotations

import re
from importlib.metadata import Distribution, distribution
from pathlib import Path

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.run import run_command

LOCK, PAGE = Path("requirements.lock"), Path("docs/results/licences.md")
LOCKED = re.compile(r"^([A-Za-z0-9_.-]+)==(\S+)", re.MULTILINE)
CLASSIFIER = "License :: "
MAX_LETTERS = 60  # longer, the field holds a text
SILENT = ("UNKNOWN", "Dual License", "OSI Approved")
# Read in the files or at the source of packages whose metadata state no licence.
READ = {
    "anny": "Apache-2.0; data CC0-1.0",
    "embreex": "BSD-2-Clause",
    "espeakng-loader": "MIT; the library in it GPL-3.0-or-later",
    "huey": "MIT",
    "hydra-joblib-launcher": "MIT",
    "ptyprocess": "ISC",
    "python-dateutil": "Apache-2.0 OR BSD-3-Clause",
    "skops": "MIT",
    "torch": "BSD-3-Clause",
}
INTRODUCTION = """# Licences of the dependencies

What `make setup` installs, with the licence that each package states in its metadata; of some, whose metadata state
none, as read in their files (`READ` in `pipelines/results/licences.py`, which writes this page). Files of others that
the package itself contains are in NOTICE. `make wheel` writes the same as an SBOM in CycloneDX.

"""


def run() -> None:
    """Write the page."""
    with atomic_write(PAGE) as path:
        path.write_text(page(LOCK.read_text()))


def page(lock: str) -> str:
    """The page of the packages of a lock, which should be installed; torch is beside the lock."""
    rows = [[name, version, licence(distribution(name))] for name, version in LOCKED.findall(lock)]
    torch = distribution("torch")
    rows.append(["torch", torch.version.partition("+")[0], licence(torch)])
    return (
        INTRODUCTION
        + markdown_table(["package", "version", "licence"], sorted(rows, key=lambda row: row[0].lower()))
        + "\n"
    )


def licence(package: Distribution) -> str:
    """The licence that a package states, else READ. Raises InputError for a package with neither."""
    stated, name = package.metadata.json, package.name
    if name in READ:
        return READ[name]
    classified = [each.rpartition(" :: ")[2] for each in stated.get("classifier", ()) if each.startswith(CLASSIFIER)]
    for each in (stated.get("license_expression"), ", ".join(classified), stated.get("license")):
        words = " ".join(str(each or "").split())
        if 0 < len(words) <= MAX_LETTERS and words not in SILENT:
            return words.replace("|", "/")
    raise InputError(f"{name}: states no licence; read its files and add it to READ")


if __name__ == "__main__":
    run_command(run)
