"""Layers as pure functions of named arrays, numpy's or torch's alike, so that a network is written once.

A layer `name` has `name.weight` (outputs, inputs) and `name.bias` (outputs,) among a network's arrays.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ...lhm.base.kernels import njit
from ..rigs.rig import silu

EVERY = slice(None)
Arrays = Mapping[str, Any]
"""A network: numpy's arrays at run time, torch's tensors in training."""


def layer_shapes(
    layers: Mapping[str, tuple[int, int]], without_bias: Collection[str] = ()
) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of layers, by their (outputs, inputs)."""
    weights = {f"{name}.weight": sizes for name, sizes in layers.items()}
    return weights | {f"{name}.bias": sizes[:1] for name, sizes in layers.items() if name not in without_bias}


def perceptron_layers(name: str, *widths: int) -> dict[str, tuple[int, int]]:
    """Return the (outputs, inputs) of layers `name.0`, `name.2`, ... of these widths; see `perceptron`."""
    pairs = zip(widths[:-1], widths[1:], strict=True)
    return {f"{name}.{2 * k}": (outputs, inputs) for k, (inputs, outputs) in enumerate(pairs)}


def exp(x):
    """Return e to the power of each element."""
    return np.exp(x) if isinstance(x, np.ndarray) else x.exp()


def elu(x):
    """Return x above zero, and e^x - 1 below."""
    if isinstance(x, np.ndarray):
        return np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
    from torch.nn.functional import elu as torch_elu

    return torch_elu(x)


def concatenate(parts: Sequence[Any]):
    """Join arrays along their last axis."""
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts, axis=-1)
    import torch

    return torch.cat(list(parts), dim=-1)


def einsum(formula: str, *operands):
    """Sum products by a formula, as numpy and torch both write it."""
    if isinstance(operands[0], np.ndarray):
        return np.einsum(formula, *operands)
    import torch

    return torch.einsum(formula, *operands)


def linear(network: Arrays, layer: str, x):
    """Apply a layer to inputs (..., i)."""
    return x @ network[f"{layer}.weight"].T + network[f"{layer}.bias"]


def perceptron(network: Arrays, name: str, x, activation=silu):
    """Apply layers `name.0`, `name.2`, ... with an activation between two."""
    number = 0
    while f"{name}.{number + 2}.weight" in network:
        x = activation(linear(network, f"{name}.{number}", x))
        number += 2
    return linear(network, f"{name}.{number}", x)


def scale_modes(gains, modes, scale: float):
    """Return modes (k, v, 3) times their gains at each vertex and a scale, shape (..., k, v, 3); gains (..., v, k)."""
    if isinstance(gains, np.ndarray) and gains.ndim == 2:
        return _scale_modes(np.ascontiguousarray(gains.T), modes, np.float32(scale))
    return gains.swapaxes(-1, -2)[..., None] * (modes * scale)


@njit(cache=True, fastmath=True)
def _scale_modes(gains, modes, scale):
    scaled = np.empty_like(modes)
    for k in range(len(modes)):
        for v in range(modes.shape[1]):
            gain = scale * gains[k, v]
            for c in range(3):
                scaled[k, v, c] = gain * modes[k, v, c]
    return scaled
