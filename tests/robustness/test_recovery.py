"""Hard starts that no hard case poses: a free cube, laws that come back, and laws that say they cannot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.reference import Reason, Scene, materials, prepare, solve, terms
from softdeca.reference.problems import meshes

YOUNG, POISSON = 1e4, 0.45
MU, LMBDA = materials.lame(YOUNG, POISSON)
X, TETS = meshes.block(5)
ELASTIC = [terms.Strain(2 * MU), terms.Volume(3 * LMBDA)]


@pytest.fixture(scope="module")
def free():
    """A cube that nothing holds."""
    return prepare(Scene(X, TETS, ELASTIC))


def assert_at_rest(solution):
    assert solution.converged
    assert solution.volume_ratio.min() > 0.999
    here, rest = solution.positions - solution.positions.mean(axis=0), X - X.mean(axis=0)
    rotation = Rotation.align_vectors(here, rest)[0]
    assert np.abs(here - rotation.apply(rest)).max() < 1e-6


@pytest.mark.parametrize(
    "kept", [(1, 1, 0), (1, 0, 0), (0, 0, 0), (1, 1, -1)], ids=["plane", "line", "point", "mirror"]
)
def test_h2_collapse_and_h3_mirror_are_finite_and_deterministic(free, kept):
    start = X * kept
    energy, gradient = free.energy.evaluate(start - X)
    assert np.isfinite(energy) and np.isfinite(gradient).all()
    solution = free.solve(start=start, tolerance=1e-10)
    assert_at_rest(solution)
    np.testing.assert_array_equal(solution.positions, free.solve(start=start, tolerance=1e-10).positions)


def test_held_far_away_comes_along():
    """A face held 30 edge lengths away inverts its tets at the start; the block follows, at rest."""
    face = np.flatnonzero(X[:, 0] == 0)
    scene = Scene(X, TETS, [*ELASTIC, terms.Fixed(face, X[face] + [6.0, -3.0, 0.0])])
    solution = solve(scene, tolerance=1e-10)
    assert_at_rest(solution)
    np.testing.assert_allclose(solution.positions, X + [6.0, -3.0, 0.0], atol=1e-6)


def test_plain_steps_majorise_a_strain_limit(sphere_head):
    """Eq. 10 to the letter jumps as tets cross the limit; clamped, no step raises the energy."""
    rest, n = sphere_head.vertices, len(sphere_head.bone)
    cheek = np.exp(-np.sum((rest[:n] / 100.0 - [0, -0.3, 0.95]) ** 2, axis=1) / 0.1)[:, None]
    bone = 2 * n + np.flatnonzero(sphere_head.bone == 1)
    tissue = [terms.Strain(5.0, 1.05), terms.Volume(67.5)]
    pulled = terms.Target(np.arange(n), rest[:n] + 15.0 * cheek * [0.3, -1, 0.2], 1000.0)
    scene = Scene(rest, sphere_head.tets, [*tissue, pulled, terms.Fixed(bone)])
    energy = prepare(scene, method="plain").solve(tolerance=1e-12, max_iterations=150).history.energy
    assert (np.diff(energy) <= 1e-12 * energy[:-1]).all()


BLOCK, ITS_TETS = meshes.block(4)
BASE = BLOCK[:, 2] == 0
STABLE = materials.StableNeoHookean.from_young(10.0, 0.45)
SCALES = {"plane": [1.0, 1, 0], "line": [1.0, 0, 0], "mirror": [1.0, 1, -1], "pushed through": [1.0, 1, -0.3]}


def recover(law, start):
    """FEniCSx's recoveries of every law are hard cases."""
    scene = Scene(BLOCK, ITS_TETS, [terms.Hyperelastic(law), terms.Fixed(BASE)])
    start = np.where(BASE[:, None], BLOCK, start)
    return solve(scene, solver="skfem", start=start, tolerance=1e-10, max_iterations=300)


@pytest.mark.parametrize("name", SCALES)
def test_a_collapsed_or_inverted_block_of_the_stable_law_comes_back_by_scikit_fem(name):
    solution = recover(STABLE, BLOCK * SCALES[name])
    assert solution.converged, solution.reason
    assert np.abs(solution.positions - BLOCK).max() < 1e-6
    assert solution.volume_ratio.min() > 0.999


@pytest.mark.parametrize(
    "law",
    [materials.NeoHookean(1.0, 5.0), materials.IsochoricNeoHookean(1.0, 5.0), materials.tissues.FACE],
    ids=lambda law: law.name,
)
def test_a_law_that_does_not_hold_under_inversion_says_so_by_scikit_fem(law):
    solution = recover(law, BLOCK * SCALES["mirror"])
    assert solution.reason is Reason.NOT_FINITE
    assert np.isfinite(solution.positions).all()
