"""Networks that are frozen while another network is trained on what they encode."""

from __future__ import annotations

from typing import TypeVar

from torch import nn

AnyFreezable = TypeVar("AnyFreezable", bound="FreezableModule")


class FreezableModule(nn.Module):
    """A module that stays in evaluation mode once it is frozen."""

    frozen = False

    def freeze(self: AnyFreezable) -> AnyFreezable:
        """Freeze weights and codebook."""
        self.frozen = True
        self.requires_grad_(False)
        return self.eval()

    def train(self: AnyFreezable, mode: bool = True) -> AnyFreezable:
        """Set training mode, unless frozen."""
        return super().train(mode and not self.frozen)
