"""SoftDECA's hypernetwork: z_t = f_w(w_t) and L_i = f_ph(p, h, π(i)) (Eq. 18-20), in its printed form and in ours.

The printed form is Eq. 18 and 19 and nothing else: two perceptrons and a trained table π.

Ours has three parts of L that add up or scale, all gone after L is computed: a table B_i of the corpus' principal
deformation gradients, a perceptron of (p, h, π(i)) that adapts it locally, and gains exp(g(p, h)) per latent, since
answers scale with powers of stiffness ratios: L_i = gains ⊙ (B_i + MLP). A few hundred frames are enough only with the
table and the gains.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32
from ..rigs.rig import WEIGHTS
from .gradients import Bound, GradientForm, Sizes
from .layers import Arrays, concatenate, einsum, elu, exp, linear, perceptron, perceptron_layers


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
        hidden = _list_printed_features(network, code[:, None], parameters[:, None])
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


class Hypernetwork(GradientForm):
    """Ours: a table, gains and a small perceptron; see the module."""

    kind = "hypernetwork"
    without_bias = ("expression_linear", "from_position", "from_code", "last")
    quiet = {"expression.4.weight": 0.1, "last.weight": 0.0, "gain.2.weight": 0.1, "gain.2.bias": 0.0}

    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        """See `GradientForm`. Most of what tissue does is linear in the weights."""
        widths, hidden = sizes.widths, sizes.widths.hidden
        return {
            "expression_linear": (widths.latent, WEIGHTS),
            "expression.4": (widths.latent, widths.expression),
            "expression.0": (widths.expression, WEIGHTS),
            "expression.2": (widths.expression, widths.expression),
            "gain.2": (widths.latent, widths.gain),
            "gain.0": (widths.gain, sizes.parameters + sizes.code),
            "from_position": (hidden, widths.position),
            "from_code": (hidden, sizes.code),
            "from_parameters": (hidden, sizes.parameters),
            "middle": (hidden, hidden),
            "last": (9 * widths.latent, hidden),
        }

    def tables(self, sizes: Sizes) -> dict[str, tuple[int, ...]]:
        """See `GradientForm`. scale: the table's size, by which Adam steps all weights alike."""
        return {"table": (sizes.widths.latent, sizes.faces, 9), **super().tables(sizes), "scale": (1,)}

    def gradients(self, network: Arrays, weights, code, parameters):
        """See `GradientForm`: z meets the last layer before the faces do."""
        code, parameters = code[:, None], parameters[:, None]
        latent = _latent(network, weights) * _latent_gains(network, code, parameters)
        count = latent.shape[-1]
        contracted = einsum("gml,lch->gmhc", latent, network["last.weight"].reshape(count, 9, -1))
        table = network["table"].reshape(count, -1)
        local = _features(network, code, parameters)[:, None] @ contracted
        return (latent @ table).reshape(*latent.shape[:2], -1, 9) + local

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: L is all of it."""
        hidden = _features(network, code, parameters)
        local = (hidden @ network["last.weight"].T).reshape(len(hidden), -1, 9).transpose(0, 2, 1)
        gains = _latent_gains(network, code, parameters)
        latents = np.ascontiguousarray((network["table"].transpose(1, 2, 0) + local) * gains[..., None, :])
        return lambda weights: (latents, _latent(network, weights))


def _latent(network: Arrays, weights):
    """Return z_t = f_w(w_t), shape (..., latent), of weights (..., 52)."""
    return perceptron(network, "expression", weights, elu) + weights @ network["expression_linear.weight"].T


def _latent_gains(network: Arrays, code, parameters):
    """Return the table's size times exp(g(p, h)), shape (..., latent)."""
    everywhere = code + 0.0 * parameters[..., :1]
    return network["scale"] * exp(perceptron(network, "gain", concatenate([parameters, everywhere]), elu))


def _features(network: Arrays, code, parameters):
    """Return f_ph's last hidden layer at all faces, shape (..., faces, hidden).

    Of a normalised code (c,) and parameters (k,) or (faces, k); of a batch (b, 1, c) and (b, 1, k).
    """
    first = network["position"] @ network["from_position.weight"].T
    first = first + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters))
    return elu(linear(network, "middle", elu(first)))
