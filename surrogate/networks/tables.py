"""Tables of every vertex, linear in w or in effects of p, which small networks mix.

    R_j(v) = g(v) Σ_k φ_k(v) M_kj(v) - l(v) S_j(v)
    o(v)   = Σ_b b Σ_c h_c C_cb(v) + Σ_e g_e(v) e(v) Σ_k ψ_k(v) N_ke(v)

Responses R and offset o have a network each. φ and ψ, gains g and the lag l come from p at the vertex, the code and
the vertex' place; the last φ and the last ψ are 1. Gains are exponentials: a skin whose targets are weak moves ten
times as far. l is `Features.give` times a gain; S_j are the person's shapes.
How far scaled bones b carry a skin is linear in the code h, whose first number is 1 here, but for 0.5 %; what physics
adds are effects e(v) of p, so nothing of p that moves no neutral face moves it here.
For given φ and ψ the best tables follow by ridge regression at each vertex: see `table_training`. What a vertex shows
of them is of low rank, high at lips and lids, nearly none at the scalp. So M and N are kept as products, of as many
components at each vertex as count: M_kj(v) = Σ_r A_kr(v) B_rj(v), in whole numbers of one byte.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.kernels import njit
from ...lhm.base.mesh import Floats, Floats32, Ints
from ..rigs.rig import WEIGHTS, silu
from .features import BONES, EFFECTS, GIVE, Features
from .layers import EVERY, Arrays, concatenate, exp, layer_shapes, linear

WITHOUT_BIAS = ("response_code", "effect_code")
QUIET = ("lag", "response_gain", "effect_gain")
"""Layers that begin near zero."""
MIXERS = ("response", "effect")
"""The networks that mix tables, by the names that their arrays begin with."""
IN_FILE = ("_table", "_scale", "_first", "carry_mean")
"""Ends of these arrays' names."""


class Product(NamedTuple):
    """A table of n vertices, of some components at each: those of vertex v are first[v] to first[v + 1].

    mix (r, k) multiplies shares φ, and values (r, columns, 3) [mm] are what it mixes.
    """

    first: Ints
    mix: Floats32
    values: Floats32


class Tables(NamedTuple):
    """Responses M, effects N, and how bones carry C (1 + c, BONES, n, 3) [mm]."""

    responses: Product
    effects: Product
    carry: Floats32


@dataclass(frozen=True)
class TableSizes:
    """Sizes, each with its reason; InputError for one that is not positive."""

    response_tables: int = 96  # besides the one that always counts: with 28 a tenth more is left
    effect_tables: int = 24  # likewise
    response_components: int = 17  # kept of these at a vertex, in the mean: what a file of 30 MB has room for
    effect_components: int = 8  # likewise: three leave a tenth more than all
    response: int = 256  # hidden width of the shares of responses' tables, which every vertex evaluates at bind
    effect: int = 256  # hidden width of the shares of effects' tables, likewise
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
        "effect_gain": (EFFECTS, sizes.effect),
    }


def table_shapes(sizes: TableSizes, vertices: int, code_size: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of tables and of what mixes them."""
    tables: dict[str, tuple[int, ...]] = {}
    for name, mixed, components, columns in (
        ("response", sizes.response_tables, sizes.response_components, WEIGHTS),
        ("effect", sizes.effect_tables, sizes.effect_components, EFFECTS),
    ):
        kept = min(components, mixed + 1, 3 * columns) * vertices
        tables |= {
            f"{name}_first": (vertices + 1,),
            f"{name}_mix_table": (kept, mixed + 1),
            f"{name}_table": (kept, columns, 3),
            f"{name}_scale": (kept,),
        }
    return {
        **{f"{name}_position": (vertices, sizes.position) for name in MIXERS},
        **tables,
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
    """Return ψ (..., v, k) and g_e e (..., v, EFFECTS) at some vertices, of local features, codes and effects there."""
    hidden = see_vertices(network, "effect", local, code, vertices)
    return _share(network, "effect", hidden), effects * exp(linear(network, "effect_gain", hidden))


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
    responses = -lag * shapes.astype(np.float32, copy=False)
    add_mixed(tables.responses, shares, responses)
    of_effects = np.zeros((EFFECTS, len(local), 3), dtype=np.float32)
    of_tables, strengths = mix_effects(network, local, code, features.effects(at_vertices))
    add_mixed(tables.effects, of_tables, of_effects)
    scaled = scale_bones(code, features.bones(at_vertices))
    offset = np.tensordot(scaled, tables.carry.reshape(len(scaled), -1), axes=1).reshape(len(local), 3)
    offset += np.einsum("ve,evc->vc", strengths, of_effects)
    return offset, responses


def add_mixed(table: Product, shares: Floats32, answer: Floats32) -> None:
    """Add a table, mixed at each vertex by shares (n, k), to an answer [mm], shape (columns, n, 3)."""
    _add_products(*table, np.ascontiguousarray(shares), answer)


@njit(cache=True, fastmath=True)
def _add_products(first, mix, values, shares, answer):
    mixed = np.empty(values.shape[1:], dtype=np.float32)
    for v in range(len(shares)):
        mixed[:] = 0.0
        for r in range(first[v], first[v + 1]):
            share = np.float32(0.0)
            for k in range(shares.shape[1]):
                share += shares[v, k] * mix[r, k]
            mixed += share * values[r]
        answer[:, v] += mixed


def expand(network: Arrays) -> Tables:
    """Return the tables of a file's network; InputError where components do not belong to vertices and shares."""

    def read(name: str) -> Product:
        values = network[f"{name}_table"] * network[f"{name}_scale"][:, None, None]
        first, mix = network[f"{name}_first"].astype(np.int64), network[f"{name}_mix_table"]
        shape = len(values), len(network[f"{name}_share.bias"]) + 1
        ends = len(first) == len(network[f"{name}_position"]) + 1 and first[0] == 0 and first[-1] == len(values)
        if mix.shape != shape or not ends or (np.diff(first) < 0).any():
            raise InputError(f"weights: the components of {name}_table are not those of its vertices")
        return Product(first, mix, values)

    coded: Floats32 = network["carry_table"] * network["carry_scale"][..., None]
    return Tables(read("response"), read("effect"), np.concatenate([network["carry_mean"][None], coded]))


def compress(tables: Tables) -> dict[str, Floats32]:
    """Return the arrays of a file: NAME_table and NAME_mix_table of whole numbers of [-127, 127], NAME_scale of each.

    How bones carry the mean face, by far the largest of all, is `carry_mean`.
    """
    mean, coded = tables.carry[0], tables.carry[1:]
    scale = np.maximum(np.abs(coded).max(axis=(0, 3)) / 127.0, 1e-7).astype(np.float16).astype(np.float32)
    arrays = {"carry_mean": mean, "carry_table": _round(coded / scale[..., None]), "carry_scale": scale}
    for name, table in (("response", tables.responses), ("effect", tables.effects)):
        largest = [np.maximum(np.abs(part).reshape(len(part), -1).max(axis=1), 1e-12) for part in table[1:]]
        of_mix, of_values = (size / 127.0 for size in largest)
        arrays |= {
            f"{name}_first": table.first.astype(np.float32),
            f"{name}_mix_table": _round(table.mix / of_mix[:, None]),
            f"{name}_table": _round(table.values / of_values[:, None, None]),
            f"{name}_scale": (of_mix * of_values).astype(np.float32),
        }
    return arrays


def _round(values: Floats32) -> Floats32:
    rounded: Floats32 = np.rint(values).clip(-127, 127).astype(np.float32)
    return rounded
