"""The cells of tissue: tets, or prisms of three tets that share one deformation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.kernels import njit
from ...lhm.base.mesh import Floats, Ints
from .term import Mesh


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells with one deformation each, F = Σ_a x_a ⊗ gradients_a.

    vertices (k, a), gradients (k, a, 3) [1/mm] and rest volumes (k,) [mm³]: a is 4 for tets and 6 for prisms. The F of
    a prism is the mean of its three tets' F_t, weighted by volume: one point per cell, as in Flanagan and Belytschko
    (1981), "A uniform strain hexahedron and quadrilateral with orthogonal hourglass control".
    modes (k, a - 4, a) [mm^½]: the two motions h of a prism that F does not see: Σ v_t ‖F_t - F‖² = Σ |Σ_a h_a x_a|².
    """

    vertices: Ints
    gradients: Floats
    volumes: Floats
    modes: Floats

    @classmethod
    def from_mesh(cls, mesh: Mesh, tets: Ints) -> Cells:
        """Make cells of a mesh's tets (k,), or of prisms (k, 3); SceneError as of `prism_vertices`."""
        volumes = mesh.volumes[tets]
        if tets.ndim == 1:
            return cls(mesh.tets[tets], shape_gradients(mesh, tets), volumes, np.zeros((len(tets), 0, 4)))
        vertices = prism_vertices(mesh, tets)
        gradients, modes = _join_tets(vertices, mesh.tets[tets], shape_gradients(mesh, tets), volumes)
        return cls(vertices, gradients, volumes.sum(axis=1), modes)

    def deformation(self, positions: Floats) -> Floats:
        """Return F, shape (k, 3, 3), at positions [mm], shape (n, 3)."""
        x = positions[self.vertices]
        return (x - x[:, :1]).transpose(0, 2, 1) @ self.gradients

    def volume_ratio(self, positions: Floats) -> Floats:
        """Return J = det F, shape (k,), at positions [mm], shape (n, 3)."""
        (a, b, c), (d, e, f), (g, h, i) = self.deformation(positions).transpose(1, 2, 0)
        return a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)


@njit(cache=True)
def _join_tets(vertices, tets, gradients, volumes):
    """Return gradients (k, 6, 3) and modes (k, 2, 6) of prisms (k, 6) from those (k, 3, 4, 3) of their tets (k, 3, 4).

    Modes are rows R with Rᵀ R = A Aᵀ, whose rank is two: Cholesky's, by largest pivots.
    """
    means, modes = np.zeros((len(vertices), 6, 3)), np.empty((len(vertices), 2, 6))
    away, left = np.empty((3, 6, 3)), np.empty((6, 6))
    for k in range(len(vertices)):
        mean, share = means[k], volumes[k] / volumes[k].sum()
        away[:] = 0.0
        for t in range(3):
            for corner in range(4):
                at = np.searchsorted(vertices[k], tets[k, t, corner])
                for i in range(3):
                    away[t, at, i] = gradients[k, t, corner, i]
                    mean[at, i] += share[t] * gradients[k, t, corner, i]
        away -= mean
        left[:] = 0.0
        for t in range(3):
            for a in range(6):
                for b in range(6):
                    for i in range(3):
                        left[a, b] += volumes[k, t] * away[t, a, i] * away[t, b, i]
        for row in range(2):
            pivot = np.diag(left).argmax()
            mode = left[pivot] / np.sqrt(max(left[pivot, pivot], 1e-300))
            modes[k, row] = mode
            for a in range(6):
                for b in range(6):
                    left[a, b] -= mode[a] * mode[b]
    return means, modes


def shape_gradients(mesh: Mesh, tets: Ints) -> Floats:
    """Return the gradients [1/mm] of the shape functions of tets (...,), shape (..., 4, 3)."""
    corners = mesh.vertices[mesh.tets[tets]]
    a, b, c = (corners[..., k, :] - corners[..., 0, :] for k in (1, 2, 3))
    inverse = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)  # far faster than linalg.inv
    inverse /= np.sum(a * inverse[..., 0, :], axis=-1)[..., None, None]
    return np.concatenate([-inverse.sum(axis=-2, keepdims=True), inverse], axis=-2)


def prism_vertices(mesh: Mesh, tets: Ints) -> Ints:
    """Return the vertices (k, 6) of prisms of three tets (k, 3), ascending; SceneError where they are not six."""
    corners = np.sort(mesh.tets[tets].reshape(len(tets), 12), axis=1)
    first = np.diff(corners, axis=1, prepend=-1) > 0
    bad = np.flatnonzero(first.sum(axis=1) != 6)
    if bad.size:
        three = ", ".join(map(str, tets[bad[0]]))
        raise SceneError(f"tets {three} have {first[bad[0]].sum()} vertices; three tets of a prism have 6")
    return corners[first].reshape(-1, 6)
