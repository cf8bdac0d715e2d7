"""SoftDECA's hypernetwork: z_t = f_w(w_t) and L_i = f_ph(p, h, π(i)) (Eq. 18-20), in its printed form and in ours.

The printed form is Eq. 18 and 19 and nothing else: two perceptrons and a trained table π.

Ours has J_i - I = O_i + z L_i: O_i is what p does to the face at rest, L_i what it makes of expressions. Both are sums
of tables of each mesh face. Their factors are what one perceptron makes of (p_i, h, π(i)), and for O also p_i itself;
its gains multiply L. So p may vary over the face. z = f_w(w) + W w. Tables and W begin by regression on the corpus'
faces, at what is linear in w and, at rest, in p; L's tables stay as they are.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32
from ..rigs.rig import WEIGHTS
from .gradients import Bound, GradientForm, Sizes
from .layers import Arrays, einsum, elu, exp, linear, perceptron, perceptron_layers


class PrintedHypernetwork(GradientForm):
    """Eq. 18 and 19 as they are printed."""

    kind = "printed hypernetwork"
    without_bias = ("from_position", "from_code")
    quiet = {"last.weight": 0.02, "last.bias": 0.02}

    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        """See `GradientForm`. The first layer of f_ph is in three parts: nothing is concatenated per face."""
        widths, hidden = sizes.widths, sizes.widths.hidden
        return {
            **perceptron_layers("expression", WEIGHTS, widths.expression, widths.expression, widths.latent),
            "from_position": (hidden, widths.position),
            "from_code": (hidden, sizes.code),
            "from_parameters": (hidden, sizes.parameters),
            **perceptron_layers("middle", hidden, hidden, hidden),
            "last": (9 * widths.latent, hidden),
        }

    def gradients(self, network: Arrays, weights, code, parameters):
        """See `GradientForm`: z meets the last layer before the faces do, 9 outputs per face instead of 288."""
        latent = perceptron(network, "expression", weights, elu)
        hidden = _list_printed_features(network, code[:, None], parameters)
        last = network["last.weight"].reshape(latent.shape[-1], 9, -1)
        contracted = einsum("gml,lch->gmhc", latent, last)
        still = latent @ network["last.bias"].reshape(-1, 9)
        return hidden[:, None] @ contracted + still[:, :, None]

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: L is all of it."""
        hidden = _list_printed_features(network, code, parameters)
        local = linear(network, "last", hidden).reshape(len(hidden), -1, 9)
        latents = np.ascontiguousarray(local.transpose(0, 2, 1))
        return lambda weights: (latents, perceptron(network, "expression", weights, elu))


def _list_printed_features(network: Arrays, code, parameters):
    """Return f_ph's last hidden layer at all faces, shape (..., faces, hidden)."""
    first = network["position"] @ network["from_position.weight"].T
    first = first + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters))
    return elu(perceptron(network, "middle", elu(first), elu))


RESPONSES, OFFSETS = 5, 8
"""Tables of L, of which the first has factor 1, and those of O beside that of rest and those of p."""


class Hypernetwork(GradientForm):
    """Ours: z with a part that is linear in w, and tables whose factors follow p and h at each face."""

    kind = "hypernetwork"
    without_bias = ("expression_linear", "from_position", "from_code")
    quiet = {
        "expression.4.weight": 0.1, "expression.4.bias": 0.0,
        "gain.weight": 0.1, "gain.bias": 0.0, "mixing.weight": 0.1, "mixing.bias": 0.0,
    }  # fmt: skip

    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        """See `GradientForm`. Most of what tissue does is linear in the weights."""
        widths, hidden = sizes.widths, sizes.widths.hidden
        return {
            "expression_linear": (widths.latent, WEIGHTS),
            "expression.4": (widths.latent, widths.expression),
            "expression.0": (widths.expression, WEIGHTS),
            "expression.2": (widths.expression, widths.expression),
            "from_position": (hidden, widths.position),
            "from_code": (hidden, sizes.code),
            "from_parameters": (hidden, sizes.parameters),
            "middle": (hidden, hidden),
            "gain": (widths.latent, hidden),
            "mixing": (RESPONSES - 1 + OFFSETS, hidden),
        }

    def tables(self, sizes: Sizes) -> dict[str, tuple[int, ...]]:
        """See `GradientForm`. scale: the tables' size, by which Adam steps all weights alike."""
        return {
            "responses": (sizes.faces, RESPONSES, sizes.widths.latent * 9),
            "offsets": (sizes.faces, 1 + sizes.parameters + OFFSETS, 9),
            **super().tables(sizes),
            "scale": (1,),
        }

    def gradients(self, network: Arrays, weights, code, parameters):
        """See `GradientForm`."""
        offsets, latents = _local(network, code[:, None], parameters)
        return offsets[:, None] + einsum("gml,gflc->gmfc", _latent(network, weights), latents)

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: O and L are all of it, and z begins with O's 1."""
        offsets, latents = _local(network, code, np.atleast_2d(parameters))
        both = np.concatenate([offsets[..., None], latents.swapaxes(-1, -2)], axis=-1)
        one = np.ones(1, dtype=np.float32)
        return lambda weights: (both, np.concatenate([one, _latent(network, weights)]))


def _latent(network: Arrays, weights):
    """Return z_t = f_w(w_t), shape (..., latent), of weights (..., 52)."""
    return perceptron(network, "expression", weights, elu) + weights @ network["expression_linear.weight"].T


def _local(network: Arrays, code, parameters):
    """Return O (..., faces, 9) and L (..., faces, latent, 9) of codes (..., c) and parameters (..., 1 or faces, k)."""
    first = network["position"] @ network["from_position.weight"].T
    first = first + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters))
    hidden = elu(first)
    hidden = hidden + elu(linear(network, "middle", hidden))
    gains, mixing = exp(linear(network, "gain", hidden)), linear(network, "mixing", hidden)
    tables, offsets, size = network["responses"], network["offsets"], 1 + parameters.shape[-1]
    mixed = tables[:, 0] + einsum("...fm,fmk->...fk", mixing[..., : RESPONSES - 1], tables[:, 1:])
    rest = offsets[:, 0] + einsum("...fm,fmk->...fk", parameters, offsets[:, 1:size])
    rest = rest + einsum("...fm,fmk->...fk", mixing[..., RESPONSES - 1 :], offsets[:, size:])
    scale = network["scale"]
    return scale * rest, scale * gains[..., None] * mixed.reshape(*gains.shape, 9)
