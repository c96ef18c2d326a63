"""The training loop: the only one. AdamW, a one-cycle or constant rate, gradient clipping, the best weights on val.

A `Task` owns its network, draws its own batches and says what its losses are; the loop does the rest, visibly.
Seeds: a task draws from generators that it seeds itself, so the same settings give the same weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal, Protocol, runtime_checkable

import torch
from pydantic import Field
from torch import Tensor, nn
from tqdm import tqdm

from talkingeyes.settings import Settings


class LoopSettings(Settings):
    """How a network is trained."""

    steps: Annotated[int, Field(gt=0)]
    batch: Annotated[int, Field(gt=0)]
    learning_rate: Annotated[float, Field(gt=0, lt=1)]
    schedule: Literal["constant", "one-cycle"]
    weight_decay: Annotated[float, Field(ge=0)]
    clip_norm: Annotated[float, Field(gt=0)]
    # Steps between two validations; the paper's epochs, counted in steps.
    validate_every: Annotated[int, Field(gt=0)]


@runtime_checkable
class Task(Protocol):
    """What is trained. `losses` draws a batch and returns named scalars, `total` is minimised.

    `validate` returns named figures; `score` is maximised: the weights of its best value are kept (of NaN: the last).
    """

    module: nn.Module

    def losses(self, step: int) -> dict[str, Tensor]: ...

    def validate(self) -> dict[str, float]: ...


Watch = Callable[[int, dict[str, float]], None]


def train(task: Task, settings: LoopSettings, title: str, report: Watch | None = None) -> list[dict[str, float]]:
    """Train in place; returns the history, a row a validation: step, mean of each loss since the last row, figures.

    `report` is given the step and the figures of every validation, and may raise to end a training that leads nowhere.
    """
    weights = [parameter for parameter in task.module.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(weights, lr=settings.learning_rate, weight_decay=settings.weight_decay)
    history: list[dict[str, float]] = []
    sums: dict[str, float] = {}
    best, kept = -math.inf, None
    bar = tqdm(range(1, settings.steps + 1), desc=title, mininterval=1.0)
    for step in bar:
        for group in optimiser.param_groups:
            group["lr"] = _rate(settings, step)
        task.module.train()
        losses = task.losses(step)
        optimiser.zero_grad(set_to_none=True)
        losses["total"].backward()
        nn.utils.clip_grad_norm_(weights, settings.clip_norm)
        optimiser.step()
        for name, value in losses.items():
            sums[name] = sums.get(name, 0.0) + value.item()
        if step % settings.validate_every == 0 or step == settings.steps:
            task.module.eval()
            with torch.no_grad():
                figures = task.validate()
            count = step - (int(history[-1]["step"]) if history else 0)
            history.append({"step": float(step), **{f"loss/{k}": v / count for k, v in sums.items()}, **figures})
            bar.set_postfix({k: f"{v:.3g}" for k, v in figures.items()})
            sums = {}
            if not figures["score"] <= best:
                best = figures["score"]
                kept = {name: tensor.clone() for name, tensor in task.module.state_dict().items()}
            if report is not None:
                report(step, figures)
    if kept is not None:
        task.module.load_state_dict(kept)
    task.module.eval()
    return history


def _rate(settings: LoopSettings, step: int) -> float:
    """One cycle: up over the first tenth, down along a cosine to 1 % (Smith & Topin 2018)."""
    if settings.schedule == "constant":
        return settings.learning_rate
    warm = max(1, settings.steps // 10)
    if step <= warm:
        return settings.learning_rate * step / warm
    share = (step - warm) / max(1, settings.steps - warm)
    return settings.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
