"""The modal network: offset and responses of a face by tables, and a remainder in modes whose gains follow p and h.

    T - S = o(v) + Σ_j w_j R_j(v) + Σ_k N_k(w) g_k(v) B_k(v)

with offset o and responses R_j of `tables`, modes B_k (n, 3), gains g(v) from p at the vertex, the code and a trained
position of the vertex, and amplitudes N from a summary of p and h; N(0) = 0.
The paper's L(p, h) in the vertex form of its ablation, where separable tables take the place of one network per face.

Functions take arrays of numpy or torch. Run time has one face: features (n, f) and a summary (s,). Training has
batches of faces at some vertices: features (batch, v, f) and summaries (batch, 1, s).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Floats32
from ..rigs.rig import WEIGHTS, FaceModes, Remainder, silu
from .features import Features
from .layers import EVERY, Arrays, exp, layer_shapes, linear, scale_modes
from .tables import TableSizes, mixer_layers, see_vertices, table_shapes

WITHOUT_BIAS = ("gain_code", "remainder_out", "remainder_linear")
QUIET = ("gain_out", "remainder_gain", "remainder_modulation")
"""Layers that begin near zero."""


@dataclass(frozen=True)
class ModalConfig(TableSizes):
    """Sizes, each with its reason; InputError for one that is not positive."""

    modes: int = 96  # the span of half as many leaves twice what is in it; a bound face keeps what it needs
    local: int = 64  # hidden width of the modes' gains, which every vertex evaluates at bind
    summary: int = 96  # hidden width of what the whole face evaluates
    expression: int = 256  # hidden width over w, once per frame


def remainder_layers(config: ModalConfig, features: Features, code_size: int) -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of each layer but those of tables, in the order in which training draws them."""
    hidden, expression = config.summary, config.expression
    return {
        **mixer_layers("gain", config.position, code_size, config.local),
        "gain_out": (config.modes, config.local),
        "remainder_summary.0": (hidden, code_size + features.summary_size),
        "remainder_gain": (config.modes, hidden),
        "remainder_modulation": (2 * expression, hidden),
        "remainder_in": (expression, WEIGHTS),
        "remainder_middle": (expression // 2, expression),
        "remainder_out": (config.modes, expression // 2),
        "remainder_linear": (config.modes, WEIGHTS),
    }


def modal_shapes(config: ModalConfig, features: Features, code_size: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of a network."""
    n, layers = len(features.mean.vertices), remainder_layers(config, features, code_size)
    return {
        **table_shapes(config, n, code_size),
        "modes": (config.modes, n, 3),
        "size_remainder": (config.modes,),
        "gain_position": (n, config.position),
        **layer_shapes(layers, WITHOUT_BIAS),
    }


def basis(network: Arrays, local, code, vertices=EVERY):
    """Return g_k(v) B_k(v) at some vertices, shape (..., k, 3 v), of local features (..., v, f) and codes."""
    modes = network["modes"]
    gains = 1.0 + linear(network, "gain_out", see_vertices(network, "gain", local, code, vertices))
    scaled = scale_modes(gains, modes[:, vertices], float(1.0 / np.sqrt(3 * modes.shape[1])))
    return scaled.reshape(*scaled.shape[:-2], -1)


def remainder(network: Arrays, summary) -> Remainder:
    """Return the amplitudes N(w) as two layers over w, with all that depends on p and h multiplied out."""
    hidden = silu(linear(network, "remainder_summary.0", summary))
    modulation = linear(network, "remainder_modulation", hidden)
    width = modulation.shape[-1] // 2
    gain, shift = 1.0 + modulation[..., :width], modulation[..., width:]
    size = exp(linear(network, "remainder_gain", hidden)) * network["size_remainder"]
    return Remainder.from_layers(
        inner=network["remainder_in.weight"].T * gain,
        inner_bias=network["remainder_in.bias"] * gain + shift,
        middle=network["remainder_middle.weight"].T,
        middle_bias=network["remainder_middle.bias"],
        outer=network["remainder_out.weight"].T * size,
        linear=network["remainder_linear.weight"].T * size,
    )


def bind_modal(
    network: Arrays, first: tuple[Floats32, Floats32], features: Features, code: Floats, at_vertices: Floats
) -> FaceModes:
    """Return offset, responses and remainder of a person under parameters mapped to [-1, 1] at vertices (n, P).

    first: offset (n, 3) and responses (52, n, 3) [mm]; see `tables.find_first_order`. code (c,): normalised.
    """
    offset, responses = first
    code = code.astype(np.float32)
    return FaceModes(
        offset=offset,
        responses=responses,
        modes=basis(network, features.local(at_vertices), code).reshape(-1, *offset.shape),
        remainder_of=remainder(network, features.summary(code, at_vertices)),
    )
