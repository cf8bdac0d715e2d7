"""The hypernetwork: z_t = f_w(w_t), L_i = f_ph(p, h, π(i)), J_i = I + reshape(z_tᵀ L_i) (SoftDECA Eq. 17-20).

f_ph has three parts that add up or scale, all gone after L is computed: a table B_i of the corpus' principal
deformation gradients, an MLP of (p, h, π(i)) that adapts it locally, and gains exp(g(p, h)) per latent, since answers
scale with powers of stiffness ratios: L_i = gains ⊙ (B_i + MLP). A few hundred frames are enough only with the table
and the gains; the MLP alone, the paper's form, then hardly beats linear blendshapes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...lhm.base.geometry.deformation import DeformationTransfer
from ...lhm.base.mesh import Floats32, Surface
from ..learning import elu, nn, torch
from .checkpoint import HypernetworkConfig

WEIGHTS = 52
"""ARKit blendshape weights w_t."""


class Hypernetwork(nn.Module):
    """J - I of every face from weights, identity code and parameters, all normalised.

    table (latent, faces, 9) and positions (faces, config.position) are where B and π start.
    """

    scale: torch.Tensor

    def __init__(self, config: HypernetworkConfig, *, code_size: int, n_parameters: int, table, positions):
        super().__init__()
        self.config = config
        hidden, wide, latent = config.hidden, config.expression_hidden, config.latent
        # A linear path beside f_w's hidden layers: most of what tissue does is linear in the weights.
        self.expression_linear = nn.Linear(WEIGHTS, latent, bias=False)
        bent = nn.Linear(wide, latent)
        self.expression = nn.Sequential(nn.Linear(WEIGHTS, wide), nn.ELU(), nn.Linear(wide, wide), nn.ELU(), bent)
        gains = nn.Linear(config.gain_hidden, latent)
        self.gain = nn.Sequential(nn.Linear(n_parameters + code_size, config.gain_hidden), nn.ELU(), gains)
        # B and the MLP's answer in units of the table's size: Adam steps all weights alike, whatever their scale.
        table = torch.as_tensor(table, dtype=torch.float32)
        self.register_buffer("scale", table.square().mean().sqrt().clamp(min=1e-9))
        self.table = nn.Parameter(table / self.scale)
        self.position = nn.Parameter(torch.as_tensor(positions, dtype=torch.float32).clone())
        # f_ph's first layer in three parts: faces, identity and parameters add up, nothing is concatenated per face.
        self.from_position = nn.Linear(config.position, hidden, bias=False)
        self.from_code = nn.Linear(code_size, hidden, bias=False)
        self.from_parameters = nn.Linear(n_parameters, hidden)
        self.middle = nn.Linear(hidden, hidden)
        self.last = nn.Linear(hidden, latent * 9, bias=False)
        with torch.no_grad():
            bent.weight.mul_(0.1)
            self.last.weight.zero_()
            gains.weight.mul_(0.1)
            gains.bias.zero_()

    def forward(self, weights, code, parameters):
        """J - I, shape (batch, faces, 9), from weights (batch, 52), code (batch, c) and parameters (batch, k).

        z is contracted with the last layer before the faces: 9 outputs per face instead of 288.
        """
        latent = self.expression_linear(weights) + self.expression(weights)
        latent = latent * self.scale * torch.exp(self.gain(torch.cat([parameters, code], dim=1)))
        first = self.from_position(self.position) + (self.from_code(code) + self.from_parameters(parameters))[:, None]
        contracted = torch.einsum("bk,kch->bhc", latent, self.last.weight.view(self.config.latent, 9, -1))
        shared = (latent @ self.table.flatten(1)).view(len(latent), -1, 9)
        return torch.baddbmm(shared, elu(self.middle(elu(first))), contracted)


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


def smooth_positions(reference: Surface, size: int, rng: np.random.Generator) -> Floats32:
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
