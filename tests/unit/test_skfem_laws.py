"""Every law of the scikit-fem solver passes one loop: psi -> P -> tangent by finite differences, frames, rest."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from softdeca.reference import materials
from softdeca.reference.skfem.discretisation import rest_gradients
from softdeca.reference.skfem.solids import (
    ByInvariants,
    ByRotation,
    Grown,
    Strain,
    Volume,
    nearest_of_determinant,
    project_spd,
    signed_svd,
)
from softdeca.reference.skfem.surfaces import Membrane

COUNT = 40


def full(value):
    return np.full(COUNT, float(value))


KAPPA = 7.0 + 2.6 / 3
ISOTROPIC = {
    "NeoHookean": ByInvariants(materials.NeoHookean(1.3, 7.0)),
    "StableNeoHookean": ByInvariants(materials.StableNeoHookean(1.3, 7.0)),
    "Corotated": ByRotation(materials.Corotated(1.3, 7.0)),
    "StVenantKirchhoff": ByInvariants(materials.StVenantKirchhoff(1.3, 7.0)),
    "isochoric, quadratic": ByInvariants(materials.IsochoricNeoHookean(1.3, KAPPA)),
    "isochoric, logarithmic": ByInvariants(materials.IsochoricNeoHookean(1.3, KAPPA, "kappa/4 (J^2-1-2 ln J)")),
    "Mooney-Rivlin": ByInvariants(materials.MooneyRivlin(0.4, 0.25, KAPPA, C20=0.3)),
}
LAWS = {
    **ISOTROPIC,
    "Strain": Strain(full(2.0), full(1.0)),
    "Strain with a limit": Strain(full(2.0), full(1.15)),
    "Volume": Volume(full(3.0), full(1.0)),
    "Volume with growth": Volume(full(3.0), full(1.4)),
    "Strain with growth": Grown(Strain(full(2.0), full(1.0)), full(1.4), full(1.4 ** (2 / 3))),
    "NeoHookean with growth": Grown(ISOTROPIC["NeoHookean"], full(1.4), full(1.4)),
}
INFINITE_AT_INVERSION = [
    "NeoHookean",
    "NeoHookean with growth",
    "isochoric, quadratic",
    "isochoric, logarithmic",
    "Mooney-Rivlin",
]
FINITE_AT_INVERSION = [name for name in LAWS if name not in INFINITE_AT_INVERSION]


def deformations(seed, size=0.35):
    """Deformation gradients with J > 0 around random rotations, away from the kinks of the limit."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(COUNT, random_state=seed).as_matrix()
    return R @ (np.eye(3) + size * rng.uniform(-1, 1, (COUNT, 3, 3)))


def inverted(seed):
    """Deformation gradients of both signs of the determinant, with stretches between 0.3 and 2."""
    rng = np.random.default_rng(seed)
    U, V = (Rotation.random(COUNT, random_state=seed + k).as_matrix() for k in (1, 2))
    stretches = np.sort(rng.uniform(0.3, 2.0, (COUNT, 3)))[:, ::-1].copy()
    stretches[::2, 2] *= -1
    return (U * stretches[:, None, :]) @ V


def away_from_kinks(law, F):
    """Mask of samples whose stretches keep a distance from the limit's kinks, where no second derivative exists."""
    if not isinstance(law, Strain):
        return np.ones(len(F), dtype=bool)
    sigma = signed_svd(F)[1]
    return (np.abs(sigma - law.limit[0]) > 1e-3).all(1) & (np.abs(sigma - 1 / law.limit[0]) > 1e-3).all(1)


def central_difference(function, F, step=1e-5):
    """Fourth-order differences of a function of F (m, 3, k) by each entry, shape (m, ..., 3, k)."""
    columns = []
    for i, j in product(range(3), range(F.shape[2])):
        E = np.zeros_like(F)
        E[:, i, j] = step
        slope = 8 * (function(F + E) - function(F - E)) - (function(F + 2 * E) - function(F - 2 * E))
        columns.append(slope / (12 * step))
    return np.stack(columns, axis=-1).reshape(*columns[0].shape, 3, F.shape[2])


@pytest.mark.parametrize("name", LAWS)
def test_stress_and_tangent_are_the_derivatives(name):
    law, F = LAWS[name], deformations(1)
    keep = away_from_kinks(law, F)
    assert keep.sum() > COUNT / 2
    assert np.allclose(law.stress(F), central_difference(law.psi, F), atol=1e-8)
    assert np.allclose(law.tangent(F)[keep], central_difference(law.stress, F, 1e-4)[keep], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("name", FINITE_AT_INVERSION)
def test_derivatives_hold_at_inversion(name):
    law, F = LAWS[name], inverted(3)
    keep = away_from_kinks(law, F)
    assert (np.linalg.det(F) < 0).sum() == COUNT / 2
    assert np.isfinite(law.psi(F)).all()
    assert np.allclose(law.stress(F), central_difference(law.psi, F), atol=1e-8)
    assert np.allclose(law.tangent(F)[keep], central_difference(law.stress, F, 1e-4)[keep], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", LAWS)
def test_frame_invariance_and_isotropy(name):
    law, F = LAWS[name], deformations(2)
    Q = Rotation.random(COUNT, random_state=9).as_matrix()
    assert np.allclose(law.psi(Q @ F), law.psi(F), atol=1e-12)
    assert np.allclose(law.psi(F @ Q), law.psi(F), atol=1e-12)
    assert np.allclose(law.stress(Q @ F), Q @ law.stress(F), atol=1e-11)


@pytest.mark.parametrize("name", LAWS)
def test_rest_is_free_of_stress(name):
    growth = 1.4 if "growth" in name else 1.0
    rest = np.cbrt(growth) * Rotation.random(COUNT, random_state=4).as_matrix()
    assert np.abs(LAWS[name].stress(rest)).max() < 1e-12
    assert np.abs(LAWS[name].psi(rest)).max() < 1e-14


@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_symmetric_and_projects_to_semidefinite(name):
    tangent = LAWS[name].tangent(deformations(5, size=0.9) if name in FINITE_AT_INVERSION else deformations(5))
    A = tangent.reshape(-1, 9, 9)
    scale = np.abs(A).max()
    assert np.allclose(A, A.transpose(0, 2, 1), atol=1e-11 * scale)
    projected = project_spd(tangent).reshape(-1, 9, 9)
    assert np.linalg.eigvalsh(projected).min() >= -1e-10 * scale
    definite = np.linalg.eigvalsh(A).min(axis=1) > 0
    assert np.array_equal(projected[definite], A[definite])


@pytest.mark.parametrize("name", INFINITE_AT_INVERSION)
def test_a_law_is_infinite_where_it_does_not_hold(name):
    rest = np.cbrt(1.4 if "growth" in name else 1.0)
    F = np.stack([np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 1.0, 0.0]), rest * np.eye(3)])
    psi = (LAWS[name].psi(F[[k] * COUNT])[0] for k in range(3))
    assert list(psi) == [np.inf, np.inf, pytest.approx(0.0, abs=1e-14)]


@pytest.mark.parametrize("name", ISOTROPIC)
def test_tangent_at_rest_is_isotropic_elasticity(name):
    """mu = 1.3 and lmbda = 7 for every law."""
    eye = np.eye(3)
    symmetric = np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye)
    expected = 1.3 * symmetric + 7.0 * np.einsum("ij,kl->ijkl", eye, eye)
    assert np.allclose(LAWS[name].tangent(eye[None])[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    "sigma", [(1.3, 0.8, 0.5), (2.5, 1.2, -0.7), (0.0, 0.0, 0.0), (9.0, 5.0, 3.0), (3.0, 3.0, 3.0)]
)
@pytest.mark.parametrize("target", [1.0, 1.4])
def test_nearest_of_determinant_is_the_nearest(sigma, target):
    """Against a minimisation over the two free stretches, from many starts."""
    s = nearest_of_determinant(np.array([sigma]), np.array([target]))[0][0]
    assert np.isclose(np.prod(s), target, rtol=1e-12)

    def distance(logs):
        trial = np.exp(np.clip(np.append(logs, np.log(target) - np.sum(logs)), -50, 50))
        return np.sum((trial - sigma) ** 2)

    starts = product((-1.5, 0.0, 1.0, 2.0), repeat=2)
    best = min(minimize(distance, start, method="BFGS", options={"gtol": 1e-10}).fun for start in starts)
    assert np.isclose(np.sum((s - sigma) ** 2), best, rtol=1e-8, atol=1e-12)


def test_volume_tangent_is_finite_where_nearest_points_merge():
    F = np.broadcast_to(2 * np.eye(3), (COUNT, 3, 3))
    assert np.isfinite(LAWS["Volume"].tangent(F)).all()
    assert np.isfinite(LAWS["Volume"].tangent(np.zeros((COUNT, 3, 3)))).all()


def test_membrane():
    law = Membrane(full(2.0), full(1.3))
    F = np.random.default_rng(6).normal(size=(COUNT, 3, 2))
    U, sigma, Vt = np.linalg.svd(F, full_matrices=False)
    assert np.allclose(law.psi(F), np.sum((sigma - np.sqrt(1.3)) ** 2, axis=1), atol=1e-12)
    assert np.allclose(law.stress(F), 2 * (F - np.sqrt(1.3) * U @ Vt), atol=1e-12)
    assert np.allclose(law.tangent(F), central_difference(law.stress, F, 1e-4), rtol=1e-6, atol=1e-6)


def test_rest_gradients_give_stretches_in_the_plane():
    rng = np.random.default_rng(7)
    X, triangles = rng.normal(size=(3, 3)), np.array([[0, 1, 2]])
    G, areas = rest_gradients(X, triangles)
    normal = np.cross(X[1] - X[0], X[2] - X[0])
    assert np.isclose(areas[0], np.linalg.norm(normal) / 2)
    A = rng.normal(size=(3, 3))
    F = np.einsum("ti,ta->ia", X @ A.T, G[0])
    tangents = np.linalg.svd(normal[None])[2][1:].T
    assert np.allclose(np.linalg.svd(F)[1], np.linalg.svd(A @ tangents)[1])
