"""Face vectors: expression in the basis of a head model, followed by the jaw (ProbTalk3D section 3.2).

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
    """A head model, and the names of its expression coefficients."""

    head_model: str
    expression_names: tuple[str, ...]

    @property
    def numbers(self) -> int:
        """Dimensions of a frame: expression and jaw."""
        return len(self.expression_names) + JAW_DIM

    @classmethod
    def of(cls, content: Any) -> FaceBasis:
        """Parse the result of `to_dict`. Raises KeyError or TypeError if it is invalid."""
        return cls(str(content["head_model"]), tuple(content["expression_names"]))

    def to_dict(self) -> dict[str, Any]:
        """A dictionary for JSON."""
        return asdict(self) | {"expression_names": list(self.expression_names)}

    def require_match(self, other: FaceBasis, what: str, hint: str) -> None:
        """Raise InputError (one line) unless this basis, that of `what`, equals `other`."""
        if self != other:
            raise InputError(
                f"{what}: should be of the head {other.head_model} ({len(other.expression_names)} shapes), "
                f"got {self.head_model} ({len(self.expression_names)}); {hint}"
            )

    def to_vector(self, expression: Float[ndarray, "T C"], jaw: Float[ndarray, "T 3"]) -> Float[ndarray, "T F"]:
        """Vectors of frames from expression and jaw."""
        return np.concatenate([expression, jaw], axis=-1).astype(np.float32)

    def mirrored(self, face: Float[ndarray, "T F"]) -> Float[ndarray, "T F"]:
        """Mirror a face: left and right shapes are swapped, yaw and roll of the jaw change sign.

        Raises InputError for a head model without left and right shapes.
        """
        if not any(name.endswith(SIDES) for name in self.expression_names):
            raise InputError(
                f"windows.mirror: should be false for {self.head_model}, which has no left and right shapes, got true"
            )
        order = [self.expression_names.index(_other_side(name)) for name in self.expression_names]
        sign = np.array([1, -1, -1], face.dtype)
        return np.concatenate([face[..., order], face[..., -JAW_DIM:] * sign], axis=-1)


def _other_side(name: str) -> str:
    for side, other in (SIDES, SIDES[::-1]):
        if name.endswith(side):
            return name.removesuffix(side) + other
    return name
