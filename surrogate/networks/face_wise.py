"""SoftDECA's ablation without the split of w from p and h: one network at every vertex, evaluated in every frame."""

from __future__ import annotations

from ..rig import WEIGHTS
from .layers import EVERY, Arrays, concatenate, linear, perceptron, silu
from .trainer import Tensors, draw_layers, perceptron_layers, torch
from .vertex_network import VertexNetwork

POSITION, WIDTH = 16, 64


class FaceWise(VertexNetwork):
    """T - S = f(z(w, p, h), v), in the vertex form."""

    name = "face-wise network"

    def draw(self, vertices: int, summary: int) -> Tensors:
        """See `VertexNetwork`."""
        network = draw_layers(perceptron_layers("whole", WEIGHTS + summary, 128, 128, WIDTH))
        network["position"] = torch.randn(vertices, POSITION)
        return network | draw_layers(perceptron_layers("local", WIDTH + POSITION, WIDTH, WIDTH, 3))

    def bound(self, network: Arrays, summary, vertices=EVERY):
        """Return the summary itself."""
        return summary

    def answer(self, network: Arrays, bound, weights, vertices=EVERY):
        """See `VertexNetwork`."""
        whole = perceptron(network, "whole", concatenate([weights, bound]))[:, None]
        # The first layer of `local` in two parts, which add up: nothing is concatenated per vertex.
        first = network["local.0.weight"]
        hidden = whole @ first[:, :WIDTH].T + network["position"][vertices] @ first[:, WIDTH:].T
        hidden = silu(linear(network, "local.2", silu(hidden + network["local.0.bias"])))
        return linear(network, "local.4", hidden)
