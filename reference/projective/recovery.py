"""Stresses and reactions of an answer: P from what each tet alone gives to the gradient."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats
from ..recovered import Recovered
from ..scene import Scene
from .energy import Energy
from .tets import shape_gradients


def recover(scene: Scene, positions: Floats) -> Recovered:
    """Of positions [mm], shape (n, 3)."""
    energy, u = Energy.of(scene), positions - scene.vertices
    reactions = np.where(scene.dirichlet()[0], energy.evaluate(u)[1], 0.0)
    every = np.arange(len(scene.tets))
    _, gradients = shape_gradients(scene, every)
    F = np.eye(3) + np.einsum("mai,maj->mij", u[scene.tets], gradients)
    P = np.zeros((len(every), 3, 3))
    if energy.tets is not None:
        # The local step on tets that share no vertex: P = Σ f_a (X_a - X_0)ᵀ / V from the nodes' forces f = V P ∇N.
        apart = energy.tets.apart()
        forces = np.zeros((4 * len(apart.tets), 3))
        apart.add_to(u[scene.tets[apart.tets]].reshape(-1, 3), forces)
        X = scene.vertices[scene.tets[apart.tets]]
        rows = np.einsum("rai,raj->rij", forces.reshape(-1, 4, 3)[:, 1:], (X - X[:, :1])[:, 1:])
        np.add.at(P, apart.tets, rows / scene.volumes[apart.tets, None, None])
    return Recovered.of_points(P[:, None], F[:, None], scene.volumes[:, None], reactions)
