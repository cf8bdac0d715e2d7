"""Contact by other code: the barrier of ipctk (`pip install softdeca[contact]`), as one more part of the energy.

Projective dynamics pushes by stiff springs what comes nearer than the gap. Here a barrier over distances of vertices,
edges and triangles keeps them apart during Newton's method (Li et al. 2020, "Incremental Potential Contact"). So one
checks the other. A solve has to begin where the surfaces do not cross.
"""

from __future__ import annotations

from copy import copy
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

REACH, WIDE = 0.01, 0.1
"""[mm] beyond the gap, from which on the barrier acts: surfaces in contact come to rest within it.

A wide one comes first: Newton's method meets it on the way, where a narrow one would cut every step short.
"""
STIFFNESS = 100.0
"""[kPa/mm] Times the reach it is the barrier's pressure. A much larger one would push at the outermost end of the reach
alone, where Newton's method hardly finds it."""


def load_ipctk() -> ModuleType:
    """Import ipctk; MissingDependencyError where it is not installed."""
    try:
        import ipctk
    except ImportError:
        raise MissingDependencyError("contact by solver 'skfem' needs ipctk: pip install softdeca[contact]") from None
    return ipctk


class Barrier:
    """The barrier of a Contact term, whose thickness is a distance that is never reached; its stiffness is its own."""

    def __init__(self, term: terms.Contact, scene: Scene, discretisation: Discretisation):
        if discretisation.element != "P1":
            raise SceneError("Contact: solver 'skfem' models it on linear tets only, by element 'P1'")
        if term.obstacles:
            raise SceneError("Contact: solver 'skfem' models no obstacles; take `freeze_contact`'s scene")
        self._ipctk = load_ipctk()
        ids, places = np.unique(term.triangles, return_inverse=True)
        triangles = np.asfortranarray(places.reshape(-1, 3), dtype=np.int32)
        rest = np.asfortranarray(scene.vertices[ids])
        self._mesh = self._ipctk.CollisionMesh(rest, self._ipctk.edges(triangles), triangles)
        self._reach = REACH
        self._potential = self._ipctk.BarrierPotential(REACH, STIFFNESS * REACH, True)
        self._dofs, self._size, self._gap = discretisation.dofs[ids].ravel(), discretisation.size, term.thickness

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Barrier]:
        return [cls(term, scene, discretisation) for term in scene.of(terms.Contact)]

    def widen(self) -> Barrier:
        """The same barrier with a WIDE reach."""
        wide = copy(self)
        wide._reach, wide._potential = WIDE, self._ipctk.BarrierPotential(WIDE, STIFFNESS * WIDE, True)
        return wide

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

    def frees(self, x: Floats, ahead: Floats) -> bool:
        """Whether surfaces stay farther apart than the gap on the straight way between positions, shape (size,)."""
        ways, ccd = (self._places(x), self._places(ahead)), self._ipctk.AdditiveCCD()
        return bool(self._ipctk.is_step_collision_free(self._mesh, *ways, self._gap, narrow_phase_ccd=ccd))

    def gradient(self, x: Floats) -> Floats:
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
        near.build(self._mesh, places, self._reach, self._gap)
        return near
