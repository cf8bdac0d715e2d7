"""torch-fem: a first iterate with an inverted element ends the solve before a cut-back. Needs torch-fem alone."""

import numpy as np
import torch

torch.set_default_dtype(torch.float64)
from torchfem import Solid  # noqa: E402
from torchfem.materials import Hyperelastic3D  # noqa: E402
from torchfem.mesh import cube_tetra  # noqa: E402


def energy(F, p):
    """The neo-Hookean law with a logarithmic volumetric part."""
    C = F.transpose(-1, -2) @ F
    log_J = 0.5 * torch.logdet(C)
    first = torch.diagonal(C, dim1=-2, dim2=-1).sum(-1)
    return p[..., 0] / 2 * (first - 3) - p[..., 0] * log_J + p[..., 1] / 2 * log_J**2


nodes, elements = cube_tetra(7, 7, 7)
nodes = nodes.to(torch.float64)
body = Solid(nodes, elements, Hyperelastic3D(energy, torch.tensor([1.0, 9.0])))
X = np.asarray(nodes)
low, high = np.isclose(X[:, 2], X[:, 2].min()), np.isclose(X[:, 2], X[:, 2].max())
centre = X.mean(axis=0)
turned = np.array(X)
turned[:, 0], turned[:, 1] = (
    centre[0] - (X[:, 1] - centre[1]),
    centre[1] + (X[:, 0] - centre[0]),
)
body.constraints[low | high] = True
body.displacements[high] = torch.tensor((turned - X)[high])
for increments in (1, 8):
    try:
        body.solve(increments=torch.linspace(0.0, 1.0, increments + 1), max_cutbacks=10)
        print(f"{increments} increments: solved")
    except Exception as error:
        print(f"{increments} increments: {type(error).__name__}: {str(error)[:120]}")
