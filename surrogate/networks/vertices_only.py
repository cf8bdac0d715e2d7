"""SoftDECA's ablation without deformation gradients: z(w) times a matrix L(p, h) at each vertex, bound once."""

from __future__ import annotations

from ..rigs.rig import WEIGHTS, silu
from .layers import EVERY, Arrays, concatenate, einsum, linear, perceptron, perceptron_layers
from .trainer import Tensors, draw_layers, torch
from .vertex_network import VertexNetwork

LATENT, POSITION, WIDTH = 32, 16, 128


class VerticesOnly(VertexNetwork):
    """T - S = L₀(p, h, v) + Σ_k z_k(w) L_k(p, h, v)."""

    def draw(self, vertices: int, summary: int) -> Tensors:
        """See `VertexNetwork`."""
        network = draw_layers(perceptron_layers("expression", WEIGHTS, WIDTH, WIDTH, LATENT))
        network |= draw_layers(perceptron_layers("whole", summary, WIDTH, WIDTH))
        network["position"] = torch.randn(vertices, POSITION)
        return network | draw_layers(perceptron_layers("local", WIDTH + POSITION, WIDTH, 3 * (LATENT + 1)))

    def bound(self, network: Arrays, summary, vertices=EVERY):
        """Return L, shape (b, v, 1 + LATENT, 3)."""
        whole = perceptron(network, "whole", summary)[:, None]
        # The first layer of `local` in two parts, which add up: nothing is concatenated per vertex.
        first = network["local.0.weight"]
        hidden = whole @ first[:, :WIDTH].T + network["position"][vertices] @ first[:, WIDTH:].T
        answer = linear(network, "local.2", silu(hidden + network["local.0.bias"]))
        return answer.reshape(*answer.shape[:2], LATENT + 1, 3)

    def answer(self, network: Arrays, bound, weights, vertices=EVERY):
        """See `VertexNetwork`."""
        latent = concatenate([0.0 * weights[:, :1] + 1.0, perceptron(network, "expression", weights)])
        return einsum("bk,bvkc->bvc", latent, bound)
