"""The scene's energy, gradient and Hessian over the displacement's dofs: of its solids, of nodal terms, and loads."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import (
    Bending,
    Gaps,
    Hourglass,
    Hyperelastic,
    Pressure,
    RigidBody,
    Strain,
    SurfaceStrain,
    Target,
    Term,
    Volume,
)
from .. import dolfinx_version as seam
from ..dolfinx_version import MPI, PETSc
from ..energy.assembly import Stiffness, rigid_motions
from ..energy.bending import Rings
from ..energy.gaps import Distances
from ..energy.hyperelastic import MixedForms
from ..energy.loads import FollowerPressure, Springs, dead_loads
from ..energy.nodal import NodalEnergy
from ..energy.prisms import Hourglasses
from ..energy.quadrature import Quadrature
from ..energy.solids import Solids
from ..energy.surface_strain import Membrane
from ..mesh.numbering import Numbering
from ..mesh.parallel import IndexMap, anywhere
from .multigrid import find_levels

MODELS: dict[type[Term], type[Solids | NodalEnergy]] = {
    Hyperelastic: Solids,
    Strain: Solids,
    Volume: Solids,
    Hourglass: Hourglasses,
    SurfaceStrain: Membrane,
    Bending: Rings,
    Gaps: Distances,
    Pressure: FollowerPressure,
    Target: Springs,
}
"""The class that models each term that has an energy, or a force that follows."""


class DiscreteProblem:
    """The fixed parts of a sequence (mesh, forms, matrix), and the present scene's numbers.

    Fields are of shape (n, 3), by node, vectors (owned, 3): see `parallel`. The laws of a mixed problem have the
    pressure [kPa] of linear elements, whose nodes are shared as `pressures` say and lie at the scene's vertices
    `pressure_vertex`; of another one there are none. `levels` are those of multigrid below the displacement's nodes.
    """

    def __init__(self, scene: Scene, numbering: Numbering, *, mixed: bool = False):
        self.numbering, self.comm = numbering, numbering.comm
        self.levels = find_levels(numbering, scene)
        self.assemblies = 0
        self.mixed = mixed
        self.pressure: Any = None
        owned, ids = 0, np.empty(0, dtype=np.int64)
        if mixed:
            space = seam.pressure_space(numbering.space.mesh)
            self.pressure = seam.function(space)
            self.pressure_dofs = seam.cell_dofs(space, 4)
            owned, ids = seam.dof_counts(space)[0], seam.global_dofs(space)
        self.pressures = IndexMap(self.comm, owned, ids[owned:], 1)
        self.pressure_vertex: Ints = np.empty(len(ids), dtype=np.int64)
        if mixed:
            self.pressure_vertex[self.pressure_dofs] = numbering.cell_vertices
        self.solids = Solids(scene, numbering, self.pressure, self.pressure_dofs if mixed else None)
        self._nodal: dict[type[NodalEnergy], tuple[list[Term], Sequence[NodalEnergy]]] = {}
        self._parts = self._take_nodal(scene)
        nodes = [part.nodes for part in self._parts]
        self.stiffness = Stiffness([numbering.cell_dofs, self.solids.prisms.nodes, *nodes], numbering.nodes)
        self._slots = [self.stiffness.slots(each) for each in nodes]
        self.symmetric = not anywhere(self.comm, [part.is_load for part in self._parts])
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, self.symmetric)
        self.matrix.setNearNullSpace(rigid_motions(numbering.X[: numbering.nodes.owned], self.comm))
        supported = np.zeros(len(numbering.X), dtype=bool)
        supported[numbering.cell_dofs[self.solids.cells].ravel()] = True
        for part in self._parts:
            if not part.is_load:
                supported[part.nodes.ravel()] = True
        self.unsupported = ~numbering.nodes.spread_mask(supported)
        for body in scene.of(RigidBody):
            dofs = numbering.own_dofs(body.name, body.vertices)[1]
            self.unsupported[dofs] = not anywhere(self.comm, ~self.unsupported[dofs])
        self.set(scene)

    @property
    def matrix(self) -> PETSc.Mat:
        """The matrix that every Hessian is assembled into."""
        return self.stiffness.matrix

    def _take_nodal(self, scene: Scene) -> list[NodalEnergy]:
        """Return the nodal parts; those of a kind are made anew if `varying` numbers of its terms have changed."""
        for model in dict.fromkeys(MODELS.values()):
            if not issubclass(model, NodalEnergy):
                continue
            terms = [term for kind in MODELS if MODELS[kind] is model for term in scene.of(kind)]
            before, _ = self._nodal.get(model, (None, ()))
            if before is None or not all(map(_have_same_numbers, before, terms)):
                self._nodal[model] = terms, model.from_scene(scene, self.numbering)
        return [part for _, parts in self._nodal.values() for part in parts]

    def set(self, scene: Scene):
        """Take a scene's stiffnesses, targets and loads; SceneError for a load on a vertex that no energy holds."""
        numbering, owned = self.numbering, self.numbering.own_corners
        supported = np.zeros(len(scene.vertices), dtype=bool)
        supported[numbering.vertex[np.searchsorted(numbering.corners, owned)][~self.unsupported[owned]]] = True
        if numbering.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, supported, op=MPI.LOR)
        bad = np.flatnonzero(~supported & scene.loads().any(axis=1) & ~scene.dirichlet()[0].all(axis=1))
        if bad.size:
            raise SceneError(f"vertex {bad[0]} carries a load, but no energy acts on it")
        self.loads = dead_loads(scene, numbering)
        self.solids.set(scene)
        self._parts = self._take_nodal(scene)
        sizes = self.comm.allreduce(float(np.cbrt(numbering.cell_volumes).sum()))
        self.energy_scale = scene.force_scale() * sizes

    def held_dofs(self, held: np.ndarray) -> Ints:
        """The dofs that this rank owns, flat and sorted, which a mask (n, 3) holds, or which no energy acts on."""
        return np.flatnonzero((held | self.unsupported[:, None])[: self.numbering.nodes.owned])

    @property
    def mixed_forms(self) -> list[MixedForms]:
        """The forms of laws with a pressure."""
        return self.solids.mixed_forms

    def force_per_volume(self, diagonal: Floats) -> float:
        """The force that a mean node's displacement causes by its volume [mN/mm³], from a diagonal [mN/mm], a vector.

        It weighs volumes among forces.
        """
        volumes = self.numbering.cell_volumes
        sums = self.comm.allreduce(np.array([diagonal.sum(), len(diagonal), volumes.sum(), len(volumes)]))
        return float(sums[0] / sums[1] / np.cbrt(sums[2] / sums[3]) ** 2)

    def idle_pressures(self) -> Ints:
        """The pressures, in a vector, that no law has."""
        used = np.zeros(self.pressures.count, dtype=bool)
        for forms in self.mixed_forms:
            used[self.pressure_dofs[forms.cells]] = True
        return np.flatnonzero(~self.pressures.spread_mask(used)[: self.pressures.owned])

    def at(self, u: Floats, p: Floats | None = None, share: float = 1.0) -> Evaluation:
        """The problem at a displacement [mm] and a pressure [kPa], fields (n, 3) and (n_p,), and a share of loads."""
        return Evaluation(self, u, np.zeros(self.pressures.count) if p is None else p, share)

    def moved(self, state: Evaluation, step: Floats) -> Evaluation:
        """The problem after a step of all dofs [mm], a vector (3 owned,)."""
        return self.at(state.u + self.numbering.nodes.spread(step.reshape(-1, 3)), state.p, state.share)


def _have_same_numbers(one: Term, other: Term) -> bool:
    return one is other or all(np.array_equal(getattr(one, key), getattr(other, key)) for key in one.varying)


class Evaluation:
    """Energy, gradient and Hessian at one displacement and pressure.

    Dead loads and follower pressures are scaled by `share`; the energy has the latter's as far as they have one.
    """

    def __init__(self, problem: DiscreteProblem, u: Floats, p: Floats, share: float):
        self.u, self.p, self.share = u, p, share
        self._problem, self._solids = problem, problem.solids.at(u, p)
        self._x = problem.numbering.X + u

    def place(self):
        """Have the forms take this displacement and pressure."""
        self._solids.place()

    @cached_property
    def energy(self) -> float:
        """The energy [µJ], of all ranks; not finite where a law does not hold."""
        problem = self._problem
        energy = -self.share * float(np.sum(problem.loads * self.u[: len(problem.loads)])) + self._solids.energy()
        for part in problem._parts:
            energy += (self.share if part.is_load else 1.0) * part.energy(self._x)
        return problem.comm.allreduce(energy)

    def gradient(self) -> Floats:
        """The energy's gradient [mN], a vector (owned, 3), held components included."""
        problem = self._problem
        total = np.zeros_like(self.u)
        total[: len(problem.loads)] = -problem.loads
        for part in problem._parts:
            if part.is_load:
                part.add_gradient(self._x, total)
        total *= self.share
        self._solids.add_gradient(total)
        for part in problem._parts:
            if not part.is_load:
                part.add_gradient(self._x, total)
        return problem.numbering.nodes.sum_up(total)

    def strain(self) -> Floats:
        """The energy's derivative by the pressure [mm³], a vector."""
        parts = np.zeros(self._problem.pressures.count)
        self._solids.add_strain(parts)
        return self._problem.pressures.sum_up(parts)

    def stresses(self) -> tuple[Floats, Floats, Quadrature]:
        """F and P [kPa] at the points of this rank, shape (k q, 3, 3), of all laws together, and the quadrature."""
        return *self._solids.stresses(), self._problem.solids.quadrature

    def hessian(self, kept: float = 1.0) -> PETSc.Mat:
        """The gradient's derivative [mN/mm], in the problem's matrix.

        Every negative eigenvalue of every point's tangent is multiplied by `kept` in [0, 1]: at 1 it is exact, at 0
        positive semi-definite.
        """
        problem, stiffness = self._problem, self._problem.stiffness
        problem.assemblies += 1
        stiffness.clear()
        self._solids.add_hessian(stiffness, kept)
        for slots, part in zip(problem._slots, problem._parts, strict=True):
            blocks = part.hessian(self._x, kept)
            stiffness.add(part.nodes, slots, self.share * blocks if part.is_load else blocks)
        return stiffness.assemble()
