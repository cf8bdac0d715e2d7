"""L-BFGS with a Laplacian in front (Liu, Bouaziz, Kavan 2017): one file, one solver."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

from softdeca.reference import Reason, Scene, SceneError, Solution, add_solver, terms
from softdeca.reference.clock import Clock, Seconds
from softdeca.reference.materials import NeoHookean
from softdeca.reference.scene import refuse_unknown
from softdeca.reference.solution import Limits, Recorder, first_positions, volume_ratio

NAME = "quasi-newton"
KNOWN = (
    terms.Hyperelastic,
    terms.Strain,
    terms.Target,
    terms.Fixed,
    terms.Gravity,
    terms.Traction,
)
MEMORY, MAX_ITERATIONS = 10, 2000


def strain(term, F):
    """Energy [kPa], (m,), and stress (m, 3, 3) of k/2 |F - R|², R the rotation nearest to F."""
    U, _, Vt = np.linalg.svd(F)
    U[np.linalg.det(U @ Vt) < 0, :, 2] *= -1
    away = F - U @ Vt
    stiffness = np.broadcast_to(term.stiffness, len(F))
    return stiffness / 2 * np.sum(away**2, axis=(1, 2)), stiffness[:, None, None] * away


def neo_hookean(term, F):
    """Energy [kPa], (m,), and stress (m, 3, 3) of mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J."""
    law, J = term.material, np.linalg.det(F)
    if J.min() <= 0:
        return np.full(len(F), np.inf), F
    log_J, inverse = np.log(J), np.linalg.inv(F).transpose(0, 2, 1)
    psi = (
        law.mu / 2 * (np.sum(F**2, axis=(1, 2)) - 3)
        - law.mu * log_J
        + law.lmbda / 2 * log_J**2
    )
    return psi, law.mu * F + (law.lmbda * log_J - law.mu)[:, None, None] * inverse


class Energy:
    """A scene's energy [µJ] and its gradient [mN]."""

    def __init__(self, scene: Scene):
        edges = scene.vertices[scene.tets[:, 1:]] - scene.vertices[scene.tets[:, :1]]
        slopes = np.linalg.inv(edges).transpose(0, 2, 1)
        slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
        rows = np.arange(3 * len(scene.tets)).reshape(-1, 1, 3)
        columns = np.broadcast_to(scene.tets[:, :, None], slopes.shape)
        places = np.broadcast_to(rows, slopes.shape).ravel(), columns.ravel()
        shape = 3 * len(scene.tets), len(scene.vertices)
        self.scene, self.slope = scene, csr_matrix((slopes.ravel(), places), shape)
        self.laws = [(strain if isinstance(t, terms.Strain) else neo_hookean, t, scene.tets_of(t))
                     for t in scene.terms if isinstance(t, (terms.Strain, terms.Hyperelastic))]  # fmt: skip
        self.loads = scene.loads()
        self.stiffness = np.zeros(len(scene.tets))
        for _, term, tets in self.laws:
            hyperelastic = isinstance(term, terms.Hyperelastic)
            self.stiffness[tets] += (
                term.material.stiffness if hyperelastic else term.stiffness
            )
        self.scale = np.sum(self.stiffness * scene.volumes)

    def laplacian(self):
        """The Hessian of |∇x|² with each tet's stiffness, and of the springs [mN/mm], (n, n)."""
        springs = np.zeros(len(self.scene.vertices))
        for term in self.scene.of(terms.Target):
            springs[term.vertices] += term.stiffness
        return self.slope.T @ diags(
            np.repeat(self.stiffness * self.scene.volumes, 3)
        ) @ self.slope + diags(springs)

    def at(self, x):
        """Energy and gradient (n, 3) at positions x [mm], (n, 3); infinite where a law does not hold."""
        F = (self.slope @ x).reshape(-1, 3, 3).transpose(0, 2, 1)
        total, stress = (
            -np.sum(self.loads * (x - self.scene.vertices)),
            np.zeros_like(F),
        )
        for law, term, tets in self.laws:
            psi, P = law(term, F[tets])
            total += self.scene.volumes[tets] @ psi
            stress[tets] += P
        gradient = -self.loads
        if np.isfinite(total):
            force = self.scene.volumes[:, None, None] * stress.transpose(0, 2, 1)
            gradient = gradient + self.slope.T @ force.reshape(-1, 3)
        for term in self.scene.of(terms.Target):
            pulled = x[term.vertices] - term.positions
            stiffness = np.broadcast_to(term.stiffness, len(pulled))[:, None]
            total += np.sum(stiffness * pulled**2) / 2
            gradient[term.vertices] += stiffness * pulled
        return total, gradient


@dataclass(frozen=True, eq=False)
class Prepared:
    """The Laplacian's factors, one for each coordinate, whose held vertices may differ."""

    scene: Scene
    held: np.ndarray
    factors: tuple
    spent: Seconds

    def solve(self, scene=None, *, start=None, tolerance=1e-6, absolute=None,
              max_iterations=None, on_iteration=None):  # fmt: skip
        """See softdeca.reference.Prepared."""
        scene = self.scene if scene is None else scene
        self.scene.check_prepared_for(scene)
        recorder, limits, energy = (
            Recorder(on_iteration),
            Limits(tolerance, absolute, max_iterations),
            Energy(scene),
        )
        held, places = scene.dirichlet()
        x = np.where(held, places, first_positions(scene, start))
        (value, gradient), pairs, count = energy.at(x), [], 0
        gradient[held] = 0
        reason = Reason.CONVERGED if np.isfinite(value) else Reason.NOT_FINITE
        norm = np.linalg.norm(gradient)
        threshold, stop = limits.threshold(scene, norm), recorder.record(x, value, norm)
        while reason is Reason.CONVERGED and norm > threshold:
            if stop or count == (
                MAX_ITERATIONS if max_iterations is None else max_iterations
            ):
                reason = Reason.INTERRUPTED if stop else Reason.MAX_ITERATIONS
                break
            step = -self.two_loops(gradient, pairs)
            found = line_search(energy, x, step, value, gradient, held)
            if found is None:
                reason = Reason.STAGNATED.at_rounding(scene, norm)
                break
            ahead, value, slope = found
            pairs = [*pairs, (ahead - x, slope - gradient)][-MEMORY:]
            if np.sum(pairs[-1][0] * pairs[-1][1]) <= 0:
                pairs = []
            x, gradient, count, norm = ahead, slope, count + 1, np.linalg.norm(slope)
            stop = recorder.record(x, value, norm)
        return Solution(x, reason, count, float(value), recorder.history(), volume_ratio(scene, x),
                        times=recorder.times(self.spent))  # fmt: skip

    def two_loops(self, gradient, pairs):
        """The inverse Hessian by L-BFGS, times the gradient (Nocedal and Wright, Algorithm 7.4)."""
        q, shares = gradient.copy(), []
        for s, y in reversed(pairs):
            shares.append(np.sum(s * q) / np.sum(s * y))
            q -= shares[-1] * y
        step = np.zeros_like(q)
        for c, factor in enumerate(self.factors):
            free = ~self.held[:, c]
            step[free, c] = factor.solve(q[free, c])
        for (s, y), share in zip(pairs, reversed(shares), strict=True):
            step += (share - np.sum(y * step) / np.sum(s * y)) * s
        return step


def line_search(energy, x, step, value, gradient, held):
    """The first of halved steps that lowers the energy enough, or, where rounding hides that, flattens it; or None."""
    downhill, rounding = np.sum(gradient * step), 1e-14 * energy.scale
    for share in 0.5 ** np.arange(40):
        ahead = x + share * step
        found, slope = energy.at(ahead)
        slope[held] = 0
        hidden = -0.1 * share * downhill < rounding
        flatter = abs(np.sum(slope * step)) < -0.9 * downhill
        if found <= value + (rounding if hidden else 0.1 * share * downhill) and (
            flatter or not hidden
        ):
            return ahead, found, slope
    return None


def prepare(scene: Scene):
    """Factor the Laplacian. Raises SceneError for what this solver cannot model."""
    refuse_unknown(scene, NAME, KNOWN, (NeoHookean,))
    if any(np.any(term.limit != 1) for term in scene.of(terms.Strain)):
        raise SceneError(f"solver {NAME!r} cannot model Strain with a limit")
    if any(np.any(term.growth != 1) for term in scene.of(terms.Hyperelastic)):
        raise SceneError(f"solver {NAME!r} cannot model Hyperelastic with growth")
    clock, held = Clock(), scene.dirichlet()[0]
    if not held.any(axis=0).all() and not scene.of(terms.Target):
        raise SceneError(f"solver {NAME!r} needs a vertex that is held")
    laplacian = Energy(scene).laplacian().tocsc()
    factors = tuple(splu(laplacian[~held[:, c]][:, ~held[:, c]]) for c in range(3))
    return Prepared(scene, held, factors, clock.read())


add_solver(NAME, prepare)
