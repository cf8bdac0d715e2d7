"""Projective dynamics against closed forms: patch, uniaxial tables, self-weight, layers in series, rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skfem import MeshTet

from softdeca.lhm.base.mesh import tet_volumes
from softdeca.reference import Scene, prepare, solve, terms


def block(*cells, size=(1.0, 1.0, 1.0)):
    """A block of tets from the origin."""
    mesh = MeshTet.init_tensor(*(np.linspace(0, length, n + 1) for length, n in zip(size, cells, strict=True)))
    X, tets = mesh.p.T.copy(), mesh.t.T.copy()
    turned = tet_volumes(X, tets) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return X, tets


def on(X, axis, value):
    return np.flatnonzero(np.isclose(X[:, axis], value))


def rollers(X):
    """Symmetry planes x = 0, y = 0 and z = 0."""
    return [terms.Fixed(on(X, axis, 0.0), components=axis) for axis in range(3)]


def stretched(X, stretch, end):
    """Rollers, and the end x = `end` moved to stretch times that; sides free."""
    ids = on(X, 0, end)
    return [*rollers(X), terms.Fixed(ids, X[ids] * [stretch, 1, 1], components=0)]


@pytest.mark.parametrize("method", ["lbfgs", "plain"])
def test_patch(method):
    """V1: an affine boundary gives the affine interior; the strain term alone has no say in translation."""
    X, tets = block(3, 3, 3)
    X = X + 0.03 * np.sin(7 * X[:, [1, 2, 0]]) * np.prod(X * (1 - X), axis=1, keepdims=True) * 16
    A = np.array([[1.1, 0.05, 0], [0, 0.95, 0.1], [0.02, 0, 1.03]])
    affine = X @ A.T + [0.3, -2.0, 5.0]
    boundary = np.flatnonzero(((X < 1e-9) | (X > 1 - 1e-9)).any(axis=1))
    scene = Scene(X, tets, [terms.Strain(1.0), terms.Volume(4.0), terms.Fixed(boundary, affine[boundary])])
    solution = solve(scene, method=method, tolerance=1e-11)
    assert solution.converged
    np.testing.assert_allclose(solution.positions, affine, atol=1e-8)


# Lateral stretch, volume ratio and nominal stress of ws/2 |F-R|² + wv/2 dist², ws = 1: verification.md, V3.
TABLE = [
    (0.0, 0.5, 1.0, 0.5, -0.5),
    (0.0, 2.0, 1.0, 2.0, 1.0),
    (10.0, 0.5, 1.296099, 0.839936, -1.189891),
    (10.0, 1.5, 0.835426, 1.046904, 0.590399),
    (10.0, 2.0, 0.735254, 1.081196, 1.094268),
]


@pytest.mark.parametrize("method", ["lbfgs", "plain"])
@pytest.mark.parametrize(("volume", "stretch", "lateral", "ratio", "stress"), TABLE)
def test_uniaxial(method, volume, stretch, lateral, ratio, stress):
    X, tets = block(2, 2, 2)
    scene = Scene(X, tets, [terms.Strain(1.0), terms.Volume(volume), *stretched(X, stretch, 1.0)])
    prepared = prepare(scene, method=method)
    solution = prepared.solve(tolerance=1e-10)
    assert solution.converged
    np.testing.assert_allclose(solution.positions, X * [stretch, lateral, lateral], atol=1e-6)
    np.testing.assert_allclose(solution.volume_ratio, ratio, atol=2e-6)
    reaction = prepared.energy.evaluate(solution.positions - X)[1][on(X, 0, 1.0), 0].sum()
    assert reaction == pytest.approx(stress, abs=2e-6)


def test_strain_limit_bears_load_beyond_it_only():
    """V3: P = ws (stretch - limit), the sides stay."""
    X, tets = block(2, 2, 2)
    prepared = prepare(Scene(X, tets, [terms.Strain(3.0, limit=1.2), *stretched(X, 1.5, 1.0)]))
    solution = prepared.solve(tolerance=1e-10)
    np.testing.assert_allclose(solution.positions, X * [1.5, 1, 1], atol=1e-8)
    reaction = prepared.energy.evaluate(solution.positions - X)[1][on(X, 0, 1.0), 0].sum()
    assert reaction == pytest.approx(3.0 * 0.3, abs=1e-8)
    inside = solve(Scene(X, tets, [terms.Strain(3.0, limit=1.2), *stretched(X, 1.15, 1.0)]))
    assert inside.energy == pytest.approx(0.0, abs=1e-14)


def test_own_weight():
    """V3: the tip sinks by rho g L²/(2 ws), at any size of the load: .04905 for these numbers."""
    X, tets = block(8, 2, 2)
    for factor in (1.0, 10.0):
        gravity = terms.Gravity((factor * 9.81, 0, 0), 1000.0)
        solution = solve(Scene(X, tets, [terms.Strain(1e5), gravity, *rollers(X)]), tolerance=1e-12)
        assert solution.converged
        sag = solution.positions[on(X, 0, 1.0), 0] - 1.0
        # Linear shape functions are exact at the nodes of a bar, up to the load's lumping over the cross-section.
        np.testing.assert_allclose(sag.mean(), factor * 0.04905, rtol=2e-3)


@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e6])
def test_two_layers_in_series(ratio):
    """V3: δ = (F/A)(L1/w1 + L2/w2)."""
    X, tets = block(4, 1, 1, size=(2.0, 1.0, 1.0))
    soft = X[tets].mean(axis=1)[:, 0] < 1.0
    end = on(X, 0, 2.0)
    faces = np.array([[a, b, c] for t in tets for a, b, c in _faces(t) if {a, b, c} <= set(end.tolist())])
    load = terms.Traction(faces, (0.1, 0, 0))
    scene = Scene(X, tets, [terms.Strain(np.where(soft, 1.0, ratio)), load, *rollers(X)])
    solution = solve(scene, tolerance=1e-12)
    assert solution.converged
    np.testing.assert_allclose(solution.positions[end, 0] - 2.0, 0.1 * (1.0 + 1.0 / ratio), rtol=1e-8)


def _faces(tet):
    a, b, c, d = tet.tolist()
    return (a, b, c), (a, b, d), (a, c, d), (b, c, d)


def test_rotating_the_scene_rotates_the_answer():
    X, tets = block(3, 2, 2)
    rotation = Rotation.from_rotvec([0.4, 2.0, -1.0])
    clamped, far = on(X, 0, 0.0), on(X, 0, 1.0)
    target = X[far] + [0.1, 0.3, -0.2]

    def scene(turn):
        elastic = [terms.Strain(2.0, limit=1.05), terms.Volume(20.0, target=1.1)]
        skin = terms.SurfaceStrain(tets[:5, :3], 1.0, growth=1.2)
        loads = [terms.Target(far, turn(target), 3.0), terms.Gravity(turn(np.array([[0, -0.2, 0.0]]))[0], 1.0)]
        return Scene(turn(X), tets, [*elastic, skin, *loads, terms.Fixed(clamped, turn(X[clamped]))])

    here = solve(scene(lambda x: x), tolerance=1e-10)
    there = solve(scene(rotation.apply), tolerance=1e-10)
    assert here.converged and there.converged
    np.testing.assert_allclose(there.positions, rotation.apply(here.positions), atol=1e-8)
    assert there.energy == pytest.approx(here.energy, rel=1e-10)


def test_rigid_motion_costs_nothing():
    X, tets = block(2, 2, 2)
    prepared = prepare(Scene(X, tets, [terms.Strain(1.0), terms.Volume(10.0)]))
    for degrees in range(0, 361, 45):
        moved = Rotation.from_euler("xyz", [degrees, 2 * degrees, 10], degrees=True).apply(X) + [1.0, 2.0, 3.0]
        energy, gradient = prepared.energy.evaluate(moved - X)
        assert energy < 1e-14
        assert np.abs(gradient).max() < 1e-13
