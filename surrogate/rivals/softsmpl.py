"""SoftSMPL's regressor (Santesteban et al. 2020) as SoftDECA compares with it: w, p and h together into one latent."""

from __future__ import annotations

from typing import Literal

from ..learning import nn, torch
from .trained import STEPS, Trained, perceptron

WIDTHS = {"small": (128, 32), "large": (512, 256)}
"""Hidden width and latents: the small one has those of SoftDECA's network."""


class SoftSMPL(Trained):
    """A perceptron whose last layer is a linear map to all vertices: nothing of it is bound."""

    def __init__(self, size: Literal["small", "large"] = "small", steps: int = STEPS):
        super().__init__(steps)
        self._width, self._latent = WIDTHS[size]
        self.name = f"SoftSMPL, {size}"

    def network(self, vertices: int, summary: int) -> nn.Module:
        """See `Trained`."""
        return _Network(perceptron(52 + summary, self._width, self._width, self._latent), self._latent, vertices)


class _Network(nn.Module):
    def __init__(self, hidden: nn.Module, latent: int, vertices: int):
        super().__init__()
        self.hidden = hidden
        self.last = nn.Parameter(torch.randn(latent, vertices, 3) / latent**0.5)
        self.bias = nn.Parameter(torch.zeros(vertices, 3))

    def forward(self, weights, summary, vertices):
        latent = self.hidden(torch.cat([weights, summary], dim=1))
        return torch.einsum("bk,kvc->bvc", latent, self.last[:, vertices]) + self.bias[vertices]
