"""Projections and gradients of the local step against brute force, Kabsch's rotation and finite differences."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from skfem import MeshTet

from softdeca.lhm.base.errors import SceneError
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.reference import Scene, terms
from softdeca.reference import prepare as prepare_by
from softdeca.reference.projective import prepare
from softdeca.reference.projective.projections import F00, LANES, ROWS, S0, U00, V00, decompose, nearest_of_determinant

# Dm = I and V = 1/6, so that positions F X have the deformation gradient F, and E = F's squared distance / 12.
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)


def distance_and_residual(term, F):
    """Distance of F to a term's set (stiffness 1), and F - p, as the solver has them."""
    energy = prepare(Scene(CORNER, [[0, 1, 2, 3]], [term])).energy
    value, gradient = energy.evaluate(CORNER @ F.T - CORNER)
    return np.sqrt(12.0 * value), 6.0 * gradient[1:].T


def matrices(kind):
    rng = np.random.default_rng(7)
    rotations = Rotation.random(8, random_state=3).as_matrix()
    if kind == "near a rotation":
        return rotations @ (np.eye(3) + 0.1 * rng.normal(size=(8, 3, 3)))
    if kind == "inverted":
        return rotations @ np.diag([1.2, 0.9, -0.5]) @ rotations.transpose(0, 2, 1)[::-1]
    return 1.5 * rng.normal(size=(8, 3, 3))


KINDS = ("near a rotation", "inverted", "anything")


@pytest.mark.parametrize("kind", KINDS)
def test_strain_is_the_distance_to_kabsch_rotation(kind):
    for F in matrices(kind):
        rotation = Rotation.align_vectors(F.T, np.eye(3))[0].as_matrix()
        distance, residual = distance_and_residual(terms.Strain(1.0), F)
        assert distance == pytest.approx(np.linalg.norm(F - rotation), rel=1e-12)
        np.testing.assert_allclose(residual, F - rotation, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_limited_strain_is_the_distance_to_bounded_stretches(kind):
    limit, rng = 1.25, np.random.default_rng(1)
    for F in matrices(kind)[:4]:

        def objective(z, F=F):
            left, right = (Rotation.from_rotvec(v).as_matrix() for v in (z[:3], z[3:6]))
            return np.sum((F - left @ np.diag(z[6:]) @ right.T) ** 2)

        bounds = [(None, None)] * 6 + [(1 / limit, limit)] * 3
        best = min(
            minimize(objective, np.r_[rng.normal(size=6), 1, 1, 1], bounds=bounds, method="L-BFGS-B").fun
            for _ in range(12)
        )
        distance, _ = distance_and_residual(terms.Strain(1.0, limit=limit), F)
        assert distance**2 == pytest.approx(best, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(("stretches", "active"), [((1.09, 0.5, 1), False), ((0.2, 1.11, 1), True)])
def test_the_indicator_is_all_or_nothing(stretches, active):
    """Eq. 10 to the letter: ‖F - R‖² where the largest stretch is above 1.1, whatever the others are."""
    Q = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    F = Q @ np.diag(stretches)
    distance, residual = distance_and_residual(terms.Strain(1.0, limit=1.1, rule="indicator"), F)
    assert distance == pytest.approx(active * np.linalg.norm(F - Q), rel=1e-12)
    np.testing.assert_allclose(residual, active * (F - Q), atol=1e-12)


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_only_projective_dynamics_models_the_indicator(solver):
    with pytest.raises(SceneError, match=f"{solver}.*Strain with rule 'indicator'"):
        prepare_by(Scene(X, TETS, [terms.Strain(1.0, rule="indicator")]), solver=solver)
    with pytest.raises(SceneError, match="Strain.rule: expected clamp or indicator, got 'soft'"):
        terms.Strain(1.0, rule="soft")


@pytest.mark.parametrize("target", [0.6, 1.0, 1.7])
@pytest.mark.parametrize("kind", KINDS)
def test_volume_is_the_distance_to_matrices_of_a_determinant(kind, target):
    rng = np.random.default_rng(2)
    for F in matrices(kind)[:4]:
        constraint = {"type": "eq", "fun": lambda T: np.linalg.det(T.reshape(3, 3)) - target}
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
        best = min(run.fun for run in runs if abs(constraint["fun"](run.x)) < 1e-8)
        distance, residual = distance_and_residual(terms.Volume(1.0, target=target), F)
        assert np.linalg.det(F - residual) == pytest.approx(target, rel=1e-12)
        assert distance == pytest.approx(np.linalg.norm(residual), rel=1e-12, abs=1e-14)
        assert distance**2 == pytest.approx(best, rel=1e-6, abs=1e-8)


def test_a_large_ball_is_nearest_to_a_flat_shape_of_the_volume():
    """2 I: the cube root, I, is 3 away; (1.87, 1.87, 0.286) has determinant 1 and is 2.97 away."""
    t = np.array(nearest_of_determinant(2.0, 2.0, 2.0, 1.0))
    assert np.prod(t) == pytest.approx(1.0, rel=1e-12)
    assert np.sum((t - 2.0) ** 2) < 2.98


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


def grid():
    mesh = MeshTet().refined(1)
    X, tets = mesh.p.T.copy(), mesh.t.T.copy()
    turned = tet_volumes(X, tets) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return X, tets


X, TETS = grid()
RNG = np.random.default_rng(5)
TERMS = {
    "Strain": terms.Strain(RNG.uniform(1, 3, len(TETS))),
    "Strain with a limit": terms.Strain(2.0, limit=1.1),
    "Strain with the indicator": terms.Strain(2.0, limit=1.1, rule="indicator"),
    "Volume": terms.Volume(3.0, target=RNG.uniform(0.7, 1.4, len(TETS))),
    "SurfaceStrain": terms.SurfaceStrain(TETS[:, :3], 2.0, growth=1.3),
    "SurfaceStrain of another rest": terms.SurfaceStrain(TETS[:, :3], 2.0, rest=X * [1.3, 0.8, 1.1]),
    "Inertia": terms.Inertia(RNG.uniform(1, 3, len(TETS)), 0.3, RNG.normal(size=X.shape), RNG.normal(size=X.shape)),
    "Target": terms.Target(np.arange(5), RNG.normal(size=(5, 3)), RNG.uniform(1, 2, 5)),
    "Gravity": terms.Gravity((1, -2, 3), 0.1),
    "Traction": terms.Traction(TETS[:4, :3], (1, 2, -3)),
}


@pytest.mark.parametrize("size", [0.05, 1.0])
@pytest.mark.parametrize("name", TERMS)
def test_gradient_is_the_derivative_of_the_energy(name, size):
    """Central differences, with two more terms on some tets, for terms that overlap share rows."""
    scene = Scene(X, TETS, [TERMS[name], terms.Strain(0.1, tets=[0, 1, 2]), terms.Volume(0.2, tets=[2, 3])])
    energy = prepare(scene).energy
    u, along = size * RNG.normal(size=X.shape), RNG.normal(size=X.shape)
    h = 1e-6
    slope = (energy.evaluate(u + h * along)[0] - energy.evaluate(u - h * along)[0]) / (2 * h)
    assert np.vdot(energy.evaluate(u)[1], along) == pytest.approx(slope, rel=2e-8)


def test_surface_strain_is_the_distance_to_a_grown_isometry():
    """√growth times an isometry costs nothing; a 10 % stretch of one side costs w A/2 0.01."""
    triangle = terms.SurfaceStrain([[0, 1, 2]], 3.0, growth=1.0)
    energy = prepare(Scene(CORNER, [[0, 1, 2, 3]], [triangle])).energy
    stretched = CORNER * [1.1, 1, 1]
    assert energy.evaluate(stretched - CORNER)[0] == pytest.approx(0.5 * 3.0 * 0.5 * 0.01, rel=1e-12)
    grown = prepare(Scene(CORNER, [[0, 1, 2, 3]], [terms.SurfaceStrain([[0, 1, 2]], 3.0, growth=1.44)])).energy
    turned = 1.2 * Rotation.from_rotvec([0.3, -1.0, 2.0]).apply(CORNER)
    assert grown.evaluate(turned - CORNER)[0] == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_allclose(grown.evaluate(turned - CORNER)[1], 0.0, atol=1e-13)


def test_surface_strain_seeks_another_rest_shape_over_the_scene_s_area():
    """A triangle whose rest is 2 by 1 costs nothing there; as the scene has it, 1 by 1, it is 1/2 short along x."""
    rest = CORNER * [2, 1, 1]
    energy = prepare(Scene(CORNER, [[0, 1, 2, 3]], [terms.SurfaceStrain([[0, 1, 2]], 3.0, rest=rest)])).energy
    turned = Rotation.from_rotvec([0.3, -1.0, 2.0]).apply(rest)
    assert energy.evaluate(turned - CORNER)[0] == pytest.approx(0.0, abs=1e-14)
    assert energy.evaluate(0 * CORNER)[0] == pytest.approx(0.5 * 3.0 * 0.5 * 0.25, rel=1e-12)


def test_inertia_is_a_spring_to_where_free_motion_leads():
    """One tet of mass 4: each vertex has 1, hence a spring of 1/h² to X + h v."""
    inertia = terms.Inertia(24.0, 0.5, velocities=np.tile([2.0, 0, 0], (4, 1)))
    energy = prepare(Scene(CORNER, [[0, 1, 2, 3]], [inertia])).energy
    value, gradient = energy.evaluate(np.tile([1.0, 0, 3.0], (4, 1)))
    assert value == pytest.approx(4 * 0.5 * 4.0 * 9.0, rel=1e-14)
    np.testing.assert_allclose(gradient, np.tile([0, 0, 12.0], (4, 1)), atol=1e-13)


@pytest.mark.parametrize(("flat", "expected"), [([1, 0, 1], 0.25), ([0, 0, 0], 0.5)])
def test_flat_triangle_has_a_finite_energy_and_gradient(flat, expected):
    """Area 1/2: one lost side costs 1/4, two cost 1/2; the floor rounds the tip off by less than 1e-4."""
    energy = prepare(Scene(CORNER, [[0, 1, 2, 3]], [terms.SurfaceStrain([[0, 1, 2]], 1.0)])).energy
    value, gradient = energy.evaluate(CORNER * flat - CORNER)
    assert value == pytest.approx(expected, abs=1e-4)
    assert np.isfinite(gradient).all()
