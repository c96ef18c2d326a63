"""Inference layers in numpy, for loops of many small steps, where a call of torch costs more than its arithmetic."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy import ndarray
from torch import nn


def to_numpy(value: torch.Tensor) -> Float[ndarray, "*N"]:
    """A weight as a numpy array."""
    return np.asarray(value.detach().cpu().numpy())


def gelu(x: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
    """GELU by torch, whose error function is ten times as fast as scipy's on arrays of this size."""
    return F.gelu(torch.from_numpy(x)).numpy()


class NumpyLayerNorm:
    """Layer normalisation."""

    def __init__(self, norm: nn.LayerNorm) -> None:
        self._weight, self._bias, self._eps = to_numpy(norm.weight), to_numpy(norm.bias), np.float32(norm.eps)

    def __call__(self, x: Float[ndarray, "N W"]) -> Float[ndarray, "N W"]:
        """Normalise rows to mean 0 and variance 1, then scale and shift."""
        width = x.shape[1]
        centred = x - x.sum(axis=1, keepdims=True) / width
        variance = np.einsum("nw,nw->n", centred, centred) / width
        return np.asarray(centred / np.sqrt(variance + self._eps)[:, None] * self._weight + self._bias)


class NumpyLinear:
    """Linear layer."""

    def __init__(self, linear: nn.Linear) -> None:
        self._weight, self._bias = np.ascontiguousarray(to_numpy(linear.weight).T), to_numpy(linear.bias)

    def __call__(self, x: Float[ndarray, "*N C"]) -> Float[ndarray, "*N W"]:
        """Apply the layer to the last axis, as one matrix product."""
        out = x.reshape(-1, len(self._weight)) @ self._weight + self._bias
        return np.asarray(out.reshape(*x.shape[:-1], len(self._bias)))


class NumpyGRU:
    """A linear layer followed by a GRU, one step at a time. The layer and the input weights of the GRU are merged into
    one matrix."""

    def __init__(self, before: nn.Linear, gru: nn.GRU) -> None:
        weights = {name: to_numpy(each) for name, each in gru.named_parameters()}
        self._given = np.ascontiguousarray((weights["weight_ih_l0"] @ to_numpy(before.weight)).T)
        self._given_bias = weights["weight_ih_l0"] @ to_numpy(before.bias) + weights["bias_ih_l0"]
        self._kept, self._kept_bias = np.ascontiguousarray(weights["weight_hh_l0"].T), weights["bias_hh_l0"]

    def __call__(self, x: Float[ndarray, "N C"], state: Float[ndarray, "N W"]) -> Float[ndarray, "N W"]:
        """The next state."""
        given, kept, width = x @ self._given + self._given_bias, state @ self._kept + self._kept_bias, state.shape[1]
        gates = 0.5 + 0.5 * np.tanh(0.5 * (given[:, : 2 * width] + kept[:, : 2 * width]))  # the logistic function
        reset, update = gates[:, :width], gates[:, width:]
        new = np.tanh(given[:, 2 * width :] + reset * kept[:, 2 * width :])
        return np.asarray(new + update * (state - new))


class NumpyCausalConv:
    """Dilated causal convolution that keeps its past input; the input before the first frame is zero."""

    def __init__(self, convolution: nn.Conv1d) -> None:
        weight = to_numpy(convolution.weight)  # axes: output, input, tap
        self._weight = np.ascontiguousarray(weight.transpose(2, 1, 0).reshape(-1, len(weight)))
        self._bias = to_numpy(convolution.bias)  # type: ignore[arg-type]
        (taps,), (dilation,) = convolution.kernel_size, convolution.dilation
        self._starts = [tap * dilation for tap in range(taps)]
        self._past = np.zeros((self._starts[-1], weight.shape[1]), np.float32)

    def __call__(self, x: Float[ndarray, "T C"]) -> Float[ndarray, "T W"]:
        """Outputs of the next frames."""
        padded = np.concatenate([self._past, x])
        self._past = padded[len(x) :]
        taps = np.concatenate([padded[start : start + len(x)] for start in self._starts], axis=1)
        return np.asarray(taps @ self._weight + self._bias)
