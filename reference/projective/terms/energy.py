"""A scene's energy and its gradient at a displacement, and the PD matrix that majorises it.

Stresses and reactions of an answer: P from what each cell alone gives to the gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.mesh import Floats
from ...scene import Scene
from ...solution import Stresses
from ...terms import (
    Bending,
    Cells,
    Gaps,
    Gravity,
    Hourglass,
    Strain,
    SurfaceStrain,
    Target,
    Term,
    Traction,
    Volume,
)
from .bending import Rings
from .cells import CellBlocks, PrismBlocks, TetBlocks
from .gaps import Pairs
from .part import Part
from .springs import DeadLoads, Springs
from .triangles import Triangles

PARTS: dict[type[Part], tuple[type[Term], ...]] = {
    DeadLoads: (Gravity, Traction),
    TetBlocks: (Strain, Volume),
    PrismBlocks: (Strain, Volume, Hourglass),
    Triangles: (SurfaceStrain,),
    Rings: (Bending,),
    Springs: (Target,),
    Pairs: (Gaps,),
}
"""The terms that each part models, in the order in which energies are added up."""
ENERGIES: tuple[type[Term], ...] = tuple(dict.fromkeys(term for terms in PARTS.values() for term in terms))
"""The terms that have an energy."""
AnyPart = TypeVar("AnyPart", bound=Part)


@dataclass(frozen=True, eq=False)
class Energy:
    """E(u) over displacements u = x - X: the sum of its parts. What the scene does not name costs nothing."""

    parts: tuple[Part, ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Energy:
        """Build what depends on mesh and stiffnesses."""
        parts = (kind.from_scene(scene) for kind in PARTS)
        return cls(tuple(part for part in parts if part is not None))

    def for_scene(self, scene: Scene) -> Energy:
        """Take another scene's numbers that are `varying`."""
        return Energy(tuple(part.for_scene(scene) for part in self.parts))

    def rebuilt(self, scene: Scene) -> Energy:
        """Take all numbers of another scene of the same terms."""
        parts = (part.rebuilt(scene) for part in self.parts)
        return Energy(tuple(part for part in parts if part is not None))

    def part(self, kind: type[AnyPart]) -> AnyPart | None:
        """Return the part of a class, None if there is none."""
        return next((part for part in self.parts if isinstance(part, kind)), None)

    @property
    def is_bounded(self) -> bool:
        """Whether the PD matrix bounds it, so that a plain step never raises it."""
        return all(part.is_bounded for part in self.parts)

    @property
    def loads(self) -> Floats:
        """The dead loads [mN], shape (n, 3)."""
        loads = self.part(DeadLoads)
        assert loads is not None
        return loads.forces

    def untangling(self, volume_share: float = 1.0) -> Energy:
        """Return an energy that leads out of inverted tets: all weight on their shape, bounded by a share's matrix."""
        parts = (part.untangling(volume_share) if isinstance(part, CellBlocks) else part for part in self.parts)
        return Energy(tuple(parts))

    def evaluate(self, u: Floats) -> tuple[float, Floats]:
        """Return energy [µJ] and gradient [mN], shape (n, 3), at displacement u [mm]; dead loads count as -f·u."""
        energy, gradient = 0.0, np.zeros_like(u)
        for part in self.parts:
            energy = part.add_to(u, gradient, energy)
        return energy, gradient

    def matrix(self, scene: Scene, *, volume_share: float = 1.0) -> tuple[csr_matrix, np.ndarray]:
        """Return the PD matrix [mN/mm], shape (n, n), and which vertices a spring holds, shape (n,).

        With volume_share 1 it bounds the energy, as plain projective dynamics needs. But the Hessian of Volume resists
        one of nine changes of F, its bound all: with less of Volume's weight the matrix is nearer to the Hessian,
        and so it is with less of a strain limit that leaves stretches up to two or more free.
        Entries that happen to be zero are kept, so that scenes of one topology have matrices of one pattern.
        """
        n = len(scene.vertices)
        anchored = np.zeros(n)
        for part in self.parts:
            part.add_anchors(anchored)
        entries = [part.matrix_entries(scene, volume_share) for part in self.parts]
        rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        return csr_matrix((values, (rows, columns)), shape=(n, n)), anchored > 0


def recover(scene: Scene, positions: Floats, find_pushes: Callable[[Floats], Floats] | None) -> Stresses:
    """Recover stresses and reactions at positions [mm], shape (n, 3); the tets of a prism have its.

    find_pushes: Contact's forces [mN] on the vertices, (n, 3), at positions; None without Contact.
    """
    energy, u = Energy.from_scene(scene), positions - scene.vertices
    pushes = np.zeros_like(u) if find_pushes is None else find_pushes(positions)
    reactions = np.where(scene.dirichlet()[0], energy.evaluate(u)[1] - pushes, 0.0)
    if (pairs := energy.part(Pairs)) is not None:
        known = np.zeros_like(u)
        pairs.add_to(u, known)
        pushes = pushes - known
    F = np.eye(3) + Cells.from_mesh(scene, np.arange(len(scene.tets))).deformation(u)
    F[scene.prisms] = np.eye(3) + scene.prism_cells.deformation(u)[:, None]
    P = np.zeros_like(F)
    for part in energy.parts:
        if isinstance(part, CellBlocks):
            # The local step on cells that share no vertex: P = Σ f_a ⊗ X_a / V from the nodes' forces f = V P ∇N.
            apart, vertices = part.separate(), part.cells.vertices
            forces = np.zeros((vertices.size, 3))
            apart.add_to(u[vertices].reshape(-1, 3), forces)
            edges = scene.vertices[vertices] - scene.vertices[vertices[:, :1]]
            stress = np.einsum("rai,raj->rij", forces.reshape(*vertices.shape, 3), edges)
            tets = part.tets.reshape(len(vertices), -1)
            np.add.at(P, tets, (stress / part.cells.volumes[:, None, None])[:, None])
    return Stresses.from_points(P[:, None], F[:, None], scene.volumes[:, None], reactions, pushes)
