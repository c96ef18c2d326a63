"""The training loop: AdamW, one-cycle or constant learning rate, gradient clipping, best weights on val.

A `TrainingTask` owns its network, samples its batches and computes its losses. The loop runs on any device, in one or
several processes (execution.py), and resumes after an interruption (resume.py). An `AdversarialTask` also has a
discriminator, which is updated after each step by its own optimiser. A task samples from generators that it seeds
itself, so equal settings give equal weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.progress import progress_bar
from talkingeyes.core.settings import Settings
from talkingeyes.models.layers import distributed
from talkingeyes.training.execution import CPU_CONTEXT, ExecutionContext
from talkingeyes.training.resume import ResumeFile, TrainingState

LOSS_PREFIX = "loss/"


class LoopSettings(Settings):
    """Settings of the optimisation."""

    steps: Annotated[int, Field(gt=0)]
    batch: Annotated[int, Field(gt=0)]
    learning_rate: Annotated[float, Field(gt=0, lt=1)]
    schedule: Literal["constant", "one-cycle"]
    weight_decay: Annotated[float, Field(ge=0)]
    # Largest norm of the gradient; null: not clipped.
    clip_norm: Annotated[float, Field(gt=0)] | None
    # Steps between two validations; the paper's epochs, counted in steps.
    validate_every: Annotated[int, Field(gt=0)]


@runtime_checkable
class TrainingTask(Protocol):
    """Interface of a training. `losses` samples a batch and returns named scalars, of which `total` is minimised.

    `validate` returns named metrics. The weights with the highest `validation_score` are kept (with NaN: the last
    ones).
    """

    # Random generator of batches. Noise in the network uses torch's global generator.
    rng: np.random.Generator

    @property
    def module(self) -> nn.Module: ...

    def losses(self, step: int) -> dict[str, Tensor]: ...

    def validate(self) -> dict[str, float]: ...


@runtime_checkable
class AdversarialTask(Protocol):
    """A task whose network includes a discriminator, which is trained against the rest of the network (PoseGAN)."""

    @property
    def discriminator(self) -> nn.Module | None: ...

    # Losses on the batch of `losses` of the same step; only the discriminator minimises `total`.
    def discriminator_losses(self, step: int) -> dict[str, Tensor]: ...


ValidationCallback = Callable[[int, dict[str, float]], None]


def train(
    task: TrainingTask,
    settings: LoopSettings,
    title: str,
    on_validation: ValidationCallback | None = None,
    context: ExecutionContext = CPU_CONTEXT,
    resume: ResumeFile | None = None,
) -> list[dict[str, float]]:
    """Train in place. Returns the history, a row per validation: step, mean losses since the last row, metrics.

    `on_validation` receives the step and the metrics of every validation, and may raise to prune a training. With
    `resume`, an interrupted training resumes from its last validation; the caller removes the file.
    """
    module = task.module.to(context.device)
    discriminator = task.discriminator if isinstance(task, AdversarialTask) else None
    of_discriminator = set(discriminator.parameters()) if discriminator else set()
    main = _Optimiser(
        [each for each in module.parameters() if each.requires_grad and each not in of_discriminator],
        settings,
        settings.weight_decay,
    )
    adversary = _Optimiser(list(discriminator.parameters()), settings) if discriminator else None
    adversary_adam = adversary.adam if adversary else None
    losses_of = context.distribute(module, task.losses, settings.batch)
    state = resume.restore(module, main.adam, task.rng, adversary_adam) if resume else TrainingState()
    for row in state.history if on_validation else ():
        on_validation(int(row["step"]), _metrics(row))  # type: ignore[misc]
    sums: dict[str, float] = {}
    steps = range(state.step + 1, settings.steps + 1)
    bar = progress_bar(steps, title, settings.steps, initial=state.step, disable=not context.is_main)
    for step in bar:
        module.train()
        with context.autocast():
            losses = losses_of(step)
        main.update(losses["total"], step)
        if isinstance(task, AdversarialTask) and adversary is not None:
            with context.autocast():
                adversary_losses = task.discriminator_losses(step)
            adversary.update(adversary_losses["total"], step)
            losses |= {f"discriminator_{name}": value for name, value in adversary_losses.items()}
        for name, value in losses.items():
            sums[name] = sums.get(name, 0.0) + value.item()
        if step % settings.validate_every == 0 or step == settings.steps:
            module.eval()
            with torch.no_grad():
                figures = task.validate()
            since = step - state.step
            state.step = step
            state.history.append({"step": float(step), **_means(sums, since, context), **figures})
            state.update_best(figures["validation_score"], module.state_dict())
            sums = {}
            bar.set_postfix({k: f"{v:.3g}" for k, v in figures.items()})
            if resume is not None and context.is_main:
                resume.keep(state, module, main.adam, task.rng, adversary_adam)
            if on_validation is not None:
                on_validation(step, figures)
    if state.best_weights is not None:
        module.load_state_dict(state.best_weights)
    module.cpu().eval()
    return state.history


class _Optimiser:
    """AdamW with the learning-rate schedule and gradient clipping, for one set of weights."""

    def __init__(self, weights: list[nn.Parameter], settings: LoopSettings, weight_decay: float = 0.01) -> None:
        self.weights, self.settings = weights, settings
        self.adam = torch.optim.AdamW(weights, lr=settings.learning_rate, weight_decay=weight_decay, fused=True)

    def update(self, loss: Tensor, step: int) -> None:
        """One step down the gradient of the loss. Gradients that other losses left in the weights are discarded."""
        for group in self.adam.param_groups:
            group["lr"] = _learning_rate(self.settings, step)
        self.adam.zero_grad(set_to_none=True)
        loss.backward()
        if self.settings.clip_norm is not None:
            nn.utils.clip_grad_norm_(self.weights, self.settings.clip_norm)
        self.adam.step()


def _means(sums: dict[str, float], steps: int, context: ExecutionContext) -> dict[str, float]:
    """Mean losses per step, over all processes."""
    values = distributed.all_reduce_mean(
        torch.tensor(list(sums.values()), dtype=torch.float64, device=context.device) / steps
    ).tolist()
    return {f"{LOSS_PREFIX}{name}": value for name, value in zip(sums, values, strict=True)}


def _metrics(row: dict[str, float]) -> dict[str, float]:
    """The metrics of `validate` in a row of the history."""
    return {name: value for name, value in row.items() if name != "step" and not name.startswith(LOSS_PREFIX)}


def _learning_rate(settings: LoopSettings, step: int) -> float:
    """One-cycle: linear warm-up over the first tenth, then cosine decay to 1 % (Smith & Topin 2018)."""
    if settings.schedule == "constant":
        return settings.learning_rate
    warm = max(1, settings.steps // 10)
    if step <= warm:
        return settings.learning_rate * step / warm
    progress = (step - warm) / max(1, settings.steps - warm)
    return settings.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))
