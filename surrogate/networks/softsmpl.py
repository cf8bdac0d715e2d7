"""SoftSMPL's regressor (Santesteban et al. 2020) as SoftDECA compares with it: one perceptron of w, p and h together.

The answer is the same, a deformation gradient per face. Only the conditioning differs: nothing of it is bound.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32
from ..rigs.rig import WEIGHTS
from .gradients import Bound, GradientForm, Sizes, Widths
from .layers import Arrays, concatenate, elu, perceptron, perceptron_layers

SMALL, LARGE = Widths(latent=32, expression=128), Widths(latent=256, expression=512)
"""The small one has the widths of the hypernetwork's f_w, as in the paper, which tells a large one's time alone."""


class SoftSMPL(GradientForm):
    """J - I = last(MLP(w, p, h)), the last layer linear to all faces."""

    kind = "softsmpl"
    quiet = {"last.weight": 0.02, "last.bias": 0.02}
    follows_fields = False

    def layers(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        wide, latent = sizes.widths.expression, sizes.widths.latent
        inputs = WEIGHTS + sizes.parameters + sizes.code
        return perceptron_layers("hidden", inputs, wide, wide, latent) | {"last": (9 * sizes.faces, latent)}

    def tables(self, sizes: Sizes) -> dict[str, tuple[int, ...]]:
        """See `GradientForm`: none, since no face has an input of its own."""
        return {}

    def gradients(self, network: Arrays, weights, code, parameters):
        latent = _latent(network, weights, code[:, None], parameters)
        answer = latent @ network["last.weight"].T + network["last.bias"]
        return answer.reshape(*latent.shape[:-1], -1, 9)

    def bind(self, network: Arrays, code: Floats32, parameters: Floats32) -> Bound:
        """See `GradientForm`: L is the last layer, the same for everybody, and z all of the perceptron."""
        count = network["last.weight"].shape[1]
        last = np.concatenate([network["last.weight"], network["last.bias"][:, None]], axis=1)
        latents = np.ascontiguousarray(last.reshape(-1, 9, count + 1))
        one = np.ones(1, dtype=np.float32)
        return lambda weights: (latents, np.concatenate([_latent(network, weights, code, parameters), one]))


def _latent(network: Arrays, weights, code, parameters):
    """Return the last hidden layer, shape (..., latent)."""
    whole = [part + 0.0 * weights[..., :1] for part in (parameters, code)]
    return elu(perceptron(network, "hidden", concatenate([weights, *whole]), elu))
