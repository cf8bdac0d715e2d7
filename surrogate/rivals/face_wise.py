"""SoftDECA's ablation without the split of w from p and h: one network at every vertex, evaluated in every frame."""

from __future__ import annotations

from ..learning import nn, torch
from .trained import Trained, perceptron

POSITION, WIDTH = 16, 64


class FaceWise(Trained):
    """T - S = f(z(w, p, h), v), in the vertex form."""

    name = "face-wise network"

    def network(self, vertices: int, summary: int) -> nn.Module:
        """See `Trained`."""
        return _Network(vertices, summary)


class _Network(nn.Module):
    def __init__(self, vertices: int, summary: int):
        super().__init__()
        self.whole = perceptron(52 + summary, 128, 128, WIDTH)
        self.position = nn.Parameter(torch.randn(vertices, POSITION))
        self.local = perceptron(WIDTH + POSITION, WIDTH, WIDTH, 3)

    def forward(self, weights, summary, vertices):
        whole, place = self.whole(torch.cat([weights, summary], dim=1)), self.position[vertices]
        both = [whole[:, None].expand(-1, len(vertices), -1), place[None].expand(len(whole), -1, -1)]
        return self.local(torch.cat(both, dim=2))
