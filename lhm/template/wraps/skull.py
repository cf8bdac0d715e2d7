"""The skull wrap under a skin wrap, from depths and the template's curvature (SoftDECA Eq. 4), by projective steps.

E(x) = sum_i A_i/2 |(x_i - s_i) - d_i u_i|²                                    depth d_i in any direction u_i inward
     + w_rect sum_ij w_ij/2 ((x_i - s_i) . e_ij)² + the same for j             connectors perpendicular to skin edges
     + w_curv sum_i A_i/2 |h_i² (Lap x_i - R_i Lap b_i)|²                      the template skull's curvature, turned

with s the skin wrap, e_ij its unit edges and w_ij a third of their triangles' areas, b the template's skull wrap and
h_i² the square of its local edge length, which makes the curvature term independent of how fine the wrap is. The
paper's text does not define its E_rect and passes it the template's skin wrap; this reading shears but does not
shorten. All matrices are the template's, so that one factorisation serves every identity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix, diags

from ...base.geometry.cholesky import factorise
from ...base.geometry.topology import graph_laplacian, number_edges
from ...base.kernels import njit
from ...base.mesh import Floats, Ints, unit
from ...head.columns import Columns


@dataclass(frozen=True)
class SkullPolicy:
    """Constants of Eq. 4 and of its iteration."""

    rectangle: float = 0.1  # w_rect
    curvature: float = 0.06  # w_curv
    iterations: int = 20
    still: float = 0.02  # [mm]: shorter steps end the iteration
    inward: float = 0.2  # least cosine of a connector with the one it started as; below, it is turned back to that


POLICY = SkullPolicy()
"""The constants as they were measured."""


@njit(cache=True)
def _turn(x, rest, indptr, indices, weights, rotations):
    """Rotations (n, 3, 3) of the one-rings from `rest` to x, improved in place (Müller et al., MIG 2016)."""
    for i in range(len(x)):
        r = rotations[i]
        a = np.zeros((3, 3))
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            for p in range(3):
                for q in range(3):
                    a[p, q] += weights[k] * (x[j, p] - x[i, p]) * (rest[j, q] - rest[i, q])
        for _ in range(4):
            w0 = w1 = w2 = trace = 0.0
            for c in range(3):
                w0 += r[1, c] * a[2, c] - r[2, c] * a[1, c]
                w1 += r[2, c] * a[0, c] - r[0, c] * a[2, c]
                w2 += r[0, c] * a[1, c] - r[1, c] * a[0, c]
                trace += r[0, c] * a[0, c] + r[1, c] * a[1, c] + r[2, c] * a[2, c]
            scale = 1.0 / (abs(trace) + 1e-12)
            w0, w1, w2 = w0 * scale, w1 * scale, w2 * scale
            angle = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
            if angle < 1e-9:
                break
            u0, u1, u2 = w0 / angle, w1 / angle, w2 / angle
            cosine, sine = np.cos(angle), np.sin(angle)
            for c in range(3):
                v0, v1, v2 = r[0, c], r[1, c], r[2, c]
                along = (u0 * v0 + u1 * v1 + u2 * v2) * (1 - cosine)
                r[0, c] = v0 * cosine + (u1 * v2 - u2 * v1) * sine + u0 * along
                r[1, c] = v1 * cosine + (u2 * v0 - u0 * v2) * sine + u1 * along
                r[2, c] = v2 * cosine + (u0 * v1 - u1 * v0) * sine + u2 * along


@dataclass(frozen=True, eq=False)
class SkullFit:
    """Eq. 4 for one template, factorised: `skin` and `skull` (n, 3) [mm] are its wraps."""

    columns: Columns
    skin: Floats = field(repr=False)
    skull: Floats = field(repr=False)
    policy: SkullPolicy = POLICY
    areas: Floats = field(init=False, repr=False)
    edges: Ints = field(init=False, repr=False)
    share: Floats = field(init=False, repr=False)
    laplacian: csr_matrix = field(init=False, repr=False)
    rows: csr_matrix = field(init=False, repr=False)
    solve: Callable[[Floats], Floats] = field(init=False, repr=False)

    def __post_init__(self):
        triangles, n, policy = self.columns.triangles, self.columns.n, self.policy
        surface = self.columns.surface(self.skin)
        areas = surface.vertex_areas
        edges, number, _ = number_edges(triangles)
        share = np.bincount(number.ravel(), np.repeat(surface.areas / 3.0, 3))
        laplacian = _cotan(self.skull, triangles)
        # A vertex of a regular triangulation with edge h has the area sqrt(3)/2 h².
        rows = (2 / np.sqrt(3)) * laplacian
        at_vertex = np.bincount(edges.ravel(), np.repeat(share, 2), n)
        matrix = diags(areas + policy.rectangle * at_vertex) + policy.curvature * rows.T @ diags(areas) @ rows
        for name, value in (
            ("areas", areas),
            ("edges", edges),
            ("share", share),
            ("laplacian", laplacian),
            ("rows", rows),
            ("solve", factorise(matrix.tocsc())),
        ):
            object.__setattr__(self, name, value)

    def fitted(self, skin: Floats, depths: Floats, start: Floats) -> tuple[Floats, Floats]:
        """The skull wrap (n, 3) [mm] under a skin wrap at wanted depths (n,) [mm], and the energy of each iteration.

        `start` (n, 3) [mm] says which way is in: a connector that departs too far from it is turned back, since
        nothing else in E tells inside from outside.
        """
        i, j, policy = *self.edges.T, self.policy
        along_edge = unit(skin[j] - skin[i])
        inward = unit(start - skin)
        size = np.sqrt(self.columns.surface(skin).areas.sum() / self.columns.surface(self.skin).areas.sum())
        rotations = np.tile(np.eye(3), (self.columns.n, 1, 1))
        graph = self.laplacian
        bent = size * (self.rows @ self.skull)
        x, energies = start, []
        for _ in range(policy.iterations):
            connector = x - skin
            along = unit(connector)
            along = np.where((np.einsum("nd,nd->n", along, inward) < policy.inward)[:, None], inward, along)
            to_depth = connector - depths[:, None] * along
            lean_i = np.einsum("ed,ed->e", connector[i], along_edge)
            lean_j = np.einsum("ed,ed->e", connector[j], along_edge)
            sheared = np.zeros_like(x)
            for ends, lean in ((i, lean_i), (j, lean_j)):
                pull = (self.share * lean)[:, None] * along_edge
                for c in range(3):
                    sheared[:, c] += np.bincount(ends, pull[:, c], self.columns.n)
            _turn(x, self.skull, graph.indptr, graph.indices, graph.data, rotations)
            unbent = self.rows @ x - np.einsum("nij,nj->ni", rotations, bent)
            gradient = self.areas[:, None] * to_depth + policy.rectangle * sheared
            gradient += policy.curvature * (self.rows.T @ (self.areas[:, None] * unbent))
            energies.append(
                0.5 * (self.areas @ (to_depth**2).sum(1) + policy.rectangle * self.share @ (lean_i**2 + lean_j**2))
                + 0.5 * policy.curvature * self.areas @ (unbent**2).sum(1)
            )
            step = self.solve(gradient)
            x = x - step
            if np.abs(step).max() < policy.still:
                break
        return x, np.array(energies)


def _cotan(vertices: Floats, triangles: Ints) -> csr_matrix:
    """The integrated Laplacian of a surface: half the cotangents, none below .05, on the edges; rows sum to zero."""
    n = len(vertices)
    x = vertices[triangles]
    rows, columns, values = [], [], []
    for k in range(3):
        a, b = x[:, (k + 1) % 3] - x[:, k], x[:, (k + 2) % 3] - x[:, k]
        cotangent = np.einsum("md,md->m", a, b) / np.maximum(np.linalg.norm(np.cross(a, b), axis=1), 1e-12)
        rows.append(triangles[:, (k + 1) % 3])
        columns.append(triangles[:, (k + 2) % 3])
        values.append(np.maximum(0.5 * cotangent, 0.05))
    i, j, w = (np.concatenate(part) for part in (rows, columns, values))
    weights = csr_matrix((np.concatenate([w, w]), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n))
    return -graph_laplacian(weights)
