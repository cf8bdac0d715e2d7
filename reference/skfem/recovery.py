"""Stresses and reactions of an answer: P at scikit-fem's points, and the gradient where something is held."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats
from ..scene import Scene
from ..solution import Stresses
from .discretisation import Discretisation
from .energy import Energy
from .parts import Tets


def recover(scene: Scene, element: str, x: Floats) -> Stresses:
    """Of positions by degree of freedom [mm], shape (size,)."""
    at = Discretisation(scene, element)
    F, P = Tets(scene, at).stress(x)
    volume = at.tets.weights
    forces = np.where(at.held(scene.dirichlet()[0]), Energy(scene, at).gradient(x), 0.0)[at.dofs]
    reactions = np.zeros(scene.vertices.shape)
    for end in at.ends.T:  # an edge's node gives half to each of its ends
        np.add.at(reactions, end, 0.5 * forces)
    return Stresses.of_points(P.reshape(*volume.shape, 3, 3), F.reshape(*volume.shape, 3, 3), volume, reactions)
