"""The scene's energy, gradient and Hessian over the displacement's dofs: FEniCSx's forms and the discrete terms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats, Ints
from ..materials import Corotated, Material, NeoHookean, StableNeoHookean
from ..scene import Scene
from ..terms import Bending, Hyperelastic, RigidBody, Strain, SurfaceStrain, Target, Volume
from . import dolfinx_version as seam
from . import principal
from .assembly import Stiffness, rigid_motions
from .bending import Rings
from .densities import DENSITIES
from .dolfinx_version import PETSc
from .hyperelastic import HyperelasticForms
from .laws import (
    CorotatedLaw,
    Grown,
    NeoHookeanLaw,
    PrincipalLaw,
    StableNeoHookeanLaw,
    StrainLaw,
    VolumeLaw,
    add_at,
)
from .loads import dead_loads
from .membrane import Membrane
from .mixed_forms import MixedForms
from .numbering import Numbering
from .quadrature import DEGREES, Quadrature

Law = tuple[Ints, PrincipalLaw]
"""A law and the quadrature points, counted within Quadrature, that it acts on."""
BY_STRETCHES = (NeoHookean, StableNeoHookean)
"""Laws whose energy and stress are UFL's; their tangent is by singular values, where to soften it is cheap."""
LAWS: dict[type[Material], Callable[[Floats, Floats], PrincipalLaw]] = {
    Corotated: CorotatedLaw,
    NeoHookean: NeoHookeanLaw,
    StableNeoHookean: StableNeoHookeanLaw,
}


@dataclass(frozen=True, eq=False)
class Spring:
    """Springs of targets or of inertia: dofs (k,), positions [mm] (k, 3), stiffness [mN/mm] (k,)."""

    dofs: Ints
    positions: Floats
    stiffness: Floats


class Problem:
    """What does not change within a sequence (mesh, forms, matrix), and the present scene's numbers.

    Vectors are of shape (n, 3), by dof. `matrix` is the one that every Hessian is assembled into. The laws of a
    mixed problem have the pressure [kPa] of linear elements, a function that is given from outside.
    """

    def __init__(self, scene: Scene, numbering: Numbering, *, mixed: bool = False):
        self.numbering = numbering
        self.assemblies = 0
        self._displacement = seam.function(numbering.space)
        self.pressure = seam.function(seam.pressure_space(numbering.space.mesh)) if mixed else None
        self.pressure_dofs: Ints = np.empty((0, 4), dtype=np.int64)
        if self.pressure is not None:
            self.pressure_dofs = seam.cell_dofs(self.pressure.function_space, 4)
        own = self._own(scene)
        cells = self._solid_cells(own)
        self._degree = DEGREES[numbering.degree]
        self._quadrature = Quadrature(numbering, cells, self._degree)
        self._hyperelastic = [self._forms(term, self._cells(own, term)) for term in self._by_ufl(own)]
        self._tensors = [
            (self._points(forms.cells), forms)
            for forms, term in zip(self._hyperelastic, self._by_ufl(own), strict=True)
            if mixed or not isinstance(term.material, BY_STRETCHES)
        ]
        n = len(numbering.X)
        self._faces = [numbering.face_dofs(term.name, term.triangles) for term in scene.of(SurfaceStrain)]
        self._surfaces = self._surfaces_of(scene)
        nodes = [surface.nodes for surface in self._surfaces]
        self.stiffness = Stiffness([numbering.cell_dofs, *nodes], n)
        self._slots = [self.stiffness.slots(surface) for surface in nodes]
        self.matrix = self.stiffness.matrix
        self.matrix.setNearNullSpace(rigid_motions(numbering.X))
        springs = [numbering.dofs_of(term.name, term.vertices) for term in scene.of(Target)]
        springs.append(numbering.dofs_of("Inertia", np.flatnonzero(scene.inertia()[0])))
        self.unsupported = np.ones(n, dtype=bool)
        for dofs in (numbering.cell_dofs[self._solid_cells(scene)], *nodes, *springs):
            self.unsupported[dofs.ravel()] = False
        for body in scene.of(RigidBody):
            dofs = numbering.dofs_of(body.name, body.vertices)
            self.unsupported[dofs] = self.unsupported[dofs].all()
        self.set(scene)

    def _own(self, scene: Scene) -> Scene:
        """The scene with those of its solids that are integrated here: all, unless other processes share the work."""
        return scene

    def _solid_cells(self, scene: Scene) -> Ints:
        """The cells that some solid acts on, sorted."""
        solids = [t for t in scene.terms if isinstance(t, (Strain, Volume, Hyperelastic))]
        empty = np.empty(0, dtype=np.int64)
        return np.unique(np.concatenate([empty, *(self._cells(scene, term) for term in solids)]))

    def _cells(self, scene: Scene, term) -> Ints:
        return self.numbering.cell[scene.tets_of(term)]

    def _points(self, cells: Ints) -> Ints:
        """The quadrature points of cells (k,), counted within Quadrature, shape (k q,)."""
        q = self._quadrature.per_cell
        return (np.searchsorted(self._quadrature.cells, cells)[:, None] * q + np.arange(q)).ravel()

    def _by_ufl(self, scene: Scene) -> list[Hyperelastic]:
        solids = scene.of(Hyperelastic)
        return solids if self.pressure is not None else [t for t in solids if type(t.material) in DENSITIES]

    def _forms(self, term: Hyperelastic, cells: Ints) -> HyperelasticForms:
        if self.pressure is not None:
            return MixedForms.of_both(
                self._displacement, self.pressure, cells, term.material, self._degree, term.growth
            )
        return HyperelasticForms.of(self._displacement, cells, term.material, self._degree, term.growth)

    def set(self, scene: Scene):
        """Take a scene's stiffnesses, targets and loads; SceneError for a load on a vertex that no energy holds."""
        order = self.numbering
        loads = scene.loads()
        loose = (order.dof < 0) | self.unsupported[order.dof]
        bad = np.flatnonzero(loose & loads.any(axis=1) & ~scene.dirichlet()[0].all(axis=1))
        if bad.size:
            raise SceneError(f"vertex {bad[0]} carries a load, but no energy acts on it")
        self.loads = dead_loads(scene, order)
        self._surfaces = self._surfaces_of(scene)
        self._springs = [
            Spring(order.dof[t.vertices], t.positions, np.broadcast_to(t.stiffness, len(t.vertices)))
            for t in scene.of(Target)
        ]
        stiffness, places = scene.inertia()
        moving = np.flatnonzero(stiffness)
        self._springs.append(Spring(order.dof[moving], places[moving], stiffness[moving]))
        own = self._own(scene)
        solids = own.of(Hyperelastic)
        corotated = [term for term in solids if isinstance(term.material, Corotated)]
        self._laws = [self._law(own, term) for term in (*own.of(Strain), *own.of(Volume), *corotated)]
        stretched = [t for t in solids if isinstance(t.material, BY_STRETCHES) and self.pressure is None]
        self._stretched = [self._law(own, term) for term in stretched]
        self.energy_scale = scene.force_scale() * float(np.cbrt(scene.volumes).sum())

    def _surfaces_of(self, scene: Scene) -> list[Membrane | Rings]:
        strained = zip(scene.of(SurfaceStrain), self._faces, strict=True)
        surfaces: list[Membrane | Rings] = [Membrane.of(term, scene.vertices, nodes) for term, nodes in strained]
        for term in scene.of(Bending):
            self.numbering.dofs_of(term.name, term.triangles)
            surfaces += Rings.of(term, scene.vertices, self.numbering.dof)
        return surfaces

    def _law(self, scene: Scene, term: Strain | Volume | Hyperelastic) -> Law:
        tets = scene.tets_of(term)
        points = self._points(self._cells(scene, term))

        def at_points(values) -> Floats:
            return np.repeat(np.broadcast_to(values, len(tets)), self._quadrature.per_cell).astype(np.float64)

        if isinstance(term, Strain):
            return points, StrainLaw(at_points(term.stiffness), at_points(term.limit), at_points(term.growth))
        if isinstance(term, Volume):
            return points, VolumeLaw(at_points(term.stiffness), at_points(term.target))
        assert isinstance(term.material, (Corotated, *BY_STRETCHES))
        law = LAWS[type(term.material)](at_points(term.material.mu), at_points(term.material.lmbda))
        return points, law if np.all(term.growth == 1.0) else Grown(law, at_points(term.growth))

    @property
    def mixed_forms(self) -> list[MixedForms]:
        """The forms of laws with a pressure."""
        return [forms for forms in self._hyperelastic if isinstance(forms, MixedForms)]

    def at(self, u: Floats) -> State:
        """The problem at a displacement [mm], shape (n, 3)."""
        return State(self, u)

    def moved(self, state: State, step: Floats) -> State:
        """The problem after a step of all dofs [mm], shape (3n,)."""
        return State(self, state.u + step.reshape(state.u.shape))


class State:
    """Energy, gradient and Hessian at one displacement; what they share is computed once."""

    def __init__(self, problem: Problem, u: Floats):
        self.u = u
        self._problem = problem
        self._x = problem.numbering.X + u
        self._place()
        self._frame: tuple[Floats, Floats, Floats] | None = None
        if problem._laws:
            self._psi, self._p, self._h = self._principal(problem._laws)
        self.energy = self._energy()

    def _place(self):
        self._problem._displacement.x.array[:] = self.u.ravel()

    def _svd(self) -> tuple[Floats, Floats, Floats]:
        """U, s, V of F at the quadrature points."""
        if self._frame is None:
            self._frame = principal.signed_svd(self._problem._quadrature.deformation_gradient(self.u))
        return self._frame

    def _principal(self, laws: list[Law]) -> tuple[Floats, Floats, Floats]:
        s = self._svd()[1]
        psi, p, h = np.zeros(len(s)), np.zeros((len(s), 3)), np.zeros((len(s), 3, 3))
        for points, law in laws:
            add_at(points, *law.evaluate(s[points]), psi, p, h)
        return psi, p, h

    def _energy(self) -> float:
        problem = self._problem
        energy = -float(np.sum(problem.loads * self.u))
        if problem._laws:
            energy += float(self._psi @ problem._quadrature.volume)
        energy += sum(forms.assemble_energy() for forms in problem._hyperelastic)
        energy += sum(surface.energy(self._x) for surface in problem._surfaces)
        for spring in problem._springs:
            away = self._x[spring.dofs] - spring.positions
            energy += 0.5 * float(spring.stiffness @ np.sum(away**2, axis=1))
        return energy

    def gradient(self) -> Floats:
        """The energy's gradient [mN], shape (n, 3), held components included."""
        problem = self._problem
        self._place()
        total = -problem.loads
        flat = total.reshape(-1)
        if problem._laws:
            U, _, V = self._svd()
            problem._quadrature.add_gradient(principal.stress(U, V, self._p), total)
        for forms in problem._hyperelastic:
            forms.add_gradient(flat)
        for surface in problem._surfaces:
            surface.add_gradient(self._x, total)
        for spring in problem._springs:
            total[spring.dofs] += spring.stiffness[:, None] * (self._x[spring.dofs] - spring.positions)
        return total

    def stresses(self) -> tuple[Floats, Floats, Quadrature]:
        """F and P [kPa] at the quadrature's points, shape (k q, 3, 3), of all laws together, and the quadrature."""
        problem = self._problem
        self._place()
        F = problem._quadrature.deformation_gradient(self.u)
        P = np.zeros_like(F)
        if problem._laws:
            U, _, V = self._svd()
            P += principal.stress(U, V, self._p)
        for forms in problem._hyperelastic:
            P[problem._points(forms.cells)] += forms.point_stress()
        return F, P, problem._quadrature

    def hessian(self) -> PETSc.Mat:
        """The exact Hessian [mN/mm], in the problem's matrix."""
        self._begin()
        for _, forms in self._problem._tensors:
            seam.add_matrix(forms.tangent, self._problem.matrix)
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
        self._place()
        self._problem.assemblies += 1
        self._problem.stiffness.clear()

    def _finish(self, kept: float) -> PETSc.Mat:
        """Add what does not come from UFL."""
        problem, stiffness = self._problem, self._problem.stiffness
        problem.matrix.assemble()
        if problem._laws or problem._stretched:
            U, s, V = self._svd()
            p, h = self._curvature()
            problem._quadrature.add_modes(U, V, principal.modes(s, p, h).softened(kept), stiffness)
        for slots, surface in zip(problem._slots, problem._surfaces, strict=True):
            stiffness.add(surface.nodes, slots, surface.hessian(self._x, kept))
        for spring in problem._springs:
            nodes = spring.dofs[:, None]
            stiffness.add(nodes, stiffness.slots(nodes), np.multiply.outer(spring.stiffness, np.eye(3))[:, None, None])
        problem.matrix.assemble()
        return problem.matrix

    def _curvature(self) -> tuple[Floats, Floats]:
        """Gradient and Hessian of all laws of the singular values."""
        problem = self._problem
        if problem._stretched:
            return self._principal([*problem._laws, *problem._stretched])[1:]
        return self._p, self._h
