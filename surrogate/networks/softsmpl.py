"""SoftSMPL's regressor (Santesteban et al. 2020) as SoftDECA compares with it: w, p and h together into one latent."""

from __future__ import annotations

from typing import Literal

from ..rig import WEIGHTS
from .layers import EVERY, Arrays, concatenate, perceptron
from .trainer import Tensors, draw_layers, perceptron_layers, torch
from .vertex_network import STEPS, VertexNetwork

WIDTHS = {"small": (128, 32), "large": (512, 256)}
"""Hidden width and latents: the small one has those of SoftDECA's network."""


class SoftSMPL(VertexNetwork):
    """A perceptron whose last layer is a linear map to all vertices: nothing of it is bound."""

    def __init__(self, size: Literal["small", "large"] = "small", steps: int = STEPS):
        super().__init__(steps)
        self._width, self._latent = WIDTHS[size]
        self.name = f"SoftSMPL, {size}"

    def draw(self, vertices: int, summary: int) -> Tensors:
        """See `VertexNetwork`."""
        hidden = perceptron_layers("hidden", WEIGHTS + summary, self._width, self._width, self._latent)
        network = draw_layers(hidden)
        network["last"] = torch.randn(self._latent, vertices, 3) / self._latent**0.5
        return network | {"bias": torch.zeros(vertices, 3)}

    def bound(self, network: Arrays, summary, vertices=EVERY):
        """Return the summary itself."""
        return summary

    def answer(self, network: Arrays, bound, weights, vertices=EVERY):
        """See `VertexNetwork`."""
        latent = perceptron(network, "hidden", concatenate([weights, bound]))
        last = network["last"][:, vertices]
        return (latent @ last.reshape(len(last), -1)).reshape(len(latent), -1, 3) + network["bias"][vertices]
