"""The data flow of docs/architecture.md as a picture.

Run     python docs/pictures/data_flow.py
Writes  data-flow.svg

SVG instead of Mermaid, because the docs site loads nothing from other sites and Mermaid's script is not part of it.
"""

from __future__ import annotations

from pathlib import Path

WIDTH, HEIGHT, BOX_W, BOX_H = 1010, 350, 120, 40
# Stages (boxes) and data (plain text) by name: centre.
STAGES = {
    "synthesize": (90, 90),
    "track": (90, 250),
    "fit": (370, 90),
    "embed": (370, 250),
    "pretrain": (620, 40),
    "train": (620, 130),
    "critic": (620, 310),
    "sample": (780, 220),
    "information": (780, 40),
    "validate": (780, 130),
    "evaluate": (780, 310),
    "report": (940, 220),
}
DATA = {"corpus": (230, 170), "motion": (490, 90), "features": (490, 250)}
ARROWS = (
    ("synthesize", "corpus"),
    ("track", "corpus"),
    ("corpus", "fit"),
    ("corpus", "embed"),
    ("fit", "motion"),
    ("embed", "features"),
    ("motion", "pretrain"),
    ("motion", "train"),
    ("features", "train"),
    ("pretrain", "train"),
    ("motion", "critic"),
    ("features", "critic"),
    ("train", "information"),
    ("train", "validate"),
    ("train", "sample"),
    ("sample", "evaluate"),
    ("critic", "evaluate"),
    ("evaluate", "report"),
    ("information", "report"),
    ("validate", "report"),
)
LABEL_W, LABEL_H = 70, 22


def svg() -> str:
    """The picture."""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif" font-size="15">',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#456"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
    ]
    lines += [_arrow(*ends) for ends in ARROWS]
    for name, (x, y) in STAGES.items():
        lines.append(
            f'<rect x="{x - BOX_W / 2:g}" y="{y - BOX_H / 2:g}" width="{BOX_W}" height="{BOX_H}" rx="6" '
            'fill="#e8eef4" stroke="#456"/>'
        )
        lines.append(f'<text x="{x}" y="{y + 5}" text-anchor="middle">{name}</text>')
    for name, (x, y) in DATA.items():
        lines.append(f'<text x="{x}" y="{y + 5}" text-anchor="middle" font-style="italic" fill="#245">{name}</text>')
    return "\n".join([*lines, "</svg>", ""])


def _arrow(start: str, end: str) -> str:
    (x1, y1), (x2, y2) = (_edge(a, b) for a, b in ((start, end), (end, start)))
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="#456" fill="none" marker-end="url(#head)"/>'


def _edge(name: str, towards: str) -> tuple[float, float]:
    """Where the line between two centres leaves the first box."""
    known = STAGES | DATA
    (x, y), (to_x, to_y) = known[name], known[towards]
    width, height = (BOX_W, BOX_H) if name in STAGES else (LABEL_W, LABEL_H)
    dx, dy = to_x - x, to_y - y
    scale = min(width / 2 / abs(dx) if dx else 9e9, height / 2 / abs(dy) if dy else 9e9)
    return x + dx * scale, y + dy * scale


if __name__ == "__main__":
    (Path(__file__).parent / "data-flow.svg").write_text(svg())
