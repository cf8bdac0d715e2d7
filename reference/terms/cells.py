"""The cells of tissue: tets, or prisms of three tets that share one deformation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from .term import Mesh


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells with one deformation each, F = Σ_a x_a ⊗ gradients_a.

    vertices (k, a), gradients (k, a, 3) [1/mm] and rest volumes (k,) [mm³]: a is 4 for tets and 6 for prisms. The F of
    a prism is the mean of its three tets' F, weighted by volume: one point per cell, as in Flanagan and Belytschko
    (1981), "A uniform strain hexahedron and quadrilateral with orthogonal hourglass control".
    """

    vertices: Ints
    gradients: Floats
    volumes: Floats

    @classmethod
    def from_mesh(cls, mesh: Mesh, tets: Ints) -> Cells:
        """Make cells of a mesh's tets (k,), or of prisms (k, 3); SceneError as of `prism_vertices`."""
        volumes = mesh.volumes[tets]
        if tets.ndim == 1:
            return cls(mesh.tets[tets], shape_gradients(mesh, tets), volumes)
        vertices, gradients = gradients_in_prisms(mesh, tets)
        whole = volumes.sum(axis=1)
        return cls(vertices, np.einsum("kt,ktad->kad", volumes / whole[:, None], gradients), whole)

    def deformation(self, positions: Floats) -> Floats:
        """Return F, shape (k, 3, 3), at positions [mm], shape (n, 3)."""
        away = positions[self.vertices] - positions[self.vertices[:, :1]]
        return np.einsum("kai,kaj->kij", away, self.gradients)


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


def gradients_in_prisms(mesh: Mesh, tets: Ints) -> tuple[Ints, Floats]:
    """Return the vertices (k, 6) of prisms of three tets (k, 3), and each tet's gradients over them, (k, 3, 6, 3)."""
    vertices = prism_vertices(mesh, tets)
    place = np.sum(mesh.tets[tets][..., None] > vertices[:, None, None], axis=-1)
    gradients = np.zeros((*tets.shape, 6, 3))
    np.put_along_axis(gradients, place[..., None], shape_gradients(mesh, tets), axis=2)
    return vertices, gradients
