"""The Hessian of a scene's energy over its unknowns, factored: for derivatives, and as a metric of descents."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from ....lhm.base.errors import SceneError
from ....lhm.base.geometry.cholesky import LinearSolver, Solve, factorise_definite
from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats
from ...scene import Scene
from ...terms import Contact, Target
from ..terms.energy import ENERGIES, Energy
from ..terms.gaps import Pairs
from ..terms.springs import Springs
from ..unknowns.coordinates import Coordinates, Place
from ..unknowns.sparsity import Sparsity

EXACT = -1.0
"""Value of `least` by which no eigenvalue is raised."""
KEPT = 3
"""Sparsities that a process keeps, some tens of megabytes each: of skins with bending, without, and of tets."""
SHIFT = 1e-7
"""Relative diagonal shift of a raised Hessian, which may still be singular where tissue resists nothing."""


def hessian(
    scene: Scene, energy: Energy, coordinates: Coordinates, sparsity: Sparsity, place: Place, *, least: float
) -> csc_matrix:
    """Assemble the Hessian [mN/mm], shape (size, size), at a place: exact, or with eigenvalues raised.

    With `least` EXACT it is the derivative of `Coordinates.pull` of the gradient. Else each element's share has no
    eigenvalue below `least` times its strain weight, bending's rotations are held, and the sum is positive definite
    where the scene is held.
    """
    blocks = np.zeros((len(sparsity.pairs), 3, 3))
    for part, slots in zip(energy.parts, sparsity.slots, strict=True):
        part.add_tangent(slots, least, place.u, blocks)
    gradient = energy.evaluate(place.u)[1] if coordinates.bodies else np.zeros_like(place.u)
    return sparsity.matrix(blocks, _body_rows(sparsity, blocks, coordinates, place, gradient, least=least))


_latest: list[Sparsity] = []
"""The KEPT sparsities that were asked for last, the latest first."""


def find_sparsity(scene: Scene, energy: Energy, coordinates: Coordinates) -> Sparsity:
    """Return the sparsity of a scene's Hessian: one of the latest, where it fits.

    It takes longer to find than numbers take to factor, and is the same for all heads of a template. Those with pairs
    in contact are not kept: hardly two frames have the same.
    """
    fitting = (each for each in _latest if each.fits(scene, energy.parts, coordinates))
    sparsity = next(fitting, None) or Sparsity.from_scene(scene, energy.parts, coordinates)
    if energy.part(Pairs) is None:
        _latest[:] = [sparsity, *(other for other in _latest if other is not sparsity)][:KEPT]
    return sparsity


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
    ) -> Tangent:
        """Factor `hessian` at a place, with eigenvalues raised to 0 where it has to be."""
        if scene.of(Contact):
            raise SceneError("a tangent knows no Contact: take `freeze_contact`'s scene")
        sparsity = find_sparsity(scene, energy, coordinates)
        if least < 0.0:
            matrix = hessian(scene, energy, coordinates, sparsity, place, least=EXACT)
            try:
                factor = factorise_definite(matrix, linear_solver=linear_solver)
                return cls(scene, energy, coordinates, sparsity, place, True, factor)
            except np.linalg.LinAlgError:
                least = 0.0
        matrix = hessian(scene, energy, coordinates, sparsity, place, least=least)
        diagonal = matrix.diagonal()
        matrix.setdiag(np.where(diagonal > 0.0, (1.0 + SHIFT) * diagonal, 1.0))
        factor = factorise_definite(matrix, linear_solver=linear_solver)
        return cls(scene, energy, coordinates, sparsity, place, False, factor)

    def solve(self, right: Floats) -> Floats:
        """Apply the inverse Hessian to gradients [mN] over the unknowns, shape (size,) or (size, k): steps [mm]."""
        return self.factor(right.reshape(len(right), -1)).reshape(right.shape)

    def adjoint(self, cotangent: Floats) -> Adjoint:
        """Prepare the derivative of Σ cotangent · x over vertices, shape (n, 3), by all that the scene is made of."""
        return Adjoint(self, cotangent, self.solve(self.coordinates.pull(cotangent, self.place)))

    def vertices_by_targets(self, moved: Floats) -> Floats:
        """Move vertices, shape (k, n, 3), to first order, as the first Target moves by `moved` (k, targets, 3)."""
        if not self.scene.of(Target):
            raise SceneError("the scene has no Target that could move")
        target = self.scene.of(Target)[0]
        moved = np.asarray(moved, dtype=np.float64)
        if moved.ndim != 3 or moved.shape[1:] != target.positions.shape or not np.isfinite(moved).all():
            raise SceneError(f"moved targets: expected finite values of shape (k, {len(target.positions)}, 3)")
        springs = self.energy.part(Springs)
        assert springs is not None
        matrix = springs.drawn[0][2]
        right = np.empty((self.coordinates.size, len(moved)))
        force = np.zeros(self.place.u.shape)
        for k, move in enumerate(moved):
            force[target.vertices] = matrix @ move
            right[:, k] = self.coordinates.pull(force, self.place)
        return np.stack([self.coordinates.push(step, self.place) for step in self.solve(right).T])

    def vertices_by_scenes(self, changes: Iterable[Iterable[tuple[Scene, float]]]) -> Floats:
        """Move vertices, shape (k, n, 3), to first order as the scene changes; by implicit differentiation.

        Each change is a difference quotient: scenes near by, each with its weight [1/unit of the change], such as
        ((ahead, 1/(2h)), (behind, -1/(2h))). They may differ in all numbers, also in what is Fixed and in bodies' rest,
        but not in vertices, tets and what is held; SceneError says where they do.
        """
        right, base = [], []
        for change in changes:
            force, carried = np.zeros(self.coordinates.size), np.zeros_like(self.place.u)
            for scene, weight in change:
                coordinates, place, gradient = self.gradient_in(scene)
                force -= weight * coordinates.pull(gradient, place)
                carried += weight * (place.u - self.place.u)
            right.append(force)
            base.append(carried)
        if not right:
            return np.zeros((0, *self.place.u.shape))
        steps = self.solve(np.stack(right, axis=1))
        pushed = (self.coordinates.push(step, self.place) for step in steps.T)
        return np.stack([carried + moved for carried, moved in zip(base, pushed, strict=True)])

    def gradient_in(self, scene: Scene) -> tuple[Coordinates, Place, Floats]:
        """Return the coordinates of another scene, its place where the unknowns stay, and the gradient [mN], (n, 3)."""
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
        return coordinates, Place(u, self.place.rotations), self._energy_of(scene).evaluate(u)[1]

    def _energy_of(self, scene: Scene) -> Energy:
        """Return the energy of another scene: its numbers on the same elements, where the terms are the same."""
        mine, its = (
            [(type(t), t.element_vertices(which)) for t in which.terms if isinstance(t, ENERGIES)]
            for which in (self.scene, scene)
        )
        same = len(mine) == len(its) and all(
            kind is its_kind and np.array_equal(elements, its_elements)
            for (kind, elements), (its_kind, its_elements) in zip(mine, its, strict=True)
        )
        return self.energy.rebuilt(scene) if same else Energy.from_scene(scene)


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Derivatives of Σ cotangent · x, (n, 3), where x minimises a scene's energy: one solve for all of them.

    step [mm per mN, times the cotangent's unit]: the inverse Hessian times the cotangent, over the unknowns.
    """

    tangent: Tangent
    cotangent: Floats
    step: Floats

    def by_targets(self) -> Floats:
        """Return the derivative by the first Target's positions, shape (targets, 3)."""
        springs = self.tangent.energy.part(Springs)
        assert springs is not None
        vertices, _, matrix = springs.drawn[0]
        return matrix @ self.tangent.coordinates.push(self.step, self.tangent.place)[vertices]

    def by_scenes(self, change: Iterable[tuple[Scene, float]]) -> Floats:
        """Return each vertex' share of the derivative as the scene changes, shape (n,); their sum is the derivative.

        change as of `Tangent.vertices_by_scenes`. What acts on some vertices alone has its derivative in their shares.
        """
        shares = np.zeros(len(self.cotangent))
        for scene, weight in change:
            coordinates, place, gradient = self.tangent.gradient_in(scene)
            moved = coordinates.push(self.step, place)
            shares += weight * np.sum(self.cotangent * place.u - moved * gradient, axis=1)
        return shares


def _body_rows(
    sparsity: Sparsity, blocks: Floats, coordinates: Coordinates, place: Place, gradient: Floats, *, least: float
) -> Floats:
    """Assemble the bodies' rows of the Hessian, (6 bodies, size), at a place with this gradient [mN], shape (n, 3).

    The share that a turn adds by the forces alone is raised to zero where it is negative, unless `least` is.
    """
    n, free, count = len(place.u), len(coordinates.index), len(coordinates.bodies)
    rows = np.zeros((6 * count, coordinates.size))
    if not count:
        return rows
    owner, motion = np.full(n, -1), np.zeros((n, 3, 6))
    for b, body in enumerate(coordinates.bodies):
        owner[body.vertices] = b
        motion[body.vertices, :, :3] = np.eye(3)
        arms = body.arms @ place.rotations[b].T
        motion[body.vertices, :, 3:] = np.cross(np.eye(3), arms[:, None, :]).transpose(0, 2, 1)
    over = np.zeros((6 * count, 3 * n))
    _add_carried(sparsity.pairs, blocks, owner, motion, over)
    rows[:, :free] = over[:, coordinates.index]
    for b, body in enumerate(coordinates.bodies):
        own = motion[body.vertices].reshape(-1, 6)
        columns = (3 * body.vertices[:, None] + np.arange(3)).ravel()
        block = slice(free + 6 * b, free + 6 * b + 6)
        rows[:, block] = over[:, columns] @ own
        # The second derivative of a turned arm a along the force g: (θ·a)(θ·g) - (a·g) |θ|².
        arms = body.arms @ place.rotations[b].T
        moment = arms.T @ gradient[body.vertices]
        curved = 0.5 * (moment + moment.T) - np.trace(moment) * np.eye(3)
        if least >= 0.0:
            values, vectors = np.linalg.eigh(curved)
            curved = (vectors * np.maximum(values, 0.0)) @ vectors.T
        rows[6 * b + 3 : 6 * b + 6, free + 6 * b + 3 : free + 6 * b + 6] += curved / body.radius
    return rows


@njit(cache=True)
def _add_carried(pairs, blocks, owner, motion, over):
    """Add motionᵀ K to the rows of the bodies for all blocks that touch one."""
    for k in range(len(pairs)):
        high, low = pairs[k]
        b = owner[high]
        if b >= 0:
            for m in range(6):
                for c in range(3):
                    for r in range(3):
                        over[6 * b + m, 3 * low + c] += motion[high, r, m] * blocks[k, r, c]
        b = owner[low]
        if b >= 0 and high != low:
            for m in range(6):
                for c in range(3):
                    for r in range(3):
                        over[6 * b + m, 3 * high + c] += motion[low, r, m] * blocks[k, c, r]
