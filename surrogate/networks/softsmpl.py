"""SoftSMPL's regressor (Santesteban et al. 2020) as SoftDECA compares with it: one perceptron of w, p and h together.

The answer is the same, a deformation gradient per face. Only the conditioning differs: nothing of it is bound.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...lhm.base.mesh import Floats32
from .gradients import Bound, GradientForm, Widths
from .layers import Arrays, concatenate, count_rows, elu, perceptron

SMALL, LARGE = Widths(latent=32, expression=128), Widths(latent=256, expression=512)
"""The small one has the widths of the hypernetwork's f_w, as in the paper, which tells a large one's time alone."""


class SoftSMPL(GradientForm):
    """J - I = last(MLP(w, p, h)), the last layer linear to all faces."""

    kind = "softsmpl"
    layers = {
        "hidden.0": ("wide", "all"),
        "hidden.2": ("wide", "wide"),
        "hidden.4": ("latent", "wide"),
        "last": ("faces*9", "latent"),
    }
    quiet = {"last.weight": 0.02, "last.bias": 0.02}
    follows_fields = False

    def found_sizes(self, network: Mapping[str, np.ndarray]) -> dict[str, int]:
        """See `GradientForm`."""
        (latent,) = count_rows(network, "hidden.4.weight")
        return {"latent": latent}

    def gradients(self, network: Arrays, weights, code, parameters):
        """See `GradientForm`."""
        latent = _latent(network, weights, code[:, None], parameters[:, None])
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
