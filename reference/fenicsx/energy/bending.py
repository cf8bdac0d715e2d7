"""Bending at the rings of a surface's inner nodes: energy, gradient and Hessian blocks, all exact.

Quadratic triangles are split into four: between vertices that alone resist, skin would wrinkle.

At a vertex with edges e_j (at rest E_j), l = Σ a_j e_j and b = Σ a_j E_j are its Laplacians, and R = S Y⁻¹ is the
rotation nearest to S = Σ w_j e_j E_jᵀ. With s the vertex' stiffness times its area, s/2 |l - R b|² is
s/2 (|l|² + |b|²) - s l·R b. Moving e_j by R q_j turns R by R [ω]ₓ,

    ω = G Σ w_j E_j x q_j,  G = (tr(Y) I - Y)⁻¹,

so that the gradient by e_j is s (a_j (l - R b) - w_j R (z x E_j)) with z = G (b x Rᵀl); the Hessian follows by
differentiating that once more, with dY = Σ w_j q_j E_jᵀ - [ω]ₓ Y.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Bending
from ..mesh.numbering import Numbering
from .assembly import add_forces, skew
from .nodal import NodalEnergy

PARTS = {1: [[0, 1, 2]], 2: [[0, 5, 4], [1, 3, 5], [2, 4, 3], [3, 4, 5]]}
"""Triangles of an element's nodes, by degree."""
FLAT = 1e-9  # of the largest singular value: below it a ring does not determine its rotation


@dataclass(frozen=True, eq=False)
class Rings(NodalEnergy):
    """Inner nodes (m,) with k neighbours each, in the solver's numbering.

    `nodes` (m, k+1) has the vertex first; a (m, k) [1/mm²], w (m, k) and E (m, k, 3) [mm] are the module's; `stiffness`
    [mN mm³] is s.
    """

    nodes: Ints
    a: Floats
    w: Floats
    E: Floats
    stiffness: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> list[Rings]:
        """See NodalEnergy; of each term there is one for every number of neighbours."""
        return [rings for term in scene.of(Bending) for rings in cls._from_term(scene, term, numbering)]

    @classmethod
    def _from_term(cls, scene: Scene, term: Bending, numbering: Numbering) -> Iterator[Rings]:
        there, nodes = numbering.known_faces(term.name, term.triangles)
        triangles = nodes[:, PARTS[numbering.degree]].reshape(-1, 3)
        stiffness = np.broadcast_to(term.stiffness, len(term.triangles))[there]
        X = numbering.to_dofs(scene.vertices if term.rest is None else term.rest)
        cotangents, area, stiffness = _weights(triangles, np.repeat(stiffness, len(triangles) // max(len(nodes), 1)), X)
        edges, sides = np.unique(
            np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True
        )
        inner = np.setdiff1d(triangles, edges[sides == 1])
        inner = inner[inner < numbering.nodes.owned]
        count = np.diff(cotangents.indptr)
        for k in np.unique(count[inner]):
            centre = inner[count[inner] == k]
            slots = cotangents.indptr[centre][:, None] + np.arange(k)
            ring, w = cotangents.indices[slots], cotangents.data[slots]
            s = stiffness[centre] * area[centre]
            nodes = np.column_stack([centre, ring])
            yield cls(nodes, w / area[centre][:, None], np.maximum(w, 0.0), X[ring] - X[centre][:, None], s)

    def _turn(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """R, Y, Rᵀl and b at positions x."""
        e = x[self.nodes[:, 1:]] - x[self.nodes[:, :1]]
        U, sigma, Vt = np.linalg.svd((self.w[:, :, None] * e).transpose(0, 2, 1) @ self.E)
        sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
        U[:, :, 2] *= sign[:, None]
        sigma[:, 2] *= sign
        R = U @ Vt
        Y = (Vt.transpose(0, 2, 1) * sigma[:, None, :]) @ Vt
        p = np.einsum("mci,mj,mjc->mi", R, self.a, e, optimize=True)
        return R, Y, p, np.einsum("mj,mjc->mc", self.a, self.E)

    def energy(self, x: Floats) -> float:
        """See NodalEnergy."""
        _, _, p, b = self._turn(x)
        return 0.5 * float(self.stiffness @ np.sum((p - b) ** 2, axis=1))

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        R, Y, p, b = self._turn(x)
        z = np.einsum("mik,mk->mi", _differentiate_turn(Y), np.cross(b, p))
        turned = self.a[:, :, None] * (p - b)[:, None, :] - self.w[:, :, None] * np.cross(z[:, None, :], self.E)
        force = (self.stiffness[:, None, None] * turned) @ R.transpose(0, 2, 1)
        force = np.concatenate([-force.sum(axis=1, keepdims=True), force], axis=1)
        add_forces(self.nodes, force, into)

    def hessian(self, x: Floats, kept: float) -> Floats:
        """See NodalEnergy."""
        R, Y, p, b = self._turn(x)
        m, k = self.a.shape
        G = _differentiate_turn(Y)
        z = np.einsum("mik,mk->mi", G, np.cross(b, p))
        spin = np.einsum("mik,mj,mjkc->mijc", G, self.w, skew(self.E), optimize=True)  # ω = Σ spin q
        slope = np.einsum("mj,ic->mijc", self.a, np.eye(3))  # Rᵀdl = Σ slope q
        pull = self.w[:, :, None] * self.E
        dz = _compose(skew(b), slope + _compose(skew(p), spin))
        dz += np.einsum("mj,ic->mijc", np.einsum("mjc,mc->mj", pull, z), np.eye(3)) - np.einsum("mi,mjc->mijc", z, pull)
        dz = _compose(G, dz + _compose(skew(np.einsum("mik,mk->mi", Y, z)), spin))
        rows = np.einsum("mh,mijc->mhijc", self.a, slope + _compose(skew(b), spin))
        rows += np.einsum("mh,mhik,mkjc->mhijc", self.w, skew(np.cross(z[:, None, :], self.E)), spin, optimize=True)
        rows += np.einsum("mh,mhik,mkjc->mhijc", self.w, skew(self.E), dz, optimize=True)
        local = rows.reshape(m, 3 * k, 3 * k)
        if kept < 1.0:
            values, vectors = np.linalg.eigh(0.5 * (local + local.transpose(0, 2, 1)))
            values = np.maximum(values, kept * values)
            local = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
        blocks = (self.stiffness[:, None, None] * local).reshape(m, k, 3, k, 3).transpose(0, 1, 3, 2, 4)
        blocks = R[:, None, None] @ blocks @ R.transpose(0, 2, 1)[:, None, None]
        blocks = np.concatenate([-blocks.sum(axis=1, keepdims=True), blocks], axis=1)
        return np.concatenate([-blocks.sum(axis=2, keepdims=True), blocks], axis=2)


def _compose(A: Floats, maps: Floats) -> Floats:
    """A (m, 3, 3) after maps (m, 3, k, 3) from all q."""
    return np.einsum("mih,mhjc->mijc", A, maps)


def _differentiate_turn(Y: Floats) -> Floats:
    """G = (tr(Y) I - Y)⁻¹, shape (m, 3, 3), with a floor under its divisors."""
    sigma, V = np.linalg.eigh(Y)
    divisors = sigma.sum(axis=1, keepdims=True) - sigma
    divisors = np.maximum(divisors, FLAT * np.abs(sigma).max(axis=1, keepdims=True))
    return (V / divisors[:, None, :]) @ V.transpose(0, 2, 1)


def _weights(triangles: Ints, stiffness: Floats, X: Floats) -> tuple[csr_matrix, Floats, Floats]:
    """Per edge (cot a + cot b)/2, (n, n); per node a third of the area around, (n,), and the mean stiffness, (n,)."""
    n = len(X)
    rows, columns, values = [], [], []
    for c in range(3):
        i, j, k = (triangles[:, (c + step) % 3] for step in range(3))
        to_j, to_k = X[j] - X[i], X[k] - X[i]
        twice = np.linalg.norm(np.cross(to_j, to_k), axis=1)
        half = 0.5 * np.sum(to_j * to_k, axis=1) / twice
        rows += [j, k]
        columns += [k, j]
        values += [half, half]
    cotangents = coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (n, n)).tocsr()
    third = np.repeat(twice / 6.0, 3)
    area = np.bincount(triangles.ravel(), third, minlength=n).astype(np.float64, copy=False)
    weighted = np.bincount(triangles.ravel(), third * np.repeat(stiffness, 3), minlength=n)
    return cotangents, area, weighted / np.where(area > 0.0, area, 1.0)
