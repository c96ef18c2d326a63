"""Diagrams of the docs: the data flow between stages, and the default model.

Run     python docs/pictures/diagrams.py
Writes  data-flow.svg, default-model.svg

SVG instead of Mermaid, because the docs site loads nothing from other sites and Mermaid's script is not part of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

Point = tuple[float, float]
BOX_H, LABEL_W, LABEL_H = 40, 70, 22


@dataclass(frozen=True)
class Diagram:
    """Boxes and plain text by name, with their centres, and arrows between names."""

    size: tuple[int, int]
    box_w: float
    boxes: dict[str, Point]
    labels: dict[str, Point]
    arrows: tuple[tuple[str, str], ...]

    def svg(self) -> str:
        """The picture."""
        width, height = self.size
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            'font-family="sans-serif" font-size="15">',
            '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" '
            'orient="auto"><path d="M0 0L8 4L0 8z" fill="#456"/></marker></defs>',
            f'<rect width="{width}" height="{height}" fill="#fff"/>',
        ]
        lines += [self._arrow(*ends) for ends in self.arrows]
        for name, (x, y) in self.boxes.items():
            lines.append(
                f'<rect x="{x - self.box_w / 2:g}" y="{y - BOX_H / 2:g}" width="{self.box_w:g}" height="{BOX_H}" '
                'rx="6" fill="#e8eef4" stroke="#456"/>'
            )
            lines.append(f'<text x="{x}" y="{y + 5}" text-anchor="middle">{name}</text>')
        for name, (x, y) in self.labels.items():
            lines.append(
                f'<text x="{x}" y="{y + 5}" text-anchor="middle" font-style="italic" fill="#245">{name}</text>'
            )
        return "\n".join([*lines, "</svg>", ""])

    def _arrow(self, start: str, end: str) -> str:
        (x1, y1), (x2, y2) = (self._edge(a, b) for a, b in ((start, end), (end, start)))
        return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="#456" fill="none" marker-end="url(#head)"/>'

    def _edge(self, name: str, towards: str) -> Point:
        """Where the line between two centres leaves the first box."""
        known = self.boxes | self.labels
        (x, y), (to_x, to_y) = known[name], known[towards]
        width, height = (self.box_w, BOX_H) if name in self.boxes else (LABEL_W, LABEL_H)
        dx, dy = to_x - x, to_y - y
        scale = min(width / 2 / abs(dx) if dx else 9e9, height / 2 / abs(dy) if dy else 9e9)
        return x + dx * scale, y + dy * scale


DATA_FLOW = Diagram(
    (1010, 350),
    120,
    {
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
    },
    {"corpus": (230, 170), "motion": (490, 90), "features": (490, 250)},
    (
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
    ),
)
DEFAULT_MODEL = Diagram(
    (1010, 250),
    160,
    {
        "speech features": (260, 60),
        "speaker embedding": (260, 190),
        "head: poses, cubics": (490, 60),
        "gaze: saccades": (490, 190),
        "rules of animation": (720, 125),
    },
    {"speech": (70, 60), "person": (70, 190), "head": (620, 60), "gaze": (620, 190), "motion": (930, 125)},
    (
        ("speech", "speech features"),
        ("person", "speaker embedding"),
        ("speech features", "head: poses, cubics"),
        ("speaker embedding", "head: poses, cubics"),
        ("speech features", "gaze: saccades"),
        ("speaker embedding", "gaze: saccades"),
        ("head: poses, cubics", "gaze: saccades"),
        ("head: poses, cubics", "head"),
        ("gaze: saccades", "gaze"),
        ("head", "rules of animation"),
        ("gaze", "rules of animation"),
        ("rules of animation", "motion"),
    ),
)
DIAGRAMS = {"data-flow.svg": DATA_FLOW, "default-model.svg": DEFAULT_MODEL}

if __name__ == "__main__":
    for file, diagram in DIAGRAMS.items():
        (Path(__file__).parent / file).write_text(diagram.svg())
