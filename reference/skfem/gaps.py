"""Contact of known pairs, by ipctk's distances of points from triangles and of edges from edges."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from .. import terms
from ..scene import Scene
from .barrier import load_ipctk
from .discretisation import Discretisation
from .solids import Treatment, project_spd


class Gaps:
    """The pairs of a Gaps term, each stiffness/2 max(offset - distance, 0)²."""

    def __init__(self, term: terms.Gaps, discretisation: Discretisation):
        if discretisation.element != "P1":
            raise SceneError("Gaps: solver 'skfem' models them on linear tets only, by element 'P1'")
        ipctk = load_ipctk()
        names = ["edge_edge" if between else "point_triangle" for between in term.between_edges]
        self._distances = [
            tuple(getattr(ipctk, f"{name}_distance{what}") for what in ("", "_gradient", "_hessian")) for name in names
        ]
        self._term, self._dofs = term, discretisation.dofs[term.pairs].reshape(len(term.pairs), -1)
        self._size = discretisation.size
        self._stiffness, self._offset = (
            np.broadcast_to(amount, len(term.pairs)) for amount in (term.stiffness, term.offset)
        )

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Gaps]:
        """See Part."""
        return [cls(term, discretisation) for term in scene.of(terms.Gaps)]

    def value(self, x: Floats) -> float:
        """See Part."""
        distance = np.array([np.sqrt(find(*corners)) for corners, (find, *_) in self._all(x)])
        return 0.5 * float(self._stiffness @ np.maximum(self._offset - distance, 0.0) ** 2)

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        gradient, forces = np.zeros(self._size), np.zeros((len(self._dofs), 12))
        for r, (corners, (find, find_gradient, _)) in enumerate(self._all(x)):
            distance = np.sqrt(find(*corners))
            if distance < self._offset[r]:
                slope = find_gradient(*corners) / (2.0 * distance)
                forces[r] = self._stiffness[r] * (self._offset[r] - distance) * slope
        spread = self._term.spread_forces(forces.reshape(-1, 4, 3))
        np.subtract.at(gradient, self._dofs, spread.reshape(self._dofs.shape))
        return gradient

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; each pair's own is projected where tangents are."""
        hessians = np.zeros((len(self._dofs), 12, 12))
        for r, (corners, (find, find_gradient, find_hessian)) in enumerate(self._all(x)):
            distance = np.sqrt(find(*corners))
            depth = self._offset[r] - distance
            if depth <= 0.0:
                continue
            slope = find_gradient(*corners) / (2.0 * distance)
            outer = np.outer(slope, slope)
            curvature = find_hessian(*corners) / (2.0 * distance) - outer / distance
            local = self._stiffness[r] * (outer - depth * curvature)
            if treat is project_spd:
                sizes, vectors = np.linalg.eigh(local)
                local = (vectors * np.maximum(sizes, 0.0)) @ vectors.T
            hessians[r] = local
        count = self._dofs.shape[1]
        places = np.repeat(self._dofs, count, axis=1).ravel(), np.tile(self._dofs, (1, count)).ravel()
        values = self._term.spread_hessians(hessians).ravel()
        return coo_matrix((values, places), shape=(self._size, self._size)).tocsr()

    def _all(self, x: Floats):
        """Yield each pair's corners, and the functions of its distance, squared."""
        positions = x[self._dofs].reshape(len(self._dofs), -1, 3)
        return zip(self._term.find_corners(positions), self._distances, strict=True)
