"""The scene's energy, gradient and Hessian over the displacement's dofs: FEniCSx's forms and the discrete terms."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from ..materials.material import HasDensity, HasStretches
from ..scene import Scene
from ..terms import (
    Bending,
    Hyperelastic,
    Pressure,
    RigidBody,
    Strain,
    SurfaceStrain,
    Volume,
)
from . import dolfinx_version as seam
from . import principal
from .assembly import Stiffness, rigid_motions
from .bending import Rings
from .dolfinx_version import MPI, PETSc
from .hyperelastic import HyperelasticForms
from .loads import FollowerPressure, Springs, dead_loads
from .numbering import Numbering
from .quadrature import DEGREES, Quadrature
from .shared import Shared, anywhere
from .solids import Grown, Solid, StrainLaw, VolumeLaw, add_at
from .surface_strain import Membrane

Law = tuple[Ints, HasStretches]
"""A law and the quadrature points, counted within Quadrature, that it acts on."""


class Problem:
    """What does not change within a sequence (mesh, forms, matrix), and the present scene's numbers.

    Fields are of shape (n, 3), by node, vectors (owned, 3): see `shared`. The laws of a mixed problem have the pressure
    [kPa] of linear elements, whose nodes are shared as `pressures` say and lie at the scene's vertices
    `pressure_vertex`; of another one there are none. `softness` is the sum of their 1/mu [1/kPa] per cell.
    """

    def __init__(self, scene: Scene, numbering: Numbering, *, mixed: bool = False):
        self.numbering, self.comm = numbering, numbering.comm
        self.assemblies = 0
        self._displacement = seam.function(numbering.space)
        self.mixed = mixed
        self.pressure: Any = None
        owned, ids = 0, np.empty(0, dtype=np.int64)
        if mixed:
            space = seam.pressure_space(numbering.space.mesh)
            self.pressure = seam.function(space)
            self.pressure_dofs = seam.cell_dofs(space, 4)
            owned, ids = seam.dof_counts(space)[0], seam.global_dofs(space)
        self.pressures = Shared(self.comm, owned, ids[owned:], 1)
        self.pressure_vertex: Ints = np.empty(len(ids), dtype=np.int64)
        if mixed:
            self.pressure_vertex[self.pressure_dofs] = numbering.cell_vertices
        solids = self._solids(scene)
        self._degree = DEGREES[numbering.degree]
        cells = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(solid.cells for solid in solids)]))
        self._quadrature = Quadrature(numbering, cells, self._degree)
        by_ufl = [solid for solid in solids if self._is_by_ufl(solid.term)]
        self._hyperelastic = [self._forms(solid) for solid in by_ufl]
        self.softness = np.zeros(len(numbering.cell_dofs))
        for solid in by_ufl if mixed else []:
            self.softness[solid.cells] += 1.0 / solid.hyperelastic.material.shear_modulus
        self._tensors = [
            (self._points(forms.cells), forms)
            for forms, solid in zip(self._hyperelastic, by_ufl, strict=True)
            if mixed or not isinstance(solid.hyperelastic.material, HasStretches)
        ]
        self._faces = [numbering.faces(term.name, term.triangles) for term in scene.of(SurfaceStrain)]
        self._pressed = [numbering.faces(term.name, term.triangles) for term in scene.of(Pressure)]
        self._surfaces = self._surfaces_of(scene)
        nodes = [surface.nodes for surface in self._surfaces]
        pressed = [nodes for _, nodes in self._pressed]
        self.stiffness = Stiffness([numbering.cell_dofs, *nodes, *pressed], numbering.nodes)
        self._slots = [self.stiffness.slots(surface) for surface in nodes]
        self._pressed_slots = [self.stiffness.slots(faces) for faces in pressed]
        self.symmetric = not anywhere(self.comm, bool(pressed))
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, self.symmetric)
        owned = numbering.nodes.owned
        self.matrix.setNearNullSpace(rigid_motions(numbering.X[:owned], self.comm))
        springs = [spring.dofs for spring in Springs.from_scene(scene, numbering)]
        supported = np.zeros(len(numbering.X), dtype=bool)
        for dofs in (numbering.cell_dofs[cells], *nodes, *springs):
            supported[dofs.ravel()] = True
        self.unsupported = ~numbering.nodes.marked(supported)
        for body in scene.of(RigidBody):
            dofs = numbering.own_dofs(body.name, body.vertices)[1]
            self.unsupported[dofs] = not anywhere(self.comm, ~self.unsupported[dofs])
        self.set(scene)

    @property
    def matrix(self) -> PETSc.Mat:
        """The matrix that every Hessian is assembled into."""
        return self.stiffness.matrix

    def _solids(self, scene: Scene) -> list[Solid]:
        return [
            Solid.from_term(scene, term, self.numbering)
            for term in scene.terms
            if isinstance(term, (Strain, Volume, Hyperelastic))
        ]

    def _points(self, cells: Ints) -> Ints:
        """The quadrature points of cells (k,), counted within Quadrature, shape (k q,)."""
        q = self._quadrature.per_cell
        return (np.searchsorted(self._quadrature.cells, cells)[:, None] * q + np.arange(q)).ravel()

    def _is_by_ufl(self, term) -> bool:
        return isinstance(term, Hyperelastic) and (self.mixed or isinstance(term.material, HasDensity))

    def _forms(self, solid: Solid) -> HyperelasticForms:
        cells, material, growth = solid.cells, solid.hyperelastic.material, solid.hyperelastic.growth
        pressure = self.pressure if self.mixed else None
        return HyperelasticForms.compile(self._displacement, cells, material, self._degree, growth, pressure)

    def set(self, scene: Scene):
        """Take a scene's stiffnesses, targets and loads; SceneError for a load on a vertex that no energy holds."""
        order = self.numbering
        self._check_loads(scene)
        self.loads = dead_loads(scene, order)
        self._surfaces = self._surfaces_of(scene)
        self._followers = [
            FollowerPressure.from_term(term, nodes, here)
            for term, (here, nodes) in zip(scene.of(Pressure), self._pressed, strict=True)
        ]
        self._springs = Springs.from_scene(scene, order)
        solids = self._solids(scene)
        by_law = [solid for solid in solids if not isinstance(solid.term, Hyperelastic)]
        hyperelastic = [solid for solid in solids if isinstance(solid.term, Hyperelastic)]
        self._laws = [self._law(s) for s in by_law]
        self._laws += [self._law(s) for s in hyperelastic if not self._is_by_ufl(s.term)]
        by_ufl = [s for s in hyperelastic if self._is_by_ufl(s.term) and not self.mixed]
        self._stretched = [self._law(s) for s in by_ufl if isinstance(s.hyperelastic.material, HasStretches)]
        sizes = self.comm.allreduce(float(np.cbrt(order.cell_volumes).sum()))
        self.energy_scale = scene.force_scale() * sizes

    def _check_loads(self, scene: Scene):
        order = self.numbering
        owned = order.own_corners
        supported = np.zeros(len(scene.vertices), dtype=bool)
        supported[order.vertex[np.searchsorted(order.corners, owned)][~self.unsupported[owned]]] = True
        if order.divided:
            self.comm.Allreduce(MPI.IN_PLACE, supported, op=MPI.LOR)
        bad = np.flatnonzero(~supported & scene.loads().any(axis=1) & ~scene.dirichlet()[0].all(axis=1))
        if bad.size:
            raise SceneError(f"vertex {bad[0]} carries a load, but no energy acts on it")

    def _surfaces_of(self, scene: Scene) -> list[Membrane | Rings]:
        surfaces: list[Membrane | Rings] = [
            Membrane.from_term(term, scene.vertices, *faces)
            for term, faces in zip(scene.of(SurfaceStrain), self._faces, strict=True)
        ]
        for term in scene.of(Bending):
            self.numbering.dofs_of(term.name, term.triangles)
            surfaces += Rings.from_term(term, scene.vertices, self.numbering.dof, self.numbering.nodes.owned)
        return surfaces

    def _law(self, solid: Solid) -> Law:
        term, points = solid.term, self._points(solid.cells)

        def at_points(values) -> Floats:
            count = len(solid.cells)
            return np.repeat(np.broadcast_to(values, count), self._quadrature.per_cell).astype(np.float64)

        if isinstance(term, Strain):
            return points, StrainLaw(at_points(term.stiffness), at_points(term.limit), at_points(term.growth))
        if isinstance(term, Volume):
            return points, VolumeLaw(at_points(term.stiffness), at_points(term.target))
        law = term.material
        assert isinstance(law, HasStretches)
        return points, law if np.all(term.growth == 1.0) else Grown(law, at_points(term.growth))

    @property
    def mixed_forms(self) -> list[HyperelasticForms]:
        """The forms of laws with a pressure."""
        return self._hyperelastic if self.mixed else []

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
        return np.flatnonzero(~self.pressures.marked(used)[: self.pressures.owned])

    def at(self, u: Floats, p: Floats | None = None, share: float = 1.0) -> State:
        """The problem at a displacement [mm] and a pressure [kPa], fields (n, 3) and (n_p,), and a share of loads."""
        return State(self, u, np.zeros(self.pressures.count) if p is None else p, share)

    def moved(self, state: State, step: Floats) -> State:
        """The problem after a step of all dofs [mm], a vector (3 owned,)."""
        return State(self, state.u + self.numbering.nodes.spread(step.reshape(-1, 3)), state.p, state.share)


class State:
    """Energy, gradient and Hessian at one displacement and pressure; what they share is computed once.

    Dead loads and follower pressures are scaled by `share`; the energy has the latter's as far as they have one.
    """

    def __init__(self, problem: Problem, u: Floats, p: Floats, share: float):
        self.u, self.p, self.share = u, p, share
        self._problem = problem
        self._x = problem.numbering.X + u
        self._frame: tuple[Floats, Floats, Floats] | None = None
        if problem._laws:
            self._psi, self._p, self._h = self._principal(problem._laws)

    def place(self):
        """Have the forms take this displacement and pressure."""
        problem = self._problem
        problem._displacement.x.array[:] = self.u[: problem.numbering.function_nodes].ravel()
        if problem.mixed:
            problem.pressure.x.array[:] = self.p

    def _svd(self) -> tuple[Floats, Floats, Floats]:
        """U, s, V of F at the quadrature points."""
        if self._frame is None:
            self._frame = principal.signed_svd(self._problem._quadrature.deformation_gradient(self.u))
        return self._frame

    def _principal(self, laws: list[Law]) -> tuple[Floats, Floats, Floats]:
        s = self._svd()[1]
        psi, p, h = np.zeros(len(s)), np.zeros((len(s), 3)), np.zeros((len(s), 3, 3))
        for points, law in laws:
            add_at(points, *law.by_stretches(s[points]), psi, p, h)
        return psi, p, h

    @cached_property
    def energy(self) -> float:
        """The energy [µJ], of all processes; not finite where a law does not hold."""
        problem = self._problem
        self.place()
        energy = -self.share * float(np.sum(problem.loads * self.u[: len(problem.loads)]))
        if problem._laws:
            energy += float(self._psi @ problem._quadrature.volume)
        energy += sum(forms.assemble_energy() for forms in problem._hyperelastic)
        energy += sum(surface.energy(self._x) for surface in problem._surfaces)
        energy += sum(self.share * follower.energy(self._x) for follower in problem._followers)
        energy += sum(spring.energy(self._x) for spring in problem._springs)
        return problem.comm.allreduce(energy)

    def gradient(self) -> Floats:
        """The energy's gradient [mN], a vector (owned, 3), held components included."""
        problem = self._problem
        self.place()
        total = np.zeros_like(self.u)
        total[: len(problem.loads)] = -self.share * problem.loads
        flat = total.reshape(-1)
        if problem._laws:
            U, _, V = self._svd()
            problem._quadrature.add_gradient(principal.stress(U, V, self._p), total)
        for forms in problem._hyperelastic:
            forms.add_gradient(flat)
        for surface in problem._surfaces:
            surface.add_gradient(self._x, total)
        for follower in problem._followers:
            follower.add_gradient(self._x, total, self.share)
        for spring in problem._springs:
            spring.add_gradient(self._x, total)
        return problem.numbering.nodes.summed(total)

    def strain(self) -> Floats:
        """The energy's derivative by the pressure [mm³], a vector."""
        self.place()
        parts = np.zeros(self._problem.pressures.count)
        for forms in self._problem.mixed_forms:
            seam.add_vector(forms.by_pressure, parts)
        return self._problem.pressures.summed(parts)

    def by_share(self) -> Floats:
        """The gradient's derivative by the share of the loads [mN], a vector (owned, 3)."""
        problem = self._problem
        forces = np.zeros_like(self.u)
        for follower in problem._followers:
            follower.add_gradient(self._x, forces)
        return problem.numbering.nodes.summed(forces) - problem.loads

    def stresses(self) -> tuple[Floats, Floats, Quadrature]:
        """F and P [kPa] at the points of this process, shape (k q, 3, 3), of all laws together, and the quadrature."""
        problem = self._problem
        self.place()
        F = problem._quadrature.deformation_gradient(self.u)
        P = np.zeros_like(F)
        if problem._laws:
            U, _, V = self._svd()
            P += principal.stress(U, V, self._p)
        for forms in problem._hyperelastic:
            P[problem._points(forms.cells)] += forms.point_stress()
        return F, P, problem._quadrature

    def hessian(self) -> PETSc.Mat:
        """The gradient's exact derivative [mN/mm], in the problem's matrix."""
        self._begin()
        for _, forms in self._problem._tensors:
            seam.add_matrix(forms.tangent, self._problem.stiffness.local)
        return self._finish(kept=1.0)

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """The Hessian with every negative eigenvalue of every point's tangent multiplied by `kept` in [0, 1].

        At 0 it is positive semi-definite.
        """
        problem = self._problem
        self._begin()
        for points, forms in problem._tensors:
            problem._quadrature.add_tangent(points, forms.softened_tangent(kept), problem.stiffness)
        return self._finish(kept)

    def _begin(self):
        self.place()
        self._problem.assemblies += 1
        self._problem.stiffness.clear()

    def _finish(self, kept: float) -> PETSc.Mat:
        """Add what does not come from UFL."""
        problem, stiffness = self._problem, self._problem.stiffness
        stiffness.local.assemble()
        if problem._laws or problem._stretched:
            U, s, V = self._svd()
            p, h = self._curvature()
            problem._quadrature.add_modes(U, V, principal.modes(s, p, h).soften(kept), stiffness)
        for slots, surface in zip(problem._slots, problem._surfaces, strict=True):
            stiffness.add(surface.nodes, slots, surface.hessian(self._x, kept))
        for slots, follower in zip(problem._pressed_slots, problem._followers, strict=True):
            stiffness.add(follower.nodes, slots, self.share * follower.tangent(self._x))
        for spring in problem._springs:
            stiffness.add(spring.nodes, stiffness.slots(spring.nodes), spring.hessian())
        return stiffness.assembled()

    def _curvature(self) -> tuple[Floats, Floats]:
        """Gradient and Hessian of all laws of the singular values."""
        problem = self._problem
        if problem._stretched:
            return self._principal([*problem._laws, *problem._stretched])[1:]
        return self._p, self._h
