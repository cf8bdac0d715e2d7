"""Tables of every vertex, linear in w or in effects of p, which small networks mix.

    R_j(v) = g(v) Σ_k φ_k(v) M_kj(v) - l(v) S_j(v)
    o(v)   = Σ_b b Σ_c h_c C_cb(v) + Σ_e e(v) Σ_k ψ_k(v) N_ke(v)

Responses R and offset o have a network each. φ and ψ, the gain g and the lag l come from p at the vertex, the code and
the vertex' place; the last φ and the last ψ are 1. l is `Features.give` times such a gain; S_j are the person's shapes.
How far scaled bones b carry a skin is linear in the code h, whose first number is 1 here, but for 0.5 %; what physics
adds are effects e(v) of p, so nothing of p that moves no neutral face moves it here.
For given φ and ψ the best tables follow by ridge regression at each vertex: see `table_training`. A file has tables in
whole numbers of one byte and a scale for each column and vertex: their principal components would need a rank above
500 for the same error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.kernels import njit
from ...lhm.base.mesh import Floats, Floats32
from ..rigs.rig import WEIGHTS, silu
from .features import BONES, EFFECTS, GIVE, Features
from .layers import EVERY, Arrays, concatenate, exp, layer_shapes, linear

WITHOUT_BIAS = ("response_code", "effect_code")
QUIET = ("lag", "response_gain")
"""Layers that begin near zero."""
MIXERS = ("response", "effect")
"""The networks that mix tables, by the names that their arrays begin with."""
IN_FILE = ("_table", "_scale", "carry_mean")
"""Ends of these arrays' names."""


class Tables(NamedTuple):
    """Responses M (k, 52, n, 3), effects N (k, EFFECTS, n, 3), and how bones carry C (1 + c, BONES, n, 3) [mm]."""

    responses: Floats32
    effects: Floats32
    carry: Floats32


@dataclass(frozen=True)
class TableSizes:
    """Sizes, each with its reason; InputError for one that is not positive."""

    response_tables: int = 28  # besides the one that always counts: 34 leave a fiftieth less
    effect_tables: int = 10  # likewise
    response: int = 256  # hidden width of the shares of responses' tables, which every vertex evaluates at bind
    effect: int = 128  # hidden width of the shares of effects' tables, likewise
    position: int = 16  # place of a vertex

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, int) or value < 1:
                raise InputError(f"network {name}: expected a positive integer, got {value!r}")


def mixer_layers(name: str, position: int, code_size: int, width: int) -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of the layers with which network `name` sees vertices."""
    at_vertex = Features.local_size + position
    return {f"{name}_in": (width, at_vertex), f"{name}_code": (width, code_size), f"{name}_middle": (width, width)}


def table_layers(sizes: TableSizes, code_size: int) -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of each layer, in the order in which training draws them."""
    return {
        **mixer_layers("response", sizes.position, code_size, sizes.response),
        "response_share": (sizes.response_tables, sizes.response),
        "response_gain": (1, sizes.response),
        "lag": (1, sizes.response),
        **mixer_layers("effect", sizes.position, code_size, sizes.effect),
        "effect_share": (sizes.effect_tables, sizes.effect),
    }


def table_shapes(sizes: TableSizes, vertices: int, code_size: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of tables and of what mixes them."""
    return {
        **{f"{name}_position": (vertices, sizes.position) for name in MIXERS},
        "response_table": (sizes.response_tables + 1, WEIGHTS, vertices, 3),
        "response_scale": (WEIGHTS, vertices),
        "effect_table": (sizes.effect_tables + 1, EFFECTS, vertices, 3),
        "effect_scale": (EFFECTS, vertices),
        **layer_shapes(table_layers(sizes, code_size), WITHOUT_BIAS),
        "carry_mean": (BONES, vertices, 3),
        "carry_table": (code_size, BONES, vertices, 3),
        "carry_scale": (BONES, vertices),
    }


def see_vertices(network: Arrays, name: str, local, code, vertices=EVERY):
    """Return what network `name` makes of some vertices, (..., v, wide), of local features (..., v, f) and codes."""
    weight = network[f"{name}_in.weight"]
    place = network[f"{name}_position"][vertices] @ weight[:, local.shape[-1] :].T + network[f"{name}_in.bias"]
    hidden = silu(local @ weight[:, : local.shape[-1]].T + place + code @ network[f"{name}_code.weight"].T)
    return silu(linear(network, f"{name}_middle", hidden) + hidden)


def _share(network: Arrays, name: str, hidden):
    shares = linear(network, f"{name}_share", hidden)
    return concatenate([shares, 1.0 + 0.0 * shares[..., :1]])


def mix_responses(network: Arrays, local, code, vertices=EVERY):
    """Return g φ (..., v, k) and the lag (..., v, 1) at some vertices, of local features (..., v, f) and codes."""
    hidden = see_vertices(network, "response", local, code, vertices)
    shares = _share(network, "response", hidden) * exp(linear(network, "response_gain", hidden))
    return shares, local[..., [GIVE]] * (1.0 + linear(network, "lag", hidden))


def mix_effects(network: Arrays, local, code, effects, vertices=EVERY):
    """Return ψ_k e_e (..., v, k EFFECTS) at some vertices, of local features, codes and effects (..., v, EFFECTS)."""
    shares = _share(network, "effect", see_vertices(network, "effect", local, code, vertices))
    strengths = shares[..., :, None] * effects[..., None, :]
    return strengths.reshape(*strengths.shape[:-2], -1)


def scale_bones(codes, bones):
    """Return b h_c (..., (1 + c) BONES), of codes (..., c) and by how much bones are scaled (..., BONES)."""
    factors = concatenate([1.0 + 0.0 * codes[..., :1], codes])
    scaled = factors[..., :, None] * bones[..., None, :]
    return scaled.reshape(*scaled.shape[:-2], -1)


def find_first_order(
    network: Arrays,
    tables: Tables,
    features: Features,
    code: Floats,
    at_vertices: Floats,
    shapes: np.ndarray,
) -> tuple[Floats32, Floats32]:
    """Return offset (n, 3) and responses (52, n, 3) [mm] of a person under parameters mapped to [-1, 1] at vertices.

    tables: of `expand`. code (c,): normalised. at_vertices: shape (n, P). shapes: what the 52 weights add to the skin
    [mm], shape (52, n, 3).
    """
    local, code = features.local(at_vertices), code.astype(np.float32)
    shares, lag = mix_responses(network, local, code)
    strengths = mix_effects(network, local, code, features.effects(at_vertices))
    offset = np.einsum("ve,evc->vc", strengths, tables.effects.reshape(-1, *tables.effects.shape[2:]))
    scaled = scale_bones(code, features.bones(at_vertices))
    offset += np.tensordot(scaled, tables.carry.reshape(len(scaled), -1), axes=1).reshape(offset.shape)
    return offset, find_responses(tables.responses, shares, lag, shapes.astype(np.float32, copy=False))


def find_responses(tables: Floats32, shares: Floats32, lag: Floats32, shapes: Floats32) -> Floats32:
    """Return what each weight adds to T - S [mm], shape (52, n, 3), besides shapes (52, n, 3).

    tables: shape (k, 52, n, 3); shares (n, k) and lag (n, 1) of `mix_responses`.
    """
    answer = -lag * shapes
    _add_mixed(tables, np.ascontiguousarray(shares), answer)
    return answer


@njit(cache=True, fastmath=True)
def _add_mixed(tables, shares, answer):
    """Add tables (k, 52, n, 3), weighted at each vertex by shares (n, k), to an answer (52, n, 3)."""
    for j in range(answer.shape[0]):
        for k in range(len(tables)):
            for v in range(answer.shape[1]):
                for c in range(3):
                    answer[j, v, c] += shares[v, k] * tables[k, j, v, c]


def expand(network: Arrays) -> Tables:
    """Return the tables of a file's network."""

    def read(name: str) -> Floats32:
        table: Floats32 = network[f"{name}_table"] * network[f"{name}_scale"][..., None]
        return table

    carry = np.concatenate([network["carry_mean"][None], read("carry")])
    return Tables(read("response"), read("effect"), carry)


def compress(tables: Tables) -> dict[str, Floats32]:
    """Return NAME_table, whole numbers of [-127, 127], and NAME_scale, shape (columns, n), of each.

    How bones carry the mean face, by far the largest of all, is `carry_mean`.
    """
    arrays = {"carry_mean": tables.carry[0]}
    kept = {"response": tables.responses, "effect": tables.effects, "carry": tables.carry[1:]}
    for name, table in kept.items():
        scale = np.maximum(np.abs(table).max(axis=(0, 3)) / 127.0, 1e-7).astype(np.float16).astype(np.float32)
        arrays[f"{name}_table"] = np.rint(table / scale[..., None]).clip(-127, 127)
        arrays[f"{name}_scale"] = scale
    return arrays
