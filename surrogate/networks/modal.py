"""The modal network: offset, responses and remainder of a face in modes whose gains follow p and h locally.

    T - S = Σ_i [Σ_e e(v) (d_ie + g_ie(v)) E_ie(v) + Σ_k a_ik g_k(v) B_k(v)] + Σ_j w_j R_j(v) + Σ_k N_k(w) g_k(v) B_k(v)

with effects e(v) of p at a vertex (see `Features.effects`) and tables E_i of what they do to the mean face in each of
NEUTRAL, modes B_k (n, 3) of each of PARTS, gains g(v) from p at the vertex, the code and a trained position of the
vertex, responses R_j (see `response_tables`), and amplitudes a, d and N from a summary of p and h; N(0) = 0, and
e = a = 0 where nothing of p moves the neutral face.
What has settled is the same with a palsy as without.
The paper's L(p, h) in the vertex form of its ablation, where a separable table of modes takes the place of one network
per face.

Functions take arrays of numpy or torch. Run time has one face: features (n, f) and a summary (s,). Training has
batches of faces at some vertices: features (batch, v, f) and summaries (batch, 1, s).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Surface
from ..rigs.rig import WEIGHTS, FaceModes, Remainder, silu
from .features import EFFECTS, Features
from .layers import EVERY, Arrays, check_network, einsum, exp, layer_shapes, linear, perceptron, scale_modes
from .response_tables import MIXED, mix, responses

PARTS = ("settled", "relaxed", "remainder")
"""The neutral face that p has settled; what it relaxes to among its targets; and what is not linear in w."""
NEUTRAL = PARTS[:2]
WITHOUT_BIAS = ("gain_code", "response_code", "settled_linear", "relaxed_linear", "remainder_out", "remainder_linear")
QUIET = (
    "gain_out", "lag", "settled.4", "relaxed.4", "response_gain", "effect_gain", "effect_level.2",
    "remainder_gain", "remainder_modulation",
)  # fmt: skip
"""Layers that begin near zero."""


@dataclass(frozen=True)
class ModalConfig:
    """Sizes, each with its reason; InputError for one that is not positive."""

    settled_modes: int = 56  # what effects, gained at each vertex, leave
    relaxed_modes: int = 24  # a twentieth of the motion
    remainder_modes: int = 96  # the span of half as many leaves twice what is in it; a bound face keeps what it needs
    response_tables: int = MIXED  # 28 and a width of 192 leave an eighth less than 16 and 96
    position: int = 16  # trained position of a vertex
    local: int = 64  # hidden width of the gains, which every vertex evaluates at bind
    response: int = 256  # hidden width of the shares of the tables, likewise
    summary: int = 96  # hidden width of what the whole face evaluates
    expression: int = 256  # hidden width over w, once per frame

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, int) or value < 1:
                raise InputError(f"modal network {name}: expected a positive integer, got {value!r}")

    @property
    def modes(self) -> tuple[int, int, int]:
        """How many of each of PARTS."""
        return self.settled_modes, self.relaxed_modes, self.remainder_modes


def modal_layers(config: ModalConfig, features: Features, code_size: int) -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of each layer, in the order in which training draws them."""
    at_vertex, summary = features.local_size + config.position, code_size + features.summary_size
    settled, relaxed, remainder = config.modes
    local, response, hidden, expression = config.local, config.response, config.summary, config.expression
    return {
        "gain_in": (local, at_vertex),
        "gain_code": (local, code_size),
        "gain_middle": (local, local),
        "gain_out": (sum(config.modes), local),
        "effect_gain": (2 * EFFECTS, local),
        "effect_level.0": (hidden, summary),
        "effect_level.2": (2 * EFFECTS, hidden),
        "settled_linear": (settled, summary),
        "settled.0": (2 * hidden, summary),
        "settled.2": (2 * hidden, 2 * hidden),
        "settled.4": (settled, 2 * hidden),
        "relaxed_linear": (relaxed, summary),
        "relaxed.0": (hidden, summary),
        "relaxed.2": (hidden, hidden),
        "relaxed.4": (relaxed, hidden),
        "response_in": (response, at_vertex),
        "response_code": (response, code_size),
        "response_middle": (response, response),
        "response_share": (config.response_tables, response),
        "response_gain": (1, response),
        "lag": (1, response),
        "remainder_summary.0": (hidden, summary),
        "remainder_gain": (remainder, hidden),
        "remainder_modulation": (2 * expression, hidden),
        "remainder_in": (expression, WEIGHTS),
        "remainder_middle": (expression // 2, expression),
        "remainder_out": (remainder, expression // 2),
        "remainder_linear": (remainder, WEIGHTS),
    }


def modal_shapes(config: ModalConfig, features: Features, code_size: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of a network: of its tables, then of its layers."""
    n, layers = len(features.mean.vertices), modal_layers(config, features, code_size)
    return {
        "effects": (len(NEUTRAL), EFFECTS, n, 3),
        **{f"modes.{number}": (count, n, 3) for number, count in enumerate(config.modes)},
        **{f"size_{part}": (count,) for part, count in zip(PARTS, config.modes, strict=True)},
        "position": (n, config.position),
        "response_position": (n, config.position),
        "response_table": (config.response_tables + 1, WEIGHTS, n, 3),
        "response_scale": (WEIGHTS, n),
        **layer_shapes(layers, WITHOUT_BIAS),
    }


def check_modal(network: Mapping[str, np.ndarray], sizes: Mapping[str, int], mean: Surface, code_size: int) -> None:
    """Raise InputError unless a network has every array, of the shapes that sizes of ModalConfig ask, and finite."""
    check_network(network, modal_shapes(ModalConfig(**sizes), Features(mean), code_size))


def hidden_features(network: Arrays, local, code, vertices=EVERY):
    """Return what gains follow from at some vertices, shape (..., v, wide), of local features and codes."""
    weight = network["gain_in.weight"]
    place = network["position"][vertices] @ weight[:, local.shape[-1] :].T + network["gain_in.bias"]
    hidden = silu(local @ weight[:, : local.shape[-1]].T + place + code @ network["gain_code.weight"].T)
    return silu(linear(network, "gain_middle", hidden) + hidden)


def basis(network: Arrays, part: int, hidden, vertices=EVERY):
    """Return g_k(v) B_k(v) of one of PARTS by number, shape (..., k, 3 v)."""
    modes = network[f"modes.{part}"]
    begin = sum(len(network[f"modes.{earlier}"]) for earlier in range(part))
    gains = 1.0 + linear(network, "gain_out", hidden, slice(begin, begin + len(modes)))
    scaled = scale_modes(gains, modes[:, vertices], float(1.0 / np.sqrt(3 * modes.shape[1])))
    return scaled.reshape(*scaled.shape[:-2], -1)


def neutral(network: Arrays, part: int, hidden, summary, unmoved, effects, vertices=EVERY):
    """Return one of NEUTRAL by number at some vertices [mm], shape (..., v, 3): effects (..., v, EFFECTS), then modes.

    unmoved: the summary of the same face with nothing moved, where the answer is zero.
    """
    name, columns = NEUTRAL[part], slice(part * EFFECTS, (part + 1) * EFFECTS)
    bent = perceptron(network, name, summary) - perceptron(network, name, unmoved)
    amplitudes = (summary - unmoved) @ network[f"{name}_linear.weight"].T + bent * network[f"size_{name}"]
    level = linear(network, "effect_level.2", silu(linear(network, "effect_level.0", summary)), columns)
    strength = effects * (1.0 + linear(network, "effect_gain", hidden, columns) + level)
    first = einsum("...ve,evc->...vc", strength, network["effects"][part][:, vertices])
    return first + (amplitudes @ basis(network, part, hidden, vertices)).reshape(first.shape)


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


class SeenFace(NamedTuple):
    """What the network sees of a face.

    local (n, f): features of p at vertices; hidden (n, wide): what gains follow from. summary (s,) of the whole face;
    unmoved (s,): that of the same face with nothing moved.
    """

    local: Floats32
    hidden: Floats32
    summary: Floats32
    unmoved: Floats32


def see_face(network: Arrays, features: Features, code: Floats, at_vertices: Floats) -> SeenFace:
    """Evaluate what the network sees of a normalised code (c,) and of parameters at vertices (n, P)."""
    local = features.local(at_vertices)
    hidden = hidden_features(network, local, code.astype(np.float32))
    unmoved = features.summary(code, features.unmoved(at_vertices))
    return SeenFace(local, hidden, features.summary(code, at_vertices), unmoved)


def bind_modal(
    network: Arrays,
    tables: Floats32,
    features: Features,
    code: Floats,
    skin: Floats,
    at_vertices: Floats,
    shapes: np.ndarray,
) -> FaceModes:
    """Return offset, responses and remainder of a person under parameters mapped to [-1, 1] at vertices (n, P).

    tables: of `response_tables.expand`. code (c,): normalised. skin: the person's neutral one [mm], shape (n, 3);
    shapes: what the 52 weights add to it, shape (52, n, 3).
    """
    now = see_face(network, features, code, at_vertices)
    settling = features.without_palsy(at_vertices)
    has_palsy = not np.array_equal(settling, at_vertices)
    rest = see_face(network, features, code, settling) if has_palsy else now
    effects = features.effects(at_vertices, skin)
    settled: Floats32 = neutral(network, 0, rest.hidden, rest.summary, rest.unmoved, effects)
    offset = settled + neutral(network, 1, now.hidden, now.summary, now.unmoved, effects)
    shares, lag = mix(network, now.local, code.astype(np.float32))
    return FaceModes(
        offset=offset,
        responses=responses(tables, shares, lag, shapes.astype(np.float32, copy=False)),
        modes=basis(network, 2, now.hidden).reshape(-1, *skin.shape),
        remainder_of=remainder(network, now.summary),
    )
