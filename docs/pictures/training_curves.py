"""Draws how models trained, from the history.json of each run: docs/pictures/NAME-curves.png.

Run: python docs/pictures/training_curves.py posegan build/posegan [OUT.png]  (after python -m
        pipelines.results.posegan_table)
     python docs/pictures/training_curves.py probtalk3d-paper build/probtalk3d_paper
"""

import json
import sys
from pathlib import Path

from matplotlib import pyplot as plt

POSEGAN = "seed-*/data/train/posegan"  # a line a seed
STAGE_1, STAGE_2 = "data/pretrain/face", "data/train/probtalk3d"
# Titles of panels, the folders of their runs, and a column of the history.
CURVES = {
    "posegan": {
        "pose loss": (POSEGAN, "loss/pose"),
        "motion loss": (POSEGAN, "loss/motion"),
        "adversarial loss (generator)": (POSEGAN, "loss/adversarial"),
        "loss of the discriminator": (POSEGAN, "loss/discriminator_total"),
        "range on val (truth 1)": (POSEGAN, "free_running/range"),
        "speed on val (truth 1)": (POSEGAN, "free_running/speed"),
    },
    "probtalk3d-paper": {
        "stage 1: loss": (STAGE_1, "loss/total"),
        "stage 1: score on val (negative L1)": (STAGE_1, "validation_score"),
        "stage 1: perplexity (256 codes)": (STAGE_1, "perplexity"),
        "stage 2: loss": (STAGE_2, "loss/total"),
        "stage 2: score on val (negative energy score)": (STAGE_2, "validation_score"),
        "stage 2: speed of the face on val (truth 1)": (STAGE_2, "free_running/face_speed_ratio"),
    },
}


def main() -> None:
    """All runs of a workspace."""
    name, root = sys.argv[1], Path(sys.argv[2])
    figure, axes = plt.subplots(2, 3, figsize=(11, 5.5), layout="constrained")
    for axis, (title, (folders, key)) in zip(axes.flat, CURVES[name].items(), strict=True):
        for folder in sorted(root.glob(folders)):
            rows = [row for row in json.loads((folder / "history.json").read_text()) if key in row]
            run = folder.relative_to(root).parts[0]
            axis.plot([row["step"] for row in rows], [row[key] for row in rows], marker=".", label=run)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("step")
    if len(axes[0, 0].lines) > 1:
        axes[0, 0].legend()
    figure.savefig(sys.argv[3] if len(sys.argv) > 3 else f"docs/pictures/{name}-curves.png", dpi=110)


if __name__ == "__main__":
    main()
