"""Hard starts that no hard case poses: a free cube, laws that come back, and laws that say they cannot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.reference import Scene, materials, prepare, solve, terms
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
