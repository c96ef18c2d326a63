"""Pages of the docs: all commands and options exist; links; the site.

That the commands run: test_docs_run.py.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path

import pytest
import yaml
from command_line import get_command
from docs_pages import PAGES, REPOSITORY, lines, name_of

from talkingeyes.cli import main as cli
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose

DOCS = REPOSITORY / "docs"
CHANGELOG, CONTRIBUTING = REPOSITORY / "CHANGELOG.md", REPOSITORY / "CONTRIBUTING.md"
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
INLINE_COMMAND = re.compile(r"`((?:python -m|make) [^`\n]+)`")  # other programs are mentioned without their arguments
# The log and the releases grow and name commands of their time; the other result pages are written by programs.
CURRENT = [page for page in PAGES if not name_of(page).startswith(("docs/log", "docs/results/releases.md"))]
MANUAL = [page for page in CURRENT if not name_of(page).startswith(("README.md", "docs/results"))]
# Programs that are checked, not run.
ELSEWHERE = {"ray", "torchrun", "dvc", "git", "pre-commit", "blender", "npm", "python3", "mlflow"}
SHELL = {".", "cd", "cp", "mkdir", "for", "do", "done", "echo", "cat", "kill", "curl"}


def commands(page: Path) -> list[str]:
    """The single commands of a page, split at && and ; and |."""
    return [part for line in lines(page) for part in _parts(_without_substitutions(line))]


def _parts(line: str) -> list[str]:
    lexer = shlex.shlex(line, posix=False, punctuation_chars="|&;")
    lexer.whitespace_split = True
    groups = groupby(lexer, key=lambda word: set(word) <= set("|&;"))
    return [" ".join(words) for between, words in groups if not between]


def _without_substitutions(line: str) -> str:
    """$(...) as one word; its contents are run by the tutorial."""
    while (start := line.find("$(")) >= 0:
        depth, end = 1, start + 2
        while depth:
            depth += {"(": 1, ")": -1}.get(line[end], 0)
            end += 1
        line = line[:start] + "SUBSTITUTED" + line[end:]
    return line


def checked(command: str) -> str | None:
    """Error in a command, or None."""
    words = shlex.split(command)
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    if not words:
        return None
    known = {"talkingeyes": _talkingeyes, "make": _make, "python": _python}
    if words[0] in known:
        return known[words[0]](words[1:])
    return None if words[0] in ELSEWHERE | SHELL else f"no such program: {words[0]}"


def _talkingeyes(words: list[str]) -> str | None:
    command = get_command(cli.app)
    try:
        while hasattr(command, "commands"):
            command, words = command.commands[words[0]], words[1:]
        command.make_context(command.name, list(words))
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None


def _make(words: list[str]) -> str | None:
    targets = re.findall(r"^([a-z-]+):.*##", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    variables = re.findall(r"^([a-z]+) \?=", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    strange = [w for w in words if (w.split("=")[0] not in variables if "=" in w else w not in targets)]
    return f"no such target or variable: {strange}" if strange else None


def _python(words: list[str]) -> str | None:
    if words[0] == "-m":
        module = words[1]
        if find_spec(module.split(".")[0]) is None or find_spec(module) is None:
            return f"no such module: {module}"
        return _composes(words[2:]) if module == "pipelines.experiment" else None
    exists = (REPOSITORY / words[0]).is_file() or words[0] in (
        "-c",
        "local_viewer.py",
    )  # the last is of GaussianAvatars
    return None if exists else f"no such script: {words[0]}"


def _composes(words: list[str]) -> str | None:
    """Whether conf/ has the overridden key; of a sweep the first value is used. test_extend covers docs/extend.md."""
    own = {"sway", "crossings"}
    wanted = [word.split(",")[0] for word in words if "=" in word and not word.startswith("hydra")]
    if any(name in word for word in wanted for name in own):
        return None
    try:
        compose(wanted)
    except InputError as error:
        return str(error)
    return None


def test_every_command_of_the_docs_exists() -> None:
    typed = {(name_of(page), command) for page in [*PAGES, CONTRIBUTING] for command in commands(page)}
    for page in [*CURRENT, CONTRIBUTING]:
        typed |= {(name_of(page), span) for span in INLINE_COMMAND.findall(page.read_text()) if " [" not in span}
    faults = {command: checked(command) for command in {command for _, command in typed}}
    assert {each: faults[each[1]] for each in typed if faults[each[1]]} == {}


def test_links_are_valid() -> None:
    dead = {}
    for page in [*PAGES, CHANGELOG, CONTRIBUTING]:
        links = LINK.findall(re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL))
        if missing := [link for link in links if "://" not in link and not (page.parent / link).exists()]:
            dead[name_of(page)] = missing
    assert dead == {}


def test_the_manual_is_short() -> None:
    """Without numbers, and without the tables of pages that a program writes."""
    words = 0
    for page in MANUAL:
        text = page.read_text()
        by_program = re.search(r"(?:^|is )written by `(?:python|make)", text, re.MULTILINE | re.IGNORECASE)
        lines = [line for line in text.splitlines() if not (by_program and line.startswith("|"))]
        words += sum(1 for line in lines for word in line.split() if re.search("[A-Za-z]", word))
    assert 20_000 < words < 30_000


def test_entries_of_the_changelog_are_short() -> None:
    entries = [line for line in CHANGELOG.read_text().partition("## [Unreleased]")[2].splitlines() if line]
    assert sum(line.startswith("- ") for line in entries) > 50
    assert [line for line in entries if len(line) > 150] == []
    assert [line for line in entries if line.startswith(" ")] == []  # one line each


def test_the_log_lists_its_entries_by_date() -> None:
    rows = re.findall(
        r"^\| (\S+) \| .+\? \| .+\. \| \[.+\]\(log/(\S+)\) \|$", (DOCS / "log.md").read_text(), re.MULTILINE
    )
    assert sorted(name for _, name in rows) == sorted(path.name for path in (DOCS / "log").iterdir())
    assert [date for date, _ in rows] == sorted(name[:10] for _, name in rows)


def test_files_of_the_log_named_elsewhere_exist() -> None:
    pages = [*(REPOSITORY / "conf").rglob("*.yaml"), *(REPOSITORY / "src").rglob("*.py"), *PAGES]
    named = {name for page in pages for name in re.findall(r"docs/log/\d[\w-]+\.md", page.read_text())}
    assert len(named) > 5
    assert [name for name in named if not (REPOSITORY / name).is_file()] == []


def test_the_site_has_the_pages_that_it_names() -> None:
    site = yaml.safe_load((REPOSITORY / "mkdocs.yml").read_text())

    def files(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        parts = entry.values() if isinstance(entry, dict) else entry
        return [name for part in parts for name in files(part)]

    named = files(site["nav"])
    assert len(named) == len(set(named))
    assert [name for name in named if not (REPOSITORY / "docs" / name).is_file()] == []
    assert {"tutorial.md", "api.md", "model_card.md", "data_card.md", "formats.md", "benchmark.md"} <= set(named)
    modules = re.findall(r"^::: (\S+)", (REPOSITORY / "docs/api.md").read_text(), re.MULTILINE)
    assert modules
    assert [module for module in modules if find_spec(module) is None] == []


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mkdocs") is None, reason="needs mkdocs; `make docs` installs it")
def test_the_site_is_built(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(tmp_path)]
    built = subprocess.run(
        command,
        cwd=REPOSITORY,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        check=False,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    assert "Motion" in (tmp_path / "api.html").read_text()
    for page in tmp_path.glob("*.html"):  # nothing is loaded from other sites
        assert not re.search(r'<(?:script|link|img)[^>]+(?:src|href)="(?:https?:)?//(?!example)', page.read_text()), (
            page
        )
