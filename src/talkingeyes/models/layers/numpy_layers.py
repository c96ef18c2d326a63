"""Inference layers in numpy: for loops of many small steps, where a call of torch costs more than its arithmetic, and
for installations without torch. A layer is built from the tensors of a module by name, as in its state dict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import erf

Tensors = Mapping[str, ndarray]


def to_numpy(value: Any) -> Float[ndarray, "*N"]:
    """A tensor of torch as a numpy array."""
    return np.asarray(value.detach().cpu().numpy())


def module_tensors(module: Any) -> dict[str, ndarray]:
    """The tensors of a module of torch by name."""
    return {name: to_numpy(each) for name, each in module.state_dict().items()}


def tensors_under(tensors: Tensors, prefix: str) -> dict[str, ndarray]:
    """The tensors of a part of a module, by their names in the part."""
    start = f"{prefix}."
    return {name.removeprefix(start): each for name, each in tensors.items() if name.startswith(start)}


def gelu(x: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
    """GELU. `torch_gelu` in convolution.py takes half of the time on arrays of this size."""
    return np.asarray(0.5 * x * (1.0 + erf(x * math.sqrt(0.5))))


class NumpyLayerNorm:
    """Layer normalisation."""

    def __init__(self, tensors: Tensors, name: str) -> None:
        self._weight, self._bias, self._eps = tensors[f"{name}.weight"], tensors[f"{name}.bias"], np.float32(1e-5)

    def __call__(self, x: Float[ndarray, "*N W"]) -> Float[ndarray, "*N W"]:
        """Normalise the last axis to mean 0 and variance 1, then scale and shift."""
        width = x.shape[-1]
        centred = x - x.sum(axis=-1, keepdims=True) / width
        variance = np.einsum("...w,...w->...", centred, centred) / width
        return np.asarray(centred / np.sqrt(variance + self._eps)[..., None] * self._weight + self._bias)


class NumpyLinear:
    """Linear layer."""

    def __init__(self, tensors: Tensors, name: str) -> None:
        self._weight, self._bias = np.ascontiguousarray(tensors[f"{name}.weight"].T), tensors[f"{name}.bias"]

    def __call__(self, x: Float[ndarray, "*N C"]) -> Float[ndarray, "*N W"]:
        """Apply the layer to the last axis, as one matrix product."""
        out = x.reshape(-1, len(self._weight)) @ self._weight + self._bias
        return np.asarray(out.reshape(*x.shape[:-1], len(self._bias)))


class NumpyGRU:
    """A linear layer followed by a GRU, one step at a time. The layer and the input weights of the GRU are merged into
    one matrix."""

    def __init__(self, tensors: Tensors, before: str, gru: str) -> None:
        inner, inner_bias = tensors[f"{gru}.weight_ih_l0"], tensors[f"{gru}.bias_ih_l0"]
        self._given = np.ascontiguousarray((inner @ tensors[f"{before}.weight"]).T)
        self._given_bias = inner @ tensors[f"{before}.bias"] + inner_bias
        self._kept, self._kept_bias = (
            np.ascontiguousarray(tensors[f"{gru}.weight_hh_l0"].T),
            tensors[f"{gru}.bias_hh_l0"],
        )

    def __call__(self, x: Float[ndarray, "N C"], state: Float[ndarray, "N W"]) -> Float[ndarray, "N W"]:
        """The next state."""
        given, kept, width = x @ self._given + self._given_bias, state @ self._kept + self._kept_bias, state.shape[1]
        gates = 0.5 + 0.5 * np.tanh(0.5 * (given[:, : 2 * width] + kept[:, : 2 * width]))  # the logistic function
        reset, update = gates[:, :width], gates[:, width:]
        new = np.tanh(given[:, 2 * width :] + reset * kept[:, 2 * width :])
        return np.asarray(new + update * (state - new))


class NumpyConv:
    """Dilated convolution over time of odd kernel, with zeros around the sequence."""

    def __init__(self, tensors: Tensors, name: str, dilation: int) -> None:
        weight = tensors[f"{name}.weight"]  # axes: output, input, tap
        self._weight, self._bias = np.ascontiguousarray(weight.transpose(2, 1, 0)), tensors[f"{name}.bias"]
        self._dilation = dilation

    def __call__(self, x: Float[ndarray, "B T C"]) -> Float[ndarray, "B T W"]:
        """Outputs of all frames."""
        frames, reach = x.shape[1], len(self._weight) // 2 * self._dilation
        padded = np.pad(x, ((0, 0), (reach, reach), (0, 0)))
        out = np.repeat(self._bias[None, None], frames, axis=1)
        for tap, weight in enumerate(self._weight):
            out = out + padded[:, tap * self._dilation : tap * self._dilation + frames] @ weight
        return out


class NumpyCausalConv:
    """Dilated causal convolution over time; its input begins with the `reach` frames before the first output."""

    def __init__(self, tensors: Tensors, name: str, dilation: int) -> None:
        weight = tensors[f"{name}.weight"]  # axes: output, input, tap
        self._weight = np.ascontiguousarray(weight.transpose(2, 1, 0).reshape(-1, len(weight)))
        self._bias = tensors[f"{name}.bias"]
        self._starts = [tap * dilation for tap in range(weight.shape[2])]
        self.reach = self._starts[-1]

    def __call__(self, x: Float[ndarray, "B P C"]) -> Float[ndarray, "B T W"]:
        """Outputs of all frames but the first `reach`."""
        frames = x.shape[1] - self.reach
        taps = np.concatenate([x[:, start : start + frames] for start in self._starts], axis=2)
        out = taps.reshape(-1, len(self._weight)) @ self._weight + self._bias
        return np.asarray(out.reshape(len(x), frames, -1))
