"""SoftDECA's hypernetwork: z_t = f_w(w_t) and L_i = f_ph(p, h, π(i)) (Eq. 18-20), in its printed form and in ours.

The printed form is Eq. 18 and 19 and nothing else: two perceptrons and a trained table π.

Ours has L_i = exp(g_i) ⊙ B_i + A_i: a table B of the corpus' principal deformation gradients, and gains and additions
of one perceptron of (p_i, h, π(i)), since answers scale with powers of stiffness ratios, and p may vary over the face.
z = f_w(w) + W w. Table and W begin by regression, so that training begins at what is linear in w.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32
from ..rigs.rig import WEIGHTS
from .gradients import Bound, GradientForm, Sizes
from .layers import EVERY, Arrays, einsum, elu, exp, linear, perceptron, perceptron_layers


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


class Hypernetwork(GradientForm):
    """Ours: z with a part that is linear in w, and a table whose gains and additions follow p and h at each face."""

    kind = "hypernetwork"
    without_bias = ("expression_linear", "from_position", "from_code", "last")
    quiet = {"expression.4.weight": 0.1, "last.weight": 0.0, "gain.weight": 0.1, "gain.bias": 0.0}

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
            "last": (9 * widths.latent, hidden),
        }

    def tables(self, sizes: Sizes) -> dict[str, tuple[int, ...]]:
        """See `GradientForm`. scale: the table's size, by which Adam steps all weights alike."""
        return {"table": (sizes.widths.latent, sizes.faces, 9), **super().tables(sizes), "scale": (1,)}

    def gradients(self, network: Arrays, weights, code, parameters):
        """See `GradientForm`."""
        return self.gradients_at(network, weights, code, parameters, EVERY)

    def gradients_at(self, network: Arrays, weights, code, parameters, faces):
        """See `GradientForm`: no other face is evaluated."""
        there = parameters if parameters.shape[1] == 1 else parameters[:, faces]
        return einsum("gml,gflc->gmfc", _latent(network, weights), _local(network, code[:, None], there, faces))

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: L is all of it."""
        latents = np.ascontiguousarray(_local(network, code, parameters, EVERY).swapaxes(-1, -2))
        return lambda weights: (latents, _latent(network, weights))


def _latent(network: Arrays, weights):
    """Return z_t = f_w(w_t), shape (..., latent), of weights (..., 52)."""
    return perceptron(network, "expression", weights, elu) + weights @ network["expression_linear.weight"].T


def _local(network: Arrays, code, parameters, faces):
    """Return L at some faces, shape (..., faces, latent, 9), of codes (..., c) and parameters (..., k)."""
    first = network["position"][faces] @ network["from_position.weight"].T
    first = first + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters))
    hidden = elu(first)
    hidden = hidden + elu(linear(network, "middle", hidden))
    gains = exp(linear(network, "gain", hidden))
    added = hidden @ network["last.weight"].T
    table = network["table"][:, faces].swapaxes(0, 1)
    return network["scale"] * (gains[..., None] * table + added.reshape(*gains.shape, 9))
