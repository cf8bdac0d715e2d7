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
        self._dofs = discretisation.dofs[term.pairs].reshape(-1, 12)
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
        depth = np.maximum(self._offset - np.array([np.sqrt(of[0](*self._corners(x, r))) for r, of in self._all()]), 0)
        return 0.5 * float(self._stiffness @ depth**2)

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        gradient = np.zeros(self._size)
        for r, (find, find_gradient, _) in self._all():
            corners = self._corners(x, r)
            distance = np.sqrt(find(*corners))
            if distance < self._offset[r]:
                slope = find_gradient(*corners) / (2.0 * distance)
                gradient[self._dofs[r]] -= self._stiffness[r] * (self._offset[r] - distance) * slope
        return gradient

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; each pair's own is projected where tangents are."""
        rows, columns, values = [], [], []
        for r, (find, find_gradient, find_hessian) in self._all():
            corners = self._corners(x, r)
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
            rows.append(np.repeat(self._dofs[r], 12))
            columns.append(np.tile(self._dofs[r], 12))
            values.append(local.ravel())
        if not values:
            return csr_matrix((self._size, self._size))
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return coo_matrix(entries, shape=(self._size, self._size)).tocsr()

    def _all(self):
        return enumerate(self._distances)

    def _corners(self, x: Floats, r: int) -> Floats:
        return x[self._dofs[r]].reshape(4, 3)
