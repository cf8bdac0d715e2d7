"""SoftDECA's hypernetwork: z_t = f_w(w_t) and L_i = f_ph(p, h, π(i)) (Eq. 18-20), as it is printed and as ours.

The printed form is Eq. 18 and 19 and nothing else: two perceptrons and a trained table π.

Ours starts from a skin that is right to first order: S is what `tables` make of the carried blendshapes, and z is zero
at w = 0. Gradients that are linear in w could not do that. J acts from the left on S, so what is right at rest is
multiplied by how S stretches, at lids by up to 2.6, and the transfer spreads it over the face: with the simulator's own
offset and responses as J, 35 % of the motion is left, and by adding them to S 7 (the preset `study`). Nor are tables of
gradients learned as well as those of displacements: the transfer turns errors that are small in J into drift of the
whole face. What is left beyond first order is small, and L begins with its principal components: L_i = g_i M_i, modes M
of each mesh face with gains g_i = exp(f_ph(p_i, h, π(i))).
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
        hidden = _list_features(network, code[:, None], parameters)
        last = network["last.weight"].reshape(latent.shape[-1], 9, -1)
        contracted = einsum("gml,lch->gmhc", latent, last)
        still = latent @ network["last.bias"].reshape(-1, 9)
        return hidden[:, None] @ contracted + still[:, :, None]

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: L is all of it."""
        hidden = _list_features(network, code, parameters)
        local = linear(network, "last", hidden).reshape(len(hidden), -1, 9)
        latents = np.ascontiguousarray(local.transpose(0, 2, 1))
        return lambda weights: (latents, perceptron(network, "expression", weights, elu))


def _list_features(network: Arrays, code, parameters):
    """Return f_ph's last hidden layer at all faces, shape (..., faces, hidden)."""
    return elu(perceptron(network, "middle", _list_inputs(network, code, parameters), elu))


def _list_inputs(network: Arrays, code, parameters):
    """Return f_ph's first hidden layer at all faces, shape (..., faces, hidden)."""
    first = network["position"] @ network["from_position.weight"].T
    return elu(first + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters)))


class Hypernetwork(GradientForm):
    """Ours: beyond first order, in modes."""

    kind = "hypernetwork"
    without_bias = ("from_position", "from_code")
    quiet = {
        "expression.4.weight": 0.1, "expression.4.bias": 0.0, "from_code.weight": 0.1,
        "gain.weight": 0.1, "gain.bias": 0.0,
    }  # fmt: skip
    has_tables = True

    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        widths, hidden = sizes.widths, sizes.widths.hidden
        return {
            **perceptron_layers("expression", WEIGHTS, widths.expression, widths.expression, widths.latent),
            "from_position": (hidden, widths.position),
            "from_code": (hidden, sizes.code),
            "from_parameters": (hidden, sizes.parameters),
            "gain": (widths.latent, hidden),
        }

    def tables(self, sizes: Sizes) -> dict[str, tuple[int, ...]]:
        """See `GradientForm`. scale: the size of modes, by which Adam steps all weights alike."""
        return {**super().tables(sizes), "modes": (sizes.faces, sizes.widths.latent, 9), "scale": (1,)}

    def gradients(self, network: Arrays, weights, code, parameters):
        latent, gains = _find_latent(network, weights), _find_gains(network, code[:, None], parameters)
        return einsum("gml,gfl,flc->gmfc", latent, gains, network["modes"])

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: L is all of it."""
        gains = _find_gains(network, code, np.atleast_2d(parameters))
        latents = np.ascontiguousarray((gains[..., None] * network["modes"]).transpose(0, 2, 1))
        return lambda weights: (latents, _find_latent(network, weights))


def _find_latent(network: Arrays, weights):
    """Return z (..., latent) of weights (..., 52), which is zero at zero."""
    moved, still = (perceptron(network, "expression", w, elu) for w in (weights, 0.0 * weights))
    return moved - still


def _find_gains(network: Arrays, code, parameters):
    """Return g (..., faces, latent) of codes (..., c) and parameters (..., 1 or faces, k)."""
    return network["scale"] * exp(linear(network, "gain", _list_inputs(network, code, parameters)))
