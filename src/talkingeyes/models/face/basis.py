"""What a face is in numbers: the expression of one head's own basis, then its jaw (ProbTalk3D section 3.2).

FLAME: 50 + 3 = 53 numbers as in the paper; the open head: 38 + 3 = 41.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError

JAW_DIM = 3
SIDES = ("Left", "Right")


@dataclass(frozen=True)
class FaceBasis:
    """The head, and the names of the numbers of its expression."""

    head_model: str
    expression_names: tuple[str, ...]

    @property
    def numbers(self) -> int:
        """Of one frame: expression and jaw."""
        return len(self.expression_names) + JAW_DIM

    @classmethod
    def of(cls, content: Any) -> FaceBasis:
        """From what `content` wrote. Raises KeyError or TypeError if it is not that."""
        return cls(str(content["head_model"]), tuple(content["expression_names"]))

    def to_dict(self) -> dict[str, Any]:
        """As JSON can say it."""
        return asdict(self) | {"expression_names": list(self.expression_names)}

    def require_match(self, other: FaceBasis, what: str, hint: str) -> None:
        """Raises InputError (one line) unless `what`, which has this basis, is of the head `other`."""
        if self != other:
            raise InputError(
                f"{what}: should be of the head {other.head_model} ({len(other.expression_names)} shapes), "
                f"got {self.head_model} ({len(self.expression_names)}); {hint}"
            )

    def to_vector(self, expression: Float[ndarray, "T C"], jaw: Float[ndarray, "T 3"]) -> Float[ndarray, "T F"]:
        """The numbers of frames."""
        return np.concatenate([expression, jaw], axis=-1).astype(np.float32)

    def mirrored(self, face: Float[ndarray, "T F"]) -> Float[ndarray, "T F"]:
        """The face in a mirror: shapes of left and right change places, yaw and roll of the jaw change sign.

        Raises InputError for a head whose shapes have no sides.
        """
        if not any(name.endswith(SIDES) for name in self.expression_names):
            raise InputError(
                f"windows.mirror: should be false for {self.head_model}, whose shapes have no sides, got true"
            )
        order = [self.expression_names.index(_other_side(name)) for name in self.expression_names]
        sign = np.array([1, -1, -1], face.dtype)
        return np.concatenate([face[..., order], face[..., -JAW_DIM:] * sign], axis=-1)


def _other_side(name: str) -> str:
    for side, other in (SIDES, SIDES[::-1]):
        if name.endswith(side):
            return name.removesuffix(side) + other
    return name
