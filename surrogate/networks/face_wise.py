"""SoftDECA's ablation without a bound part: one perceptron at every face, evaluated in every frame."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32
from ..rigs.rig import WEIGHTS
from .gradients import Bound, GradientForm, Sizes
from .layers import Arrays, elu, linear, perceptron, perceptron_layers


class FaceWise(GradientForm):
    """J_i - I = f(f_w(w), p, h, π(i)), nine numbers of each face."""

    kind = "face-wise"
    without_bias = ("from_position", "from_latent", "from_code")
    quiet = {"middle.2.weight": 0.02, "middle.2.bias": 0.02}

    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        """See `GradientForm`. The first layer at the faces is in four parts, which add up."""
        widths, hidden = sizes.widths, sizes.widths.hidden
        return {
            **perceptron_layers("expression", WEIGHTS, widths.expression, widths.expression, widths.latent),
            "from_position": (hidden, widths.position),
            "from_latent": (hidden, widths.latent),
            "from_code": (hidden, sizes.code),
            "from_parameters": (hidden, sizes.parameters),
            **perceptron_layers("middle", hidden, hidden, 9),
        }

    def gradients(self, network: Arrays, weights, code, parameters):
        bound = _bound(network, code[:, None, None], parameters[:, None])
        return _answer(network, bound, weights[:, :, None])

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: only the first layer's part of p, h and π is bound."""
        bound, one = _bound(network, code, parameters), np.ones(1, dtype=np.float32)
        return lambda weights: (np.ascontiguousarray(_answer(network, bound, weights)[:, :, None]), one)


def _bound(network: Arrays, code, parameters):
    place = network["position"] @ network["from_position.weight"].T
    return place + (code @ network["from_code.weight"].T + linear(network, "from_parameters", parameters))


def _answer(network: Arrays, bound, weights):
    latent = perceptron(network, "expression", weights, elu)
    return perceptron(network, "middle", elu(bound + latent @ network["from_latent.weight"].T), elu)
