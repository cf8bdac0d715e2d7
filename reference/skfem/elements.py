"""Elements with their integration points: what a density at points gives to forces and stiffness of the nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ...lhm.base.mesh import Floats, Ints


@dataclass(frozen=True, eq=False)
class Elements:
    """m elements of k nodes and q points in d dimensions.

    rest [mm], shape (size,), are all nodes' places by degree of freedom; dofs (m, k, 3); weights (m, q) [mm^d], what
    each point stands for; shape functions (q, k) and their gradients (m, q, k, d) [1/mm]. Points are counted element by
    element.
    """

    rest: Floats
    dofs: Ints
    weights: Floats
    shapes: Floats
    gradients: Floats

    def points(self, elements: Ints) -> Ints:
        """The points of some elements (e,), shape (e q,)."""
        q = self.weights.shape[1]
        return (q * elements[:, None] + np.arange(q)).ravel()

    def at_points(self, values) -> Floats:
        """One number, or one per element, as one per point, shape (m q,)."""
        m, q = self.weights.shape
        return np.repeat(np.broadcast_to(values, (m,)).astype(np.float64), q)

    def deformation_gradients(self, x: Floats) -> Floats:
        """F at the points, shape (m q, 3, d); from displacements, whose rounding is less than that of places."""
        return self._at_rest + self._gradient(x - self.rest)

    @cached_property
    def _at_rest(self) -> Floats:
        return self._gradient(self.rest)

    def _gradient(self, values: Floats) -> Floats:
        gradient = values[self.dofs].transpose(0, 2, 1)[:, None] @ self.gradients
        return gradient.reshape(-1, 3, gradient.shape[-1])

    def integral(self, psi: Floats) -> float:
        """Of a density at the points, shape (m q,)."""
        return float(self.weights.ravel() @ psi)

    def forces(self, stress: Floats) -> Floats:
        """The integral of P : grad v by degree of freedom, shape (size,), from P at the points (m q, 3, d)."""
        k, d = self.gradients.shape[2:]
        weighted = (self.weights.reshape(-1, 1, 1) * stress).reshape(len(self.dofs), -1, 3, d)
        forces = self._by_node() @ weighted.transpose(0, 1, 3, 2).reshape(len(self.dofs), -1, 3)
        return self._gathered(forces.reshape(-1, 3 * k))

    def stiffness(self, tangent: Floats) -> csr_matrix:
        """The integral of grad v : C : grad u, shape (size, size), from C at the points (m q, 3, d, 3, d)."""
        m = len(self.dofs)
        q, k, d = self.gradients.shape[1:]
        weighted = (self.weights.reshape(-1, 1, 1) * tangent.reshape(m * q, -1, d)).reshape(m, q, -1, d)
        # Axes: element, point, component and direction of v, component and node of u.
        of_u = (weighted @ self.gradients.transpose(0, 1, 3, 2)).reshape(m, q, 3, d, 3 * k)
        blocks = self._by_node() @ of_u.transpose(0, 1, 3, 2, 4).reshape(m, q * d, -1)
        blocks = blocks.reshape(m, 3 * k, 3, k).transpose(0, 1, 3, 2)
        rows = np.broadcast_to(self.dofs.reshape(m, 3 * k, 1, 1), blocks.shape)
        columns = np.broadcast_to(self.dofs[:, None], blocks.shape)
        shape = (len(self.rest), len(self.rest))
        return coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()

    def loads(self, force: Floats) -> Floats:
        """Nodal forces [mN], shape (size,), of one force per weight and element, shape (m, 3)."""
        shares = self.weights @ self.shapes
        return self._gathered(shares[:, :, None] * force[:, None, :])

    def _gathered(self, parts: Floats) -> Floats:
        """The sum over the elements by degree of freedom, shape (size,), of parts (m, k, 3)."""
        return np.bincount(self.dofs.ravel(), parts.ravel(), minlength=len(self.rest)).astype(np.float64, copy=False)

    def _by_node(self) -> Floats:
        """Gradients, shape (m, k, q d)."""
        m, q, k, d = self.gradients.shape
        return self.gradients.transpose(0, 2, 1, 3).reshape(m, k, q * d)
