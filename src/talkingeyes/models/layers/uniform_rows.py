"""Uniform random numbers of one seed, row by row, as a stream of unknown length needs them."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

BLOCK_ROWS = 64


class UniformRows:
    """Rows of `width` numbers: row n is the same whenever it is asked for, and equals that of one call of torch.rand.

    They are drawn in blocks, because a call for a single row costs more than its numbers.
    """

    def __init__(self, generator: torch.Generator, width: int) -> None:
        self._generator, self._first, self._drawn = generator, 0, torch.zeros(0, width)

    def rows(self, first: int, stop: int) -> Float[Tensor, "K W"]:
        """Rows from `first` up to `stop`; rows before the smallest `first` so far are dropped."""
        missing = stop - self._first - len(self._drawn)
        if missing > 0:
            new = torch.rand(max(missing, BLOCK_ROWS), self._drawn.shape[1], generator=self._generator)
            self._drawn = torch.cat([self._drawn[first - self._first :], new])
            self._first = first
        return self._drawn[first - self._first : stop - self._first]
