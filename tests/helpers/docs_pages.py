"""Commands on the pages of the docs: `sh` blocks, lines after `$ ` in other blocks, indented commands of ours."""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = sorted([REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md")])
BLOCK = re.compile(r"^ *```([^\n]*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
OURS = r"(?:[A-Z_]+=\S+ +)*(?:python3? -m|torchrun|talkingeyes|make|dvc|mlflow) [^\n]*"
# An indented line with an option in brackets is a synopsis, not a command.
BLOCK_OR_INDENTED = re.compile(rf"{BLOCK.pattern}|^(?: {{4}}|\t)({OURS})$", re.MULTILINE | re.DOTALL)


def name_of(page: Path) -> str:
    """Path relative to the repository, such as docs/tutorial.md."""
    return page.relative_to(REPOSITORY).as_posix()


def lines(page: Path) -> list[str]:
    """The shell commands of a page in order, without comments and with continued lines joined."""
    found = []
    for language, text, indented in BLOCK_OR_INDENTED.findall(page.read_text()):
        joined = text.replace("\\\n", " ").splitlines()
        typed = joined if language == "sh" else [line[2:] for line in joined if line.startswith("$ ")]
        found += [re.sub(r"(^|\s)#.*", "", line).strip() for line in typed]
        found += [indented] if indented and " [" not in indented else []
    return [re.sub(r"\s+", " ", line) for line in found if line]


def unread_commands(text: str) -> list[str]:
    """Lines of fenced blocks that are commands of ours, but are not read by `lines`: those of other languages."""
    blocks = [block for language, block in BLOCK.findall(text) if language != "sh"]
    return [line for block in blocks for line in block.splitlines() if re.fullmatch(rf"\s*{OURS}", line)]
