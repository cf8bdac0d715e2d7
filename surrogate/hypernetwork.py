"""The hypernetwork: z_t = f_w(w_t), L_i = f_ph(p, h, π(i)), J_i = I + reshape(z_tᵀ L_i) (SoftDECA Eq. 17-20)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import elu

from ..lhm.mesh import Surface
from .checkpoint import HypernetworkConfig
from .deformation import DeformationTransfer

WEIGHTS = 52
"""ARKit blendshape weights w_t."""


class Hypernetwork(nn.Module):
    """J - I of every face from weights, identity code and parameters, all normalised.

    `positions` starts the learned table π, shape (faces, config.position).
    """

    def __init__(self, config: HypernetworkConfig, *, code_size: int, n_parameters: int, positions):
        super().__init__()
        self.config = config
        hidden, wide = config.hidden, config.expression_hidden
        self.expression = nn.Sequential(
            nn.Linear(WEIGHTS, wide), nn.ELU(), nn.Linear(wide, wide), nn.ELU(), nn.Linear(wide, config.latent)
        )
        # f_ph's first layer in three parts: faces, identity and parameters add up, nothing is concatenated per face.
        self.position = nn.Parameter(torch.as_tensor(positions, dtype=torch.float32).clone())
        self.from_position = nn.Linear(config.position, hidden, bias=False)
        self.from_code = nn.Linear(code_size, hidden, bias=False)
        self.from_parameters = nn.Linear(n_parameters, hidden)
        self.middle = nn.Linear(hidden, hidden)
        self.last = nn.Linear(hidden, config.latent * 9)
        with torch.no_grad():
            self.last.weight.mul_(0.1)
            self.last.bias.zero_()

    def face_features(self, code, parameters):
        """f_ph before its last layer, shape (batch, faces, hidden), of parameters (batch, k) or (batch, faces, k)."""
        per_face = parameters if parameters.dim() == 3 else parameters[:, None]
        first = self.from_position(self.position) + self.from_code(code)[:, None] + self.from_parameters(per_face)
        return elu(self.middle(elu(first)))

    def forward(self, weights, code, parameters):
        """J - I, shape (batch, faces, 9), from weights (batch, 52), code (batch, c) and parameters.

        z is contracted with the last layer before the faces: 9 outputs per face instead of 288.
        """
        latent = self.expression(weights)
        matrix = self.last.weight.view(self.config.latent, 9, -1)
        contracted = torch.einsum("bk,kch->bhc", latent, matrix)
        constant = latent @ self.last.bias.view(self.config.latent, 9)
        return torch.baddbmm(constant[:, None], self.face_features(code, parameters), contracted)


class _Transfer(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, gradients, blended, transfer: DeformationTransfer):
        ctx.blended, ctx.transfer = blended.detach().numpy(), transfer
        delta = transfer.delta(np.ascontiguousarray(gradients.detach().numpy()), ctx.blended)
        return torch.from_numpy(np.ascontiguousarray(delta))

    @staticmethod
    def backward(ctx: Any, *cotangents):
        pulled = ctx.transfer.pull_back(cotangents[0].numpy(), ctx.blended)
        return torch.from_numpy(pulled), None, None


def transfer_delta(gradients, blended, transfer: DeformationTransfer):
    """`DeformationTransfer.delta` as a torch operation: its backward pass is a solve with the same factor."""
    return _Transfer.apply(gradients, blended, transfer)


def smooth_positions(reference: Surface, size: int, rng: np.random.Generator) -> np.ndarray:
    """A start for π: random Fourier features of face centres and normals, unit variance, shape (faces, size).

    Neighbours start alike, and the two sides of a lip, close in space, differ by their normals.
    """
    centres = reference.vertices[reference.triangles].mean(axis=1)
    centres = (centres - centres.mean(axis=0)) / np.sqrt(centres.var(axis=0).sum())
    length = np.linalg.norm(reference.face_normals, axis=1, keepdims=True)
    inputs = np.hstack([2.0 * centres, 0.5 * reference.face_normals / length])
    frequencies = rng.normal(size=(inputs.shape[1], size))
    features = np.cos(inputs @ frequencies + rng.uniform(0.0, 2.0 * np.pi, size))
    return ((features - features.mean(axis=0)) / features.std(axis=0)).astype(np.float32)
