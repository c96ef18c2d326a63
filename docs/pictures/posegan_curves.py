"""Draws docs/pictures/posegan-curves.png: how PoseGAN and its rival trained, a line a seed.

Run: python docs/pictures/posegan_curves.py build/posegan [OUT.png]     (after python -m pipelines.posegan_table)
"""

import json
import sys
from pathlib import Path

from matplotlib import pyplot as plt

# Losses of the generator and its rival, and what val shows; 1 is as true heads move.
CURVES = {
    "loss/pose": "pose loss",
    "loss/motion": "motion loss",
    "loss/adversarial": "adversarial loss (generator)",
    "loss/discriminator_total": "loss of the discriminator",
    "free_running/range": "range on val (truth 1)",
    "free_running/speed": "speed on val (truth 1)",
}


def main() -> None:
    """All seeds of a workspace."""
    root, out = Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else "docs/pictures/posegan-curves.png")
    histories = {
        path.parents[3].name: [row for row in json.loads(path.read_text()) if "step" in row]
        for path in sorted(root.glob("seed-*/data/train/posegan/history.json"))
    }
    figure, axes = plt.subplots(2, 3, figsize=(11, 5.5), layout="constrained")
    for axis, (key, title) in zip(axes.flat, CURVES.items(), strict=True):
        for name, rows in histories.items():
            axis.plot([row["step"] for row in rows], [row[key] for row in rows], marker=".", label=name)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("step")
    axes[0, 0].legend()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
