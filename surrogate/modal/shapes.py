"""Shapes of the modal network's arrays, checked where weights are read: the run time indexes them without looking."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...lhm.base.checks import array_of_kind, finite, shape
from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Surface
from .features import EFFECTS, Features

LARGEST = 1e4
"""Of any number in the network: the shipped one ends at 40, float16 ends at 65,504."""
WEIGHTS = 52
_LAYERS: dict[str, tuple[str, str]] = {
    "gain_in": ("wide", "local+position"),
    "gain_middle": ("wide", "wide"),
    "gain_out": ("modes", "wide"),
    "lag": ("one", "wide"),
    "effect_gain": ("effects", "wide"),
    "effect_level.0": ("level", "summary"),
    "effect_level.2": ("effects", "level"),
    "settled.0": ("settled_a", "summary"),
    "settled.2": ("settled_b", "settled_a"),
    "settled.4": ("settled", "settled_b"),
    "relaxed.0": ("relaxed_a", "summary"),
    "relaxed.2": ("relaxed_b", "relaxed_a"),
    "relaxed.4": ("relaxed", "relaxed_b"),
    "response_summary.0": ("response_a", "summary"),
    "response_summary.2": ("response_b", "response_a"),
    "response_gain": ("responses", "response_b"),
    "response_mix": ("mixed", "response_b"),
    "remainder_summary.0": ("remainder_a", "summary"),
    "remainder_gain": ("remainder", "remainder_a"),
    "remainder_modulation": ("twice", "remainder_a"),
    "remainder_in": ("expression", "weights"),
    "remainder_middle": ("middle", "expression"),
}
"""Rows and columns of each layer with a bias; equal names are equal sizes."""
_ARRAYS: dict[str, tuple[str, ...]] = {
    "modes.0": ("settled", "n", "xyz"),
    "modes.1": ("relaxed", "n", "xyz"),
    "modes.2": ("responses", "n", "xyz"),
    "modes.3": ("remainder", "n", "xyz"),
    "size_settled": ("settled",),
    "size_relaxed": ("relaxed",),
    "size_responses": ("responses",),
    "size_remainder": ("remainder",),
    "effects": ("parts", "each", "n", "xyz"),
    "position": ("n", "position"),
    "gain_code.weight": ("wide", "code"),
    "settled_linear.weight": ("settled", "summary"),
    "relaxed_linear.weight": ("relaxed", "summary"),
    "response_table": ("weights", "responses"),
    "response_tables": ("mixed", "weights", "responses"),
    "remainder_out.weight": ("remainder", "middle"),
    "remainder_linear.weight": ("remainder", "weights"),
    **{f"{name}.weight": sizes for name, sizes in _LAYERS.items()},
    **{f"{name}.bias": sizes[:1] for name, sizes in _LAYERS.items()},
}


def check_network(network: Mapping[str, np.ndarray], mean: Surface, code_size: int) -> None:
    """Raise InputError unless a network has every array, of fitting shapes, finite and none beyond LARGEST."""
    missing = sorted(set(_ARRAYS) ^ set(network))
    if missing:
        word = "missing" if missing[0] in _ARRAYS else "not known"
        raise InputError(f"array {missing[0]!r} of the network is {word}")
    for name in _ARRAYS:
        finite(f"network {name}", array_of_kind(f"network {name}", network[name], "f", "real numbers"), most=LARGEST)
    own = {
        name: len(array)
        for name, array in (
            ("settled", network["size_settled"]),
            ("relaxed", network["size_relaxed"]),
            ("responses", network["size_responses"]),
            ("remainder", network["size_remainder"]),
            ("position", network["position"].T),
            ("expression", network["remainder_in.bias"]),
        )
        if array.ndim
    }
    if len(own) < 6:
        raise InputError("network: the size of a layer is no list")
    sizes = _sizes(Features(mean), code_size, **own)
    for name, wanted in _ARRAYS.items():
        shape(f"network {name}", network[name], tuple(sizes.get(each) for each in wanted))
        for each, size in zip(wanted, network[name].shape, strict=True):
            if not sizes.setdefault(each, size) == size > 0:
                raise InputError(f"network {name}: {size} where others have {sizes[each]}")


def array_shapes(features: Features, code_size: int, *, other: int, **own: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array by name, of a network whose hidden layers have `other` units.

    own: settled, relaxed, responses, remainder (modes of each part), position (numbers of a vertex's own).
    """
    sizes = _sizes(features, code_size, expression=other, **own)
    return {name: tuple(sizes.get(each, other) for each in wanted) for name, wanted in _ARRAYS.items()}


def _sizes(
    features: Features, code_size: int, *, settled: int, relaxed: int, responses: int, remainder: int, position: int,
    expression: int,
) -> dict[str, int]:  # fmt: skip
    """The sizes that follow from the space, and those of the parts, by the names that _ARRAYS has."""
    return {
        "n": len(features.mean.vertices), "xyz": 3, "one": 1, "parts": 2, "each": EFFECTS, "effects": 2 * EFFECTS,
        "weights": WEIGHTS, "code": code_size, "summary": code_size + features.summary_size,
        "modes": settled + relaxed + responses + remainder, "settled": settled, "relaxed": relaxed,
        "responses": responses, "remainder": remainder, "twice": 2 * expression, "expression": expression,
        "position": position, "local+position": features.local_size + position,
    }  # fmt: skip
