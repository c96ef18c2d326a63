"""Training schedules of modules: some parts of a network depend on the number of training steps.

The training task sets the number before each step from the count of the loop, so that a resumed training continues the
schedule.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import nn


@runtime_checkable
class ScheduledModule(Protocol):
    """A module whose behaviour depends on the training step."""

    trained_steps: int


def set_trained_steps(network: nn.Module, steps: int) -> None:
    """Set the number of training steps in all scheduled modules of a network."""
    for part in network.modules():
        if isinstance(part, ScheduledModule):
            part.trained_steps = steps


def ramp(steps: int, over: int) -> float:
    """Linear ramp from 0 to 1, which is reached after `over` steps."""
    return min(1.0, steps / over)
