"""Distances that energies measure, by every solver, against brute force and Kabsch's rotation; the local step's SVD."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from softdeca.reference import Scene, terms
from softdeca.reference.projective.terms.local_step import (
    F00,
    LANES,
    R00,
    ROWS,
    S0,
    U00,
    V00,
    decompose,
    nearest_rotation,
    stretches,
)

from .by_solver import DISCRETE, SOLVERS

# A corner of the unit cube has V = 1/6, so that positions F X have the energy F's squared distance / 12.
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
KINDS = ("near a rotation", "inverted", "anything")
each_solver = pytest.mark.parametrize("solver", SOLVERS)
each_kind = pytest.mark.parametrize("kind", KINDS)


def distance_and_residual(solver, term, F):
    """Distance of F to a term's set (stiffness 1), and F - p, as a solver has them."""
    discrete = DISCRETE[solver](Scene(CORNER, [[0, 1, 2, 3]], [term]))
    positions = discrete.nodes @ F.T
    corners = [np.argmin(np.linalg.norm(discrete.nodes - corner, axis=1)) for corner in CORNER[1:]]
    return np.sqrt(12.0 * discrete.energy(discrete.at(positions))), 6.0 * discrete.forces(positions)[corners].T


def matrices(kind):
    rng = np.random.default_rng(7)
    rotations = Rotation.random(8, random_state=3).as_matrix()
    if kind == "near a rotation":
        return rotations @ (np.eye(3) + 0.1 * rng.normal(size=(8, 3, 3)))
    if kind == "inverted":
        return rotations @ np.diag([1.2, 0.9, -0.5]) @ rotations.transpose(0, 2, 1)[::-1]
    return 1.5 * rng.normal(size=(8, 3, 3))


@each_solver
@each_kind
def test_strain_is_the_distance_to_kabsch_rotation(kind, solver):
    for F in matrices(kind):
        rotation = Rotation.align_vectors(F.T, np.eye(3))[0].as_matrix()
        distance, residual = distance_and_residual(solver, terms.Strain(1.0), F)
        assert distance == pytest.approx(np.linalg.norm(F - rotation), rel=1e-12)
        np.testing.assert_allclose(residual, F - rotation, atol=1e-12)


@cache
def to_bounded_stretches(kind, limit):
    """Squared distances of four matrices to rotations times stretches within the limit, the least of many descents."""
    rng, least = np.random.default_rng(1), []
    for F in matrices(kind)[:4]:

        def objective(z, F=F):
            left, right = (Rotation.from_rotvec(v).as_matrix() for v in (z[:3], z[3:6]))
            return np.sum((F - left @ np.diag(z[6:]) @ right.T) ** 2)

        bounds = [(None, None)] * 6 + [(1 / limit, limit)] * 3
        starts = (np.r_[rng.normal(size=6), 1, 1, 1] for _ in range(12))
        least.append(min(minimize(objective, start, bounds=bounds, method="L-BFGS-B").fun for start in starts))
    return least


@each_solver
@each_kind
def test_limited_strain_is_the_distance_to_bounded_stretches(kind, solver):
    for F, least in zip(matrices(kind), to_bounded_stretches(kind, 1.25), strict=False):
        distance, _ = distance_and_residual(solver, terms.Strain(1.0, limit=1.25), F)
        assert distance**2 == pytest.approx(least, rel=1e-6, abs=1e-8)


@cache
def to_determinant(kind, target):
    """Squared distances of four matrices to those of a determinant, the least of many descents."""
    rng, least = np.random.default_rng(2), []
    constraint = {"type": "eq", "fun": lambda T: np.linalg.det(T.reshape(3, 3)) - target}
    for F in matrices(kind)[:4]:
        runs = [
            minimize(
                lambda T, F=F: np.sum((T - F.ravel()) ** 2),
                (F + 0.5 * rng.normal(size=(3, 3))).ravel(),
                jac=lambda T, F=F: 2 * (T - F.ravel()),
                constraints=[constraint],
                options={"ftol": 1e-14, "maxiter": 300},
            )
            for _ in range(12)
        ]
        least.append(min(run.fun for run in runs if abs(constraint["fun"](run.x)) < 1e-8))
    return least


@each_solver
@pytest.mark.parametrize("target", [0.6, 1.0, 1.7])
@each_kind
def test_volume_is_the_distance_to_matrices_of_a_determinant(kind, target, solver):
    for F, least in zip(matrices(kind), to_determinant(kind, target), strict=False):
        distance, residual = distance_and_residual(solver, terms.Volume(1.0, target=target), F)
        assert np.linalg.det(F - residual) == pytest.approx(target, rel=1e-12)
        assert distance == pytest.approx(np.linalg.norm(residual), rel=1e-12, abs=1e-14)
        assert distance**2 == pytest.approx(least, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e3])
def test_decomposition_is_exact_to_rounding(scale):
    rng = np.random.default_rng(0)
    special = [np.eye(3), 2 * np.eye(3), np.zeros((3, 3)), np.diag([1, 1, -1.0]), np.diag([1, 0, 0.0]), np.ones((3, 3))]
    rotations = list(Rotation.random(8, random_state=1).as_matrix())
    nearly = [R + 1e-12 * rng.normal(size=(3, 3)) for R in rotations[:4]]
    flat = [rng.normal(size=(3, 3)) @ np.diag([1, 1, 0.0]) for _ in range(4)]
    cases = [*special, *rotations, *nearly, *flat]
    F = scale * np.array(cases + [rng.normal(size=(3, 3)) for _ in range(LANES - len(cases))])
    w = np.zeros(ROWS * LANES)
    rows = w.reshape(ROWS, LANES)

    def view(first, count):
        return rows[first // LANES : first // LANES + count].T

    view(F00, 9)[:] = F.reshape(LANES, 9)
    decompose(w)
    U, V, s = view(U00, 9).reshape(-1, 3, 3), view(V00, 9).reshape(-1, 3, 3), view(S0, 3)
    np.testing.assert_allclose(U @ (s[:, :, None] * V.transpose(0, 2, 1)), F, rtol=0, atol=1e-14 * scale)
    for frame in (U, V):
        np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (LANES, 1, 1)), atol=1e-14)
        np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.abs(s), np.linalg.svd(F, compute_uv=False), rtol=0, atol=1e-14 * scale)
    np.testing.assert_array_less(np.abs(s[:, 2]), s[:, 1] + 1e-14 * scale)


def test_rotation_and_stretches_by_invariants_are_those_of_singular_values():
    """Also of inverted and nearly round matrices; the lanes without one nearest rotation are counted."""
    rng = np.random.default_rng(4)
    rotations = Rotation.random(LANES, random_state=5).as_matrix()
    F = rotations @ (np.eye(3) + 0.3 * rng.normal(size=(LANES, 3, 3)))
    F[:4] = rotations[:4] @ (np.eye(3) + 1e-9 * rng.normal(size=(4, 3, 3)))
    F[4:8] = rotations[4:8] @ np.diag([1.3, 0.9, -0.3]) @ rotations[8:12]
    F[8] = rotations[8] @ np.diag([1.2, 0.4, -0.4]) @ rotations[9]
    w = np.zeros(ROWS * LANES)
    rows = w.reshape(ROWS, LANES)
    rows[F00 // LANES : F00 // LANES + 9] = F.reshape(LANES, 9).T
    assert nearest_rotation(w) == 1
    stretches(w)
    u, s, vt = np.linalg.svd(F)
    turn = np.sign(np.linalg.det(u @ vt))
    s[:, 2] *= turn
    u[:, :, 2] *= turn[:, None]
    sure = np.arange(LANES) != 8
    R = rows[R00 // LANES : R00 // LANES + 9].T.reshape(-1, 3, 3)
    np.testing.assert_allclose(R[sure], (u @ vt)[sure], atol=1e-12)
    np.testing.assert_allclose(rows[S0 // LANES : S0 // LANES + 3].T[sure], s[sure], atol=1e-12)
