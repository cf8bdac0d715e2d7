"""The Hessian of a scene's energy over its unknowns, factored: for responses, and as a metric of descents."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_matrix

from ...lhm.base.errors import SceneError
from ...lhm.base.geometry import cholesky
from ...lhm.base.geometry.cholesky import LinearSolver, Solve, factorise_definite
from ...lhm.base.mesh import Floats
from ..scene import Scene
from ..terms import Bending, Contact, Strain, SurfaceStrain, Target, Volume
from .bending import Rings, add_bending_bound, add_bending_tangent
from .coordinates import Coordinates, Place
from .energy import Energy
from .sparsity import Sparsity, body_rows, elements_of
from .tets import add_tet_tangent
from .triangles import add_triangle_tangent

EXACT = -1.0
"""Of `least`: no eigenvalue is raised."""
SHIFT = 1e-7
"""Relative diagonal shift of a raised Hessian, which may still be singular where tissue resists nothing."""


def hessian(
    scene: Scene, energy: Energy, coordinates: Coordinates, sparsity: Sparsity, place: Place, *, least: float
) -> csc_matrix:
    """The Hessian [mN/mm], shape (size, size), over the unknowns at a place: exact, or with eigenvalues raised.

    With `least` EXACT it is the derivative of `Coordinates.pull` of the gradient. Else each element's share has no
    eigenvalue below `least` times its Strain weight, Bending's rotations are held, and the sum is positive definite
    where the scene is held.
    """
    blocks = np.zeros((len(sparsity.pairs), 3, 3))
    tets, triangles, rings = energy.tets, energy.triangles, energy.bending
    if tets is not None:
        layout = (
            tets.parameters.reshape(len(tets.parameters), -1),
            tets.corners.reshape(len(tets.corners), -1),
            tets.has_volume,
            len(tets.tets),
        )
        add_tet_tangent(*layout, sparsity.tets, least, place.u, blocks)
    if triangles is not None:
        parts = (triangles.corners, triangles.inverse, triangles.weights, triangles.scale, triangles.edges)
        add_triangle_tangent(*parts, sparsity.triangles, least, place.u, blocks)
    if rings is not None and least < 0.0:
        shape = (rings.centres, rings.starts, rings.ring, rings.cotangents, rings.edges, rings.sought, rings.laplacians)
        add_bending_tangent(*shape, rings.least, rings.weights, sparsity.rings, sparsity.first, place.u, blocks)
    elif rings is not None:
        add_bending_bound(rings.starts, rings.cotangents, rings.weights, sparsity.rings, sparsity.first, blocks)
    for vertices, _, stiffness in energy.targets:
        for r in range(3):
            blocks[sparsity.diagonal[vertices], r, r] += stiffness.ravel()
    gradient = energy.evaluate(place.u)[1] if coordinates.bodies else np.zeros_like(place.u)
    return sparsity.matrix(blocks, body_rows(sparsity, blocks, coordinates, place, gradient, least=least))


@dataclass(frozen=True, eq=False)
class Pattern:
    """What all tangents of a topology share: where entries are, and, by CHOLMOD, in which order they are eliminated."""

    sparsity: Sparsity
    analysis: cholesky.CholmodAnalysis | None


@dataclass(frozen=True, eq=False)
class Tangent:
    """The Hessian of a scene's energy at a place, factored.

    `is_exact` is False where the exact one is not positive definite, or was not asked for: then its eigenvalues are
    raised element by element, which makes a metric for a descent, but no derivative.
    """

    scene: Scene
    energy: Energy
    coordinates: Coordinates
    sparsity: Sparsity
    place: Place
    is_exact: bool
    factor: Solve

    @classmethod
    def from_scene(
        cls,
        scene: Scene,
        energy: Energy,
        coordinates: Coordinates,
        place: Place,
        *,
        least: float = EXACT,
        linear_solver: LinearSolver | None = None,
        like: Tangent | Pattern | None = None,
    ) -> Tangent:
        """Factor `hessian` at a place, with eigenvalues raised to 0 where it has to be; `like` lends its pattern."""
        if scene.of(Contact):
            raise SceneError("a tangent knows no Contact: take the scene without it")
        pattern = like.pattern if isinstance(like, Tangent) else like
        if pattern is None or not pattern.sparsity.fits(elements_of(scene, energy, coordinates)):
            pattern = Pattern(Sparsity.from_scene(scene, energy, coordinates), None)
        sparsity, before = pattern.sparsity, pattern.analysis
        if least < 0.0:
            matrix = hessian(scene, energy, coordinates, sparsity, place, least=EXACT)
            try:
                factor = factorise_definite(matrix, linear_solver=linear_solver, like=before)
                return cls(scene, energy, coordinates, sparsity, place, True, factor)
            except np.linalg.LinAlgError:
                least = 0.0
        matrix = hessian(scene, energy, coordinates, sparsity, place, least=least)
        diagonal = matrix.diagonal()
        matrix.setdiag(np.where(diagonal > 0.0, (1.0 + SHIFT) * diagonal, 1.0))
        factor = factorise_definite(matrix, linear_solver=linear_solver, like=before)
        return cls(scene, energy, coordinates, sparsity, place, False, factor)

    @property
    def pattern(self) -> Pattern:
        """What serves again when its numbers, a quarter of a gigabyte for a head, are let go."""
        return Pattern(self.sparsity, self.factor.analysis if isinstance(self.factor, cholesky.CholmodFactor) else None)

    def solve(self, right: Floats) -> Floats:
        """The inverse Hessian times gradients [mN] over the unknowns, shape (size,) or (size, k): steps [mm]."""
        return self.factor(right.reshape(len(right), -1)).reshape(right.shape)

    def vertices_by_targets(self, moved: Floats) -> Floats:
        """How vertices move, shape (k, n, 3), where the first Target's positions move by `moved`, (k, targets, 3)."""
        if not self.scene.of(Target):
            raise SceneError("the scene has no Target that could move")
        target = self.scene.of(Target)[0]
        moved = np.asarray(moved, dtype=np.float64)
        if moved.ndim != 3 or moved.shape[1:] != target.positions.shape or not np.isfinite(moved).all():
            raise SceneError(f"moved targets: expected finite values of shape (k, {len(target.positions)}, 3)")
        right = np.empty((self.coordinates.size, len(moved)))
        force = np.zeros(self.place.u.shape)
        for k, move in enumerate(moved):
            force[target.vertices] = np.reshape(target.stiffness, (-1, 1)) * move
            right[:, k] = self.coordinates.pull(force, self.place)
        return np.stack([self._moved(step) for step in self.solve(right).T])

    def vertices_by_scenes(self, changes: Iterable[Iterable[tuple[Scene, float]]]) -> Floats:
        """How vertices move, shape (k, n, 3), where the scene changes; by implicit differentiation.

        Each change is a difference quotient: scenes near by, each with its weight [1/unit of the change], such as
        ((ahead, 1/(2h)), (behind, -1/(2h))). They may differ in all numbers, also in what is Fixed and in bodies' rest,
        but not in vertices, tets and what is held; SceneError says where they do.
        """
        right, base = [], []
        for change in changes:
            force, carried = np.zeros(self.coordinates.size), np.zeros_like(self.place.u)
            for scene, weight in change:
                gradient, u = self._gradient_in(scene)
                force -= weight * gradient
                carried += weight * (u - self.place.u)
            right.append(force)
            base.append(carried)
        if not right:
            return np.zeros((0, *self.place.u.shape))
        steps = self.solve(np.stack(right, axis=1))
        return np.stack([carried + self._moved(step) for carried, step in zip(base, steps.T, strict=True)])

    def _gradient_in(self, scene: Scene) -> tuple[Floats, Floats]:
        """Gradient [mN] over the unknowns in another scene, and the displacement [mm], where the unknowns stay."""
        coordinates = Coordinates.from_scene(scene)
        mine = (self.scene.vertices, self.scene.tets, self.coordinates.index)
        same = all(map(np.array_equal, mine, (scene.vertices, scene.tets, coordinates.index)))
        bodies = [body.vertices for body in self.coordinates.bodies]
        if not same or len(bodies) != len(coordinates.bodies):
            raise SceneError("a scene to differentiate by has other vertices, tets, bodies or held components")
        held, values = scene.dirichlet()
        u = np.where(held, values - scene.vertices, self.place.u)
        for body, its, rotation in zip(self.coordinates.bodies, coordinates.bodies, self.place.rotations, strict=True):
            its.put(u, body.shift(self.place.u), rotation)
        gradient = self._energy_of(scene).evaluate(u)[1]
        return coordinates.pull(gradient, Place(u, self.place.rotations)), u

    def _energy_of(self, scene: Scene) -> Energy:
        """The energy of another scene: with numbers of its own on the same elements, where the terms are the same."""
        kinds = (Strain, Volume, SurfaceStrain, Bending)
        mine, its = ([term for kind in kinds for term in which.of(kind)] for which in (self.scene, scene))
        same = [type(term) for term in mine] == [type(term) for term in its]
        if not same or any(isinstance(t, SurfaceStrain) and t.rest is not None for t in its):
            return Energy.from_scene(scene)
        energy = self.energy.for_scene(scene)
        return energy if energy.bending is None else replace(energy, bending=Rings.from_scene(scene))

    def _moved(self, step: Floats) -> Floats:
        """The displacement [mm], shape (n, 3), that a small step over the unknowns makes."""
        moved = np.zeros_like(self.place.u)
        moved.reshape(-1)[self.coordinates.index] = step[: len(self.coordinates.index)]
        motions = step[len(self.coordinates.index) :].reshape(-1, 6)
        for body, rotation, motion in zip(self.coordinates.bodies, self.place.rotations, motions, strict=True):
            moved[body.vertices] = motion[:3] + np.cross(motion[3:], body.arms @ rotation.T)
        return moved
