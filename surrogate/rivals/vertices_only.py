"""SoftDECA's ablation without deformation gradients: z(w) times a matrix L(p, h) at each vertex, bound once."""

from __future__ import annotations

from ..learning import nn, torch
from .trained import Trained, perceptron

LATENT, POSITION, WIDTH = 32, 16, 128


class VerticesOnly(Trained):
    """T - S = L₀(p, h, v) + Σ_k z_k(w) L_k(p, h, v)."""

    name = "vertices only, z(w) L(p, h)"

    def network(self, vertices: int, summary: int) -> nn.Module:
        """See `Trained`."""
        return _Network(vertices, summary)

    def bound(self, network: nn.Module, summary, vertices):
        """With L evaluated."""
        assert isinstance(network, _Network)
        matrices = network.matrices(summary, vertices)[0]
        return lambda weights: torch.einsum("bk,vkc->bvc", network.latent(weights), matrices)


class _Network(nn.Module):
    def __init__(self, vertices: int, summary: int):
        super().__init__()
        self.expression = perceptron(52, WIDTH, WIDTH, LATENT)
        self.whole = perceptron(summary, WIDTH, WIDTH)
        self.position = nn.Parameter(torch.randn(vertices, POSITION))
        self.local = perceptron(WIDTH + POSITION, WIDTH, 3 * (LATENT + 1))

    def latent(self, weights):
        """One, then z, shape (b, 1 + LATENT)."""
        return torch.cat([torch.ones_like(weights[:, :1]), self.expression(weights)], dim=1)

    def matrices(self, summary, vertices):
        """L, shape (b, v, 1 + LATENT, 3)."""
        whole, place = self.whole(summary), self.position[vertices]
        both = torch.cat([whole[:, None].expand(-1, len(vertices), -1), place[None].expand(len(whole), -1, -1)], dim=2)
        return self.local(both).unflatten(2, (LATENT + 1, 3))

    def forward(self, weights, summary, vertices):
        return torch.einsum("bk,bvkc->bvc", self.latent(weights), self.matrices(summary, vertices))
