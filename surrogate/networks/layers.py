"""Layers as pure functions of named arrays, numpy's or torch's alike, so that a network is written once.

A layer `name` has `name.weight` (outputs, inputs) and `name.bias` (outputs,) among a network's arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numba
import numpy as np

from ...lhm.base.checks import array_of_kind, finite, shape
from ...lhm.base.errors import InputError
from ..rigs.rig import silu

EVERY = slice(None)
Arrays = Mapping[str, Any]
"""A network: numpy's arrays at run time, torch's tensors in training."""
LARGEST = 1e4
"""Of any number in a network: the shipped one ends at 40, float16 ends at 65,504."""


def check_numbers(network: Mapping[str, np.ndarray], names: Sequence[str]) -> None:
    """Raise InputError unless a network has the named arrays and no others, finite and none beyond LARGEST."""
    different = sorted(set(names) ^ set(network))
    if different:
        word = "missing" if different[0] in names else "not known"
        raise InputError(f"array {different[0]!r} of the network is {word}")
    for name in names:
        finite(f"network {name}", array_of_kind(f"network {name}", network[name], "f", "real numbers"), most=LARGEST)


def check_sizes(
    network: Mapping[str, np.ndarray], arrays: Mapping[str, tuple[str, ...]], sizes: Mapping[str, int]
) -> None:
    """Raise InputError unless each array has the sizes that `arrays` names; equal names are equal sizes."""
    known = dict(sizes)
    for name, expected in arrays.items():
        shape(f"network {name}", network[name], tuple(known.get(each) for each in expected))
        for each, size in zip(expected, network[name].shape, strict=True):
            if not known.setdefault(each, size) == size > 0:
                raise InputError(f"network {name}: {size} where others have {known[each]}")


def count_rows(network: Mapping[str, np.ndarray], *names: str) -> list[int]:
    """Return the lengths of arrays that tell a network's sizes; InputError for one that is a single number."""
    if not all(network[name].ndim for name in names):
        raise InputError("network: the size of a layer is no list")
    return [len(network[name]) for name in names]


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


def linear(network: Arrays, layer: str, x, rows: slice = EVERY):
    """Apply a layer to inputs (..., i), or those of its outputs that `rows` says."""
    return x @ network[f"{layer}.weight"][rows].T + network[f"{layer}.bias"][rows]


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


@numba.njit(cache=True, fastmath=True)
def _scale_modes(gains, modes, scale):
    scaled = np.empty_like(modes)
    for k in range(len(modes)):
        for v in range(modes.shape[1]):
            gain = scale * gains[k, v]
            for c in range(3):
                scaled[k, v, c] = gain * modes[k, v, c]
    return scaled
