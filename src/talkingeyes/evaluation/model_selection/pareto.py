"""Plot of a search with two objectives: all trials and the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def plot_pareto_front(
    trials: Sequence[Sequence[float]], pareto_front: Sequence[Sequence[float]], names: Sequence[str], path: Path
) -> None:
    """Save a scatter plot of the two objectives: trials as grey dots, the Pareto front as an orange line with dots."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axis = figure.subplots()
    axis.scatter(*zip(*trials, strict=True), color="#8a8a8a", label=f"{len(trials)} trials")
    axis.plot(
        *zip(*sorted(map(tuple, pareto_front)), strict=True), "o-", color="#d95f02", label=f"front: {len(pareto_front)}"
    )
    axis.set_xlabel(f"{names[0]} on val")
    axis.set_ylabel(f"{names[1]} on val")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False)
    figure.savefig(path, dpi=120, metadata={"Software": None})
