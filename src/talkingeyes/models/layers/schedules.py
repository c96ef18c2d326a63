"""What changes while a network is trained: parts that are told how many steps it has been trained for.

The training's task tells them before each step, from the loop's own count: one that was killed goes on as it was.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import nn


@runtime_checkable
class ScheduledModule(Protocol):
    """A part of a network that is trained otherwise early than late."""

    trained_steps: int


def set_trained_steps(network: nn.Module, steps: int) -> None:
    """Tell every such part of a network how many steps it has been trained for."""
    for part in network.modules():
        if isinstance(part, ScheduledModule):
            part.trained_steps = steps


def ramp(steps: int, over: int) -> float:
    """From 0 along a line to 1, which is reached after `over` steps."""
    return min(1.0, steps / over)
