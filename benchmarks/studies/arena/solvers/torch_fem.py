"""torch-fem: incremental Newton on the neo-Hookean law by automatic differentiation, in float64 on the CPU.

The package has no callback, so the row has one point, at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock

TITLE = "torch-fem"
PACKAGES = ("torch-fem==0.14.0", "torch==2.13.0")
LAW = "neo-Hookean"
DTYPE = "float64"
TOLERANCE = 1e-4
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "1 increment (default)": {"increments": 1},
    "8 increments": {"increments": 8},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Solve once."""
    import torch

    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    from torchfem import Solid
    from torchfem.materials import Hyperelastic3D

    clock.end("imports")
    if not problem.starts_at_rest:
        problem.refuse("it starts from rest alone")

    def energy(F, p):
        C = F.transpose(-1, -2) @ F
        log_J = 0.5 * torch.logdet(C)
        first = torch.diagonal(C, dim1=-2, dim2=-1).sum(-1)
        return p[..., 0] / 2 * (first - 3) - p[..., 0] * log_J + p[..., 1] / 2 * log_J**2

    body = Solid(
        torch.tensor(problem.vertices),
        torch.tensor(problem.tets),
        Hyperelastic3D(energy, torch.tensor(list(problem.one_material()))),
    )
    body.forces[:] = torch.tensor(problem.forces)
    body.constraints[problem.held] = True
    body.displacements[problem.held] = torch.tensor(problem.places - problem.vertices[problem.held])
    clock.end("set-up")
    shares = torch.linspace(0.0, 1.0, settings["increments"] + 1)
    moved, *_ = body.solve(increments=shares, rtol=1e-10, max_iter=20)
    clock.see(problem.vertices + np.asarray(moved.detach()), settings["increments"])
