"""Bending against curvature in closed form, finite differences, and what it must not see: motion as a rigid body."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from softdeca.reference import Scene, solve, terms
from softdeca.reference.projective import prepare

NO_TETS = np.zeros((0, 4), dtype=int)


def sheet(cells, length=1.0, width=1.0):
    """A flat rectangle of vertices in rows along x, and its triangles."""
    nx, ny = cells
    grid = np.stack(np.meshgrid(np.linspace(0, length, nx + 1), np.linspace(0, width, ny + 1), indexing="ij"), -1)
    X = np.c_[grid.reshape(-1, 2), np.zeros((nx + 1) * (ny + 1))]
    a = (np.arange(nx)[:, None] * (ny + 1) + np.arange(ny)).ravel()
    b, c, d = a + ny + 1, a + ny + 2, a + 1
    return X, np.vstack([np.c_[a, b, c], np.c_[a, c, d]])


def rolled(X, radius):
    """The sheet on a cylinder about an axis along y: lengths are kept."""
    angle = X[:, 0] / radius
    return np.c_[radius * np.sin(angle), X[:, 1], radius * (1 - np.cos(angle))]


def energy_of(term, X, x):
    return prepare(Scene(X, NO_TETS, [term])).energy.evaluate(x - X)[0]


def inner_area(X, triangles):
    """The area of the vertices that bend, a third of each triangle around."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, where, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    border = np.unique(edges[count[where.ravel()] == 1])
    area = np.linalg.norm(np.cross(*(X[triangles[:, k]] - X[triangles[:, 0]] for k in (1, 2))), axis=1) / 2
    return area @ (~np.isin(triangles, border)).sum(axis=1) / 3


@pytest.mark.parametrize("cells", [(20, 6), (40, 12)])
def test_rolling_a_flat_sheet_and_unrolling_a_cylinder(cells):
    """The Laplacian of a cylinder's positions is its curvature 1/r, so E = k/2 area / r², up to (h/r)²/12 of it."""
    X, triangles = sheet(cells)
    x, radius, k = rolled(X, 0.8), 0.8, 3.0
    expected = 0.5 * k * inner_area(X, triangles) / radius**2
    error = (1.0 / cells[0] / radius) ** 2 / 6
    assert energy_of(terms.Bending(triangles, k), X, x) == pytest.approx(expected, rel=error)
    unrolled = 0.5 * k * inner_area(x, triangles) / radius**2
    assert energy_of(terms.Bending(triangles, k), x, X) == pytest.approx(unrolled, rel=error)
    assert energy_of(terms.Bending(triangles, k, rest=x), X, X) == pytest.approx(unrolled, rel=error)


def test_rigid_motion_costs_nothing_and_a_dent_costs_twice_the_curvature():
    """A shallow cap of a sphere: |Δx| = 2/r, and the other way round, 4/r off; a half turn about its axis is free."""
    X, triangles = sheet((24, 24))
    radius = 5.0
    cap = X.copy()
    cap[:, 2] = np.sqrt(radius**2 - np.sum((X[:, :2] - 0.5) ** 2, axis=1))
    term = terms.Bending(triangles, 2.0)
    moved = Rotation.from_rotvec([2.0, -1.0, 0.4]).apply(cap) + [3.0, 1.0, -2.0]
    assert energy_of(term, cap, moved) == pytest.approx(0.0, abs=1e-20)
    dent = 0.5 * 2.0 * inner_area(cap, triangles) * (4 / radius) ** 2
    assert energy_of(term, cap, cap * [1, 1, -1]) == pytest.approx(dent, rel=0.02)


def test_stiffness_is_the_mean_over_triangles_and_terms_add_up():
    X, triangles = sheet((6, 4))
    x = rolled(X, 0.7)
    stiffness = np.random.default_rng(0).uniform(1, 3, len(triangles))
    whole = energy_of(terms.Bending(triangles, stiffness), X, x)
    doubled = [terms.Bending(triangles, 0.5 * stiffness), terms.Bending(triangles, 1.5 * stiffness)]
    assert prepare(Scene(X, NO_TETS, doubled)).energy.evaluate(x - X)[0] == pytest.approx(2 * whole, rel=1e-13)
    # All inner vertices of this grid but for the stiffness are alike, and each triangle counts a third at each corner.
    inner = (~np.isin(triangles, border_of(6, 4))).sum(axis=1)
    even = energy_of(terms.Bending(triangles, 1.0), X, x)
    assert whole == pytest.approx(even * (stiffness @ inner) / inner.sum(), rel=1e-12)


def border_of(nx, ny):
    i, j = np.divmod(np.arange((nx + 1) * (ny + 1)), ny + 1)
    return np.flatnonzero((i == 0) | (i == nx) | (j == 0) | (j == ny))


@pytest.mark.parametrize("size", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("sought", ["own", "other"])
def test_gradient_is_the_derivative_of_the_energy(size, sought):
    """Central differences on a closed surface of 162 vertices, R's dependence on positions included."""
    sphere = trimesh.creation.icosphere(2)
    X, rng = np.array(sphere.vertices), np.random.default_rng(3)
    rest = None if sought == "own" else X * [1.2, 0.9, 1.0] + 0.02 * rng.normal(size=X.shape)
    term = terms.Bending(sphere.faces, rng.uniform(1, 2, len(sphere.faces)), rest=rest)
    energy = prepare(Scene(X, NO_TETS, [term])).energy
    u, along = size * rng.normal(size=X.shape), rng.normal(size=X.shape)
    h = 1e-6 * size
    slope = (energy.evaluate(u + h * along)[0] - energy.evaluate(u - h * along)[0]) / (2 * h)
    assert np.vdot(energy.evaluate(u)[1], along) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("scale", [[1, 1, 0], [1, 0, 0], [0, 0, 0]])
def test_a_collapsed_ring_has_a_finite_energy_and_gradient(scale):
    sphere = trimesh.creation.icosphere(1)
    X = np.array(sphere.vertices)
    energy, gradient = prepare(Scene(X, NO_TETS, [terms.Bending(sphere.faces, 1.0)])).energy.evaluate(X * scale - X)
    assert np.isfinite(energy) and np.isfinite(gradient).all()


def test_a_flat_sheet_takes_another_rest_shape():
    """Membrane and bending both seek a cylinder, whose border is held: it is reached, the energy falling throughout."""
    X, triangles = sheet((12, 6))
    rest, border = rolled(X, 0.5), border_of(12, 6)
    elastic = [terms.SurfaceStrain(triangles, 10.0, rest=rest), terms.Bending(triangles, 0.5, rest=rest)]
    solution = solve(Scene(X, NO_TETS, [*elastic, terms.Fixed(border, rest[border])]), tolerance=1e-10)
    assert solution.converged
    assert (np.diff(solution.history.energy) <= 1e-13 * solution.history.energy[0]).all()
    assert solution.energy == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(solution.positions, rest, atol=1e-6)


def test_plain_steps_are_safeguarded():
    """On a cylinder so narrow that rings turn far, plain local/global steps would raise the energy again and again."""
    X, triangles = sheet((12, 6))
    rest, border = rolled(X, 0.2), border_of(12, 6)
    elastic = [terms.SurfaceStrain(triangles, 1.0, rest=rest), terms.Bending(triangles, 5.0, rest=rest)]
    scene = Scene(X, NO_TETS, [*elastic, terms.Fixed(border, rest[border])])
    solution = prepare(scene, method="plain").solve(tolerance=1e-6, max_iterations=200)
    assert (np.diff(solution.history.energy) <= 1e-13 * solution.history.energy[0]).all()
