"""Commands on the pages of the docs: their `sh` blocks, and lines after `$ ` in other blocks."""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = sorted([REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md")])
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def name_of(page: Path) -> str:
    """Path relative to the repository, such as docs/tutorial.md."""
    return page.relative_to(REPOSITORY).as_posix()


def lines(page: Path) -> list[str]:
    """The shell commands of a page in order, without comments and with continued lines joined."""
    found = []
    for language, text in BLOCK.findall(page.read_text()):
        joined = text.replace("\\\n", " ").splitlines()
        typed = joined if language == "sh" else [line[2:] for line in joined if line.startswith("$ ")]
        found += [re.sub(r"(^|\s)#.*", "", line).strip() for line in typed]
    return [re.sub(r"\s+", " ", line) for line in found if line]
