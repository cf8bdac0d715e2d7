"""The learned coefficients of SoftDECA's Eq. 21, f_t = γ F(w_t) + 2α f_{t-1} - β f_{t-2}, at each vertex.

γ and β are networks f_γ and f_β of p, h and a trained table π at the vertex (Eq. 20), bound once. The paper has a
third, f_α. Here α = (1 - γ + β)/2: only so a shift of everything stays a shift, and a face at rest stays where statics
have it; with γ in (0, 1] and β below 1 every pole lies inside the unit circle. The paper states neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from ..corpus.mixture import NAMES
from ..corpus.plan import RATE
from ..rigs.inertia import LearnedSwing
from ..rigs.rig import silu
from .layers import Arrays, exp, linear, perceptron, perceptron_layers

COEFFICIENTS = ("beta", "gamma")
WITHOUT_BIAS = tuple(f"{name}_{layer}" for name in COEFFICIENTS for layer in ("from_position", "from_code"))
MOST = 0.98
"""Largest |β|: beyond it an oscillation takes seconds to fade."""


def recurrence_layers(code_size: int, position: int, hidden: int) -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of each layer, in the order in which training draws them.

    position: length of π at a vertex. hidden: width of f_β and f_γ.
    """
    layers: dict[str, tuple[int, int]] = {}
    for name in COEFFICIENTS:
        layers |= {
            f"{name}_from_position": (hidden, position),
            f"{name}_from_code": (hidden, code_size),
            f"{name}_from_parameters": (hidden, len(NAMES)),
            **perceptron_layers(f"{name}_rest", hidden, hidden, 1),
        }
    return layers


def coefficients(network: Arrays, code, parameters):
    """Return β and γ, shape (..., n), of a normalised code (..., 1, c) and of NAMES in [-1, 1] at vertices."""
    values = []
    for name, most in zip(COEFFICIENTS, (MOST, 1.0), strict=True):
        hidden = network["position"] @ network[f"{name}_from_position.weight"].T
        hidden = hidden + code @ network[f"{name}_from_code.weight"].T
        hidden = silu(hidden + linear(network, f"{name}_from_parameters", parameters))
        logits = perceptron(network, f"{name}_rest", hidden)[..., 0]
        values.append(most / (1.0 + exp(-logits)))
    return tuple(values)


@dataclass(frozen=True, eq=False)
class LearnedRecurrence:
    """π and the layers of f_β and f_γ, and what heads turn about: pivot (3,) [mm], that of the mean head."""

    network: Mapping[str, np.ndarray]
    pivot: Floats

    def bind(self, code: Floats, at_vertices: Floats) -> LearnedSwing:
        """Evaluate α, β, γ of a normalised code (c,) and of NAMES in [-1, 1] at vertices (n, P)."""
        beta, gamma = coefficients(
            self.network, np.asarray(code, dtype=np.float32)[None], np.asarray(at_vertices, dtype=np.float32)
        )
        return LearnedSwing(beta, np.maximum(gamma, 1e-6), self.pivot, 1.0 / RATE)
