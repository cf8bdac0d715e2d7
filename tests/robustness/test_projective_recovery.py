"""Hard starts of projective dynamics (random, collapsed, inverted), and bad input, judged by being right."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skfem import MeshTet

from softdeca.lhm.base.errors import SceneError
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.reference import Reason, Scene, materials, prepare, solve, terms


def block(cells):
    line = np.linspace(0, 1, cells + 1)
    mesh = MeshTet.init_tensor(line, line, line)
    X, tets = mesh.p.T.copy(), mesh.t.T.copy()
    turned = tet_volumes(X, tets) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return X, tets


YOUNG, POISSON = 1e4, 0.45
MU, LMBDA = materials.lame(YOUNG, POISSON)
X, TETS = block(5)
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


def test_balanced_loads_on_a_free_block_stretch_it():
    """Strain only: P = ws (stretch - 1), and the centre stays."""
    faces = {side: [f for t in TETS for f in _faces(t) if (X[list(f), 0] == side).all()] for side in (0.0, 1.0)}
    pull = [terms.Traction(faces[side], (sign * 0.2, 0, 0)) for side, sign in ((0.0, -1), (1.0, 1))]
    solution = solve(Scene(X, TETS, [terms.Strain(1.0), *pull]), tolerance=1e-11)
    assert solution.converged
    np.testing.assert_allclose(np.ptp(solution.positions, axis=0), [1.2, 1, 1], atol=1e-8)


def _faces(tet):
    a, b, c, d = tet.tolist()
    return (a, b, c), (a, b, d), (a, c, d), (b, c, d)


def test_loads_on_what_nothing_holds_are_refused():
    with pytest.raises(SceneError, match="nothing holds the part around vertex 0 along y"):
        solve(Scene(X, TETS, [*ELASTIC, terms.Gravity((0, -9810, 0), 1e-6)]))


def test_bad_starts_and_options_are_named(free):
    start = X.copy()
    start[17, 1] = np.nan
    with pytest.raises(SceneError, match="start: 1 rows are not finite, the first is 17"):
        free.solve(start=start)
    with pytest.raises(SceneError, match="start: expected shape"):
        free.solve(start=X[:-1])
    for tolerance in (0.0, -1.0, np.nan, 1.0):
        with pytest.raises(SceneError, match="tolerance"):
            free.solve(tolerance=tolerance)
    with pytest.raises(SceneError, match="max_iterations"):
        free.solve(max_iterations=-1)
    with pytest.raises(SceneError, match="unknown method 'newton'; there are lbfgs, anderson, plain"):
        prepare(Scene(X, TETS, ELASTIC), method="newton")
    with pytest.raises(SceneError, match="cannot model Hyperelastic"):
        prepare(Scene(X, TETS, [terms.Hyperelastic(materials.NeoHookean(1.0, 1.0))]))


@pytest.mark.filterwarnings("ignore:overflow")
def test_a_start_beyond_floating_point_says_so(free):
    solution = free.solve(start=X * 1e200)
    assert solution.reason is Reason.NOT_FINITE
    assert not solution.converged


def test_the_callback_stops_the_solve(free):
    seen = []
    start = np.random.default_rng(0).uniform(-1, 1, X.shape)
    solution = free.solve(start=start, on_iteration=lambda i, x, energy, norm: seen.append((i, x)) or i == 3)
    assert solution.reason is Reason.INTERRUPTED
    assert solution.iterations == 3 and [i for i, _ in seen] == [0, 1, 2, 3]
    np.testing.assert_allclose(seen[0][1], start, atol=1e-15)
    np.testing.assert_allclose(solution.positions, seen[-1][1], atol=1e-12)


def test_the_iteration_limit_is_kept(free):
    start = np.random.default_rng(0).uniform(-1, 1, X.shape)
    for limit in (0, 2):
        solution = free.solve(start=start, max_iterations=limit)
        assert solution.reason is Reason.MAX_ITERATIONS and solution.iterations == limit


@pytest.mark.parametrize("rule", ["clamp", "indicator"])
def test_plain_steps_majorise_the_clamp_but_not_the_indicator(sphere_head, rule):
    """Eq. 10 to the letter jumps as tets cross the limit, so some steps raise it; clamped, no step does."""
    rest, n = sphere_head.vertices, len(sphere_head.bone)
    cheek = np.exp(-np.sum((rest[:n] / 100.0 - [0, -0.3, 0.95]) ** 2, axis=1) / 0.1)[:, None]
    bone = 2 * n + np.flatnonzero(sphere_head.bone == 1)
    tissue = [terms.Strain(5.0, 1.05, rule=rule), terms.Volume(67.5)]
    pulled = terms.Target(np.arange(n), rest[:n] + 15.0 * cheek * [0.3, -1, 0.2], 1000.0)
    scene = Scene(rest, sphere_head.tets, [*tissue, pulled, terms.Fixed(bone)])
    energy = prepare(scene, method="plain").solve(tolerance=1e-12, max_iterations=150).history.energy
    rises = np.count_nonzero(np.diff(energy) > 1e-12 * energy[:-1])
    assert (rises > 10) if rule == "indicator" else (rises == 0)
