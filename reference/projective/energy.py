"""A scene's energy and its gradient at a displacement, and the PD matrix that majorises it.

Stresses and reactions of an answer: P from what each tet alone gives to the gradient.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from ..solution import Stresses
from ..terms import Inertia, Target
from .bending import Rings
from .tets import TetBlocks, shape_gradients
from .triangles import Triangles


@dataclass(frozen=True, eq=False)
class Energy:
    """E(u) = Σ w/2 ‖F - p‖² + Σ k/(2 A) |D|² + Σ k/2 |x - s|² - f·u over displacements u = x - X.

    |D| is of Bending, springs are of Target and of Inertia. What the scene does not name is None, and costs nothing.
    """

    tets: TetBlocks | None
    triangles: Triangles | None
    bending: Rings | None
    targets: tuple[tuple[Ints, Floats, Floats], ...]
    loads: Floats

    @classmethod
    def from_scene(cls, scene: Scene, threads: int = 1) -> Energy:
        """Build what depends on mesh and stiffnesses."""
        return cls(
            TetBlocks.from_scene(scene, threads), Triangles.from_scene(scene), Rings.from_scene(scene), (), np.zeros(0)
        ).for_scene(scene)

    def for_scene(self, scene: Scene) -> Energy:
        """The energy of a scene of the same terms with other targets, motion, loads, limits, growth and volumes."""
        targets = tuple(
            (term.vertices, term.positions - scene.vertices[term.vertices], np.reshape(term.stiffness, (-1, 1)))
            for term in scene.of(Target)
        )
        if scene.of(Inertia):
            stiffness, places = scene.inertia()
            heavy = np.flatnonzero(stiffness)
            targets += ((heavy, (places - scene.vertices)[heavy], stiffness[heavy, None]),)
        tets = None if self.tets is None else self.tets.for_scene(scene)
        triangles = None if self.triangles is None else self.triangles.for_scene(scene)
        return Energy(tets, triangles, self.bending, targets, scene.loads())

    def untangling(self, volume_share: float = 1.0) -> Energy:
        """An energy that leads out of inverted tets, all weight on Strain, which the matrix of this share bounds."""
        return self if self.tets is None else replace(self, tets=self.tets.untangling(volume_share))

    def evaluate(self, u: Floats) -> tuple[float, Floats]:
        """Energy [µJ] and gradient [mN], shape (n, 3), at displacement u [mm]; dead loads count as -f·u."""
        gradient = -self.loads
        energy = -float(np.vdot(self.loads, u))
        if self.tets is not None:
            energy += self.tets.add_to(u, gradient)
        if self.triangles is not None:
            energy += self.triangles.add_to(u, gradient)
        if self.bending is not None:
            energy += self.bending.add_to(u, gradient)
        for vertices, displacements, stiffness in self.targets:
            away = u[vertices] - displacements
            gradient[vertices] += stiffness * away
            energy += 0.5 * float(np.sum(stiffness * away**2))
        return energy, gradient

    def matrix(self, scene: Scene, *, volume_share: float = 1.0) -> tuple[csr_matrix, np.ndarray]:
        """The PD matrix [mN/mm], shape (n, n), and which vertices a spring holds, shape (n,).

        With volume_share 1 it bounds the energy, as plain projective dynamics needs. But the Hessian of Volume resists
        one of nine changes of F, its bound all: with less of Volume's weight the matrix is nearer to the Hessian,
        and so it is with less of a Strain that leaves stretches up to two or more free.
        Entries that happen to be zero are kept, so that scenes of one topology have matrices of one pattern.
        """
        n = len(scene.vertices)
        anchored = np.zeros(n)
        for vertices, _, stiffness in self.targets:
            anchored[vertices] += stiffness.ravel()
        entries = [(np.arange(n), np.arange(n), anchored)]
        if self.tets is not None:
            entries.append(self.tets.stiffness_entries(scene, volume_share))
        if self.triangles is not None:
            entries.append(self.triangles.stiffness_entries())
        if self.bending is not None:
            entries.append(self.bending.stiffness_entries(n))
        rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        return csr_matrix((values, (rows, columns)), shape=(n, n)), anchored > 0


def recover(scene: Scene, positions: Floats) -> Stresses:
    """Of positions [mm], shape (n, 3)."""
    energy, u = Energy.from_scene(scene), positions - scene.vertices
    reactions = np.where(scene.dirichlet()[0], energy.evaluate(u)[1], 0.0)
    every = np.arange(len(scene.tets))
    _, gradients = shape_gradients(scene, every)
    F = np.eye(3) + np.einsum("mai,maj->mij", u[scene.tets], gradients)
    P = np.zeros((len(every), 3, 3))
    if energy.tets is not None:
        # The local step on tets that share no vertex: P = Σ f_a (X_a - X_0)ᵀ / V from the nodes' forces f = V P ∇N.
        apart = energy.tets.separate()
        forces = np.zeros((4 * len(apart.tets), 3))
        apart.add_to(u[scene.tets[apart.tets]].reshape(-1, 3), forces)
        X = scene.vertices[scene.tets[apart.tets]]
        rows = np.einsum("rai,raj->rij", forces.reshape(-1, 4, 3)[:, 1:], (X - X[:, :1])[:, 1:])
        np.add.at(P, apart.tets, rows / scene.volumes[apart.tets, None, None])
    return Stresses.from_points(P[:, None], F[:, None], scene.volumes[:, None], reactions)
