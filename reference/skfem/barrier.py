"""Contact by other code: the barrier of ipctk (`pip install softdeca[contact]`), as one more part of the energy.

Projective dynamics parts surfaces after a solve, by multipliers. Here a barrier over distances of vertices, edges and
triangles keeps them apart during Newton's method (Li et al. 2020, "Incremental Potential Contact"). So one checks the
other. A solve has to begin where the surfaces do not cross.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.base.errors import MissingDependencyError, SceneError
from ...lhm.base.mesh import Floats
from .. import terms
from ..scene import Scene
from .discretisation import Discretisation
from .solids import Treatment, project_spd

REACH = 0.01
"""[mm] beyond the gap, from which on the barrier acts: surfaces in contact come to rest within it."""


def load_ipctk() -> ModuleType:
    """Import ipctk; MissingDependencyError where it is not installed."""
    try:
        import ipctk
    except ImportError:
        raise MissingDependencyError("contact by solver 'skfem' needs ipctk: pip install softdeca[contact]") from None
    return ipctk


class Barrier:
    """The barrier of a Contact term; its stiffness scales it, and its thickness is a distance that is never reached."""

    def __init__(self, term: terms.Contact, scene: Scene, at: Discretisation):
        if at.element != "P1":
            raise SceneError("Contact: solver 'skfem' models it on linear tets only, by element 'P1'")
        self._ipctk = load_ipctk()
        ids, places = np.unique(term.triangles, return_inverse=True)
        triangles = np.asfortranarray(places.reshape(-1, 3), dtype=np.int32)
        rest = np.asfortranarray(scene.vertices[ids])
        self._mesh = self._ipctk.CollisionMesh(rest, self._ipctk.edges(triangles), triangles)
        self._potential = self._ipctk.BarrierPotential(REACH, term.stiffness, True)
        self._dofs, self._size, self._gap = at.dofs[ids].ravel(), at.size, term.thickness

    @classmethod
    def from_scene(cls, scene: Scene, at: Discretisation) -> list[Barrier]:
        """See Part."""
        return [cls(term, scene, at) for term in scene.of(terms.Contact)]

    def value(self, x: Floats) -> float:
        """See Part; infinite where surfaces cross or are nearer than the gap."""
        places = self._places(x)
        if self._ipctk.has_intersections(self._mesh, places):
            return np.inf
        near = self._find_near(places)
        # ipctk's minimum distance is squared.
        if len(near) and near.compute_minimum_distance(self._mesh, places) <= self._gap**2:
            return np.inf
        return float(self._potential(near, self._mesh, places))

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        places, gradient = self._places(x), np.zeros(self._size)
        gradient[self._dofs] = self._potential.gradient(self._find_near(places), self._mesh, places)
        return gradient

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; ipctk projects each pair's own where tangents are projected."""
        places, methods = self._places(x), self._ipctk.PSDProjectionMethod
        method = methods.CLAMP if treat is project_spd else methods.NONE
        of_mesh = self._potential.hessian(self._find_near(places), self._mesh, places, method).tocoo()
        where = (self._dofs[of_mesh.row], self._dofs[of_mesh.col])
        return csr_matrix((of_mesh.data, where), shape=(self._size, self._size))

    def _places(self, x: Floats) -> Floats:
        places: Floats = np.asfortranarray(x[self._dofs].reshape(-1, 3))
        return places

    def _find_near(self, places: Floats) -> Any:
        """Pairs of vertices, edges and triangles within the barrier's reach."""
        near = self._ipctk.NormalCollisions()
        near.use_area_weighting = True
        near.build(self._mesh, places, REACH, self._gap)
        return near
