"""V16's loop, by finite differences, over PD's energies and neo-Hooke in principal stretches: psi, P, tangent."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.reference.fenicsx import principal
from softdeca.reference.fenicsx.laws import NeoHookeanLaw, StrainLaw, VolumeLaw, nearest_with_determinant

STEP = 1e-5


def ones(value, m):
    return np.full(m, float(value))


LAWS = {
    "strain": lambda m: StrainLaw(ones(2.0, m), ones(1.0, m)),
    "strain limit": lambda m: StrainLaw(ones(2.0, m), ones(1.1, m)),
    "volume": lambda m: VolumeLaw(ones(3.0, m), ones(1.0, m)),
    "volume target": lambda m: VolumeLaw(ones(3.0, m), ones(1.4, m)),
    "neo-hooke": lambda m: NeoHookeanLaw(ones(1.0, m), ones(5.0, m)),
}
PD = [name for name in LAWS if name != "neo-hooke"]


def rotations(count, seed):
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))[0]
    return q * np.sign(np.linalg.det(q))[:, None, None]


def gradients(upright):
    """Deformation gradients: generic, repeated singular values, far from rest, and (not upright) inverted."""
    rng = np.random.default_rng(1)
    s = [[1.3, 1.3, 0.8], [0.7, 0.7, 0.7], [1.4, 0.9, 0.9], [1.0 + 1e-7, 1.0, 0.9], [2.5, 0.5, 0.4], [1.2, 1.2, 1.2]]
    if not upright:
        s += [[1.2, 0.8, -0.3], [1.5, 1.5, -0.2], [0.9, 0.5, -0.1], [1.3, 0.7, 1e-3]]
    s = np.array(s)
    special = rotations(len(s), 2) @ (s[:, :, None] * rotations(len(s), 3))
    generic = np.eye(3) + 0.25 * rng.normal(size=(20, 3, 3))
    generic = generic[np.linalg.det(generic) > 0.2]
    return np.concatenate([special, generic])


def energy(name, F):
    _, s, _ = principal.signed_svd(np.ascontiguousarray(F))
    return LAWS[name](len(F)).evaluate(s)[0]


def stress(name, F):
    U, s, V = principal.signed_svd(np.ascontiguousarray(F))
    return principal.stress(U, V, LAWS[name](len(F)).evaluate(s)[1])


def modes(name, F):
    U, s, V = principal.signed_svd(np.ascontiguousarray(F))
    _, p, h = LAWS[name](len(F)).evaluate(s)
    return U, V, principal.modes(s, p, h)


def tangent(name, F):
    return principal.tangent(*modes(name, F))


def differences(function, F):
    """Central differences by each entry of F, in the last axis; fourth order."""
    columns = []
    for k in range(9):
        d = STEP * np.eye(9)[k].reshape(3, 3)
        near = function(F + d) - function(F - d)
        far = function(F + 2 * d) - function(F - 2 * d)
        columns.append((8 * near - far) / (12 * STEP))
    return np.stack(columns, axis=-1)


def smooth(name, upright=True):
    """Samples away from the kinks of the strain limit, where the energy has no second derivative."""
    F = gradients(upright)
    if name == "strain limit":
        s = principal.signed_svd(F)[1]
        F = F[(np.abs(s[:, :, None] - [1.1, 1 / 1.1]) > 1e-3).all(axis=(1, 2))]
    return F


@pytest.mark.parametrize("F", [gradients(False), np.zeros((1, 3, 3)), np.diag([0.0, 2.0, 0.0])[None], -np.eye(3)[None]])
def test_signed_svd(F):
    U, s, V = principal.signed_svd(F)
    assert np.allclose((U * s[:, None, :]) @ V.transpose(0, 2, 1), F, atol=1e-14)
    for rotation in (U, V):
        assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3), atol=1e-14)
        assert np.allclose(np.linalg.det(rotation), 1.0)
    assert (np.diff(s, axis=1) <= 0).all() and (s[:, 1] >= np.abs(s[:, 2]) - 1e-15).all()
    assert np.allclose(np.abs(s), np.linalg.svd(F, compute_uv=False), atol=1e-14)


@pytest.mark.parametrize("name", LAWS)
def test_stress_is_the_derivative_of_the_energy(name):
    F = smooth(name, upright=name == "neo-hooke")
    P = stress(name, F)
    assert np.abs(differences(lambda G: energy(name, G), F) - P.reshape(-1, 9)).max() < 1e-7 * np.abs(P).max()


@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name):
    F = smooth(name, upright=name == "neo-hooke")
    C = tangent(name, F)
    difference = differences(lambda G: stress(name, G).reshape(-1, 9), F)
    assert np.abs(difference - C).max() < 1e-7 * np.abs(C).max()
    assert np.array_equal(C, C.transpose(0, 2, 1))


@pytest.mark.parametrize("name", LAWS)
def test_frame_invariance(name):
    F = gradients(upright=name == "neo-hooke")
    R, Q = rotations(len(F), 4), rotations(len(F), 5)
    assert np.allclose(energy(name, R @ F @ Q), energy(name, F), rtol=1e-12, atol=1e-13)
    assert np.allclose(stress(name, R @ F @ Q), R @ stress(name, F) @ Q, atol=1e-11)


@pytest.mark.parametrize("name", ["strain", "strain limit", "volume", "neo-hooke"])
def test_rest_and_rotations_are_free_of_stress(name):
    R = np.concatenate([np.eye(3)[None], rotations(8, 6)])
    assert np.abs(energy(name, R)).max() < 1e-14
    assert np.abs(stress(name, R)).max() < 1e-13


def test_small_strain_moduli():
    """2 mu = stiffness of Strain and 3 lmbda = stiffness of Volume: the tangent at rest is isotropic elasticity's."""
    eye = np.eye(3)
    symmetric = 0.5 * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye)).reshape(9, 9)
    trace = np.einsum("ij,kl->ijkl", eye, eye).reshape(9, 9)
    assert np.allclose(tangent("strain", eye[None])[0], 2.0 * symmetric, atol=1e-12)
    assert np.allclose(tangent("volume", eye[None])[0], 3.0 / 3.0 * trace, atol=1e-12)
    assert np.allclose(tangent("neo-hooke", eye[None])[0], 2.0 * symmetric + 5.0 * trace, atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_projection_is_the_nearest_semi_definite_tangent(name):
    F = gradients(upright=name == "neo-hooke")
    U, V, exact = modes(name, F)
    projected = principal.tangent(U, V, exact.softened(0.0))
    values, vectors = np.linalg.eigh(principal.tangent(U, V, exact))
    clamped = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    assert np.linalg.eigvalsh(projected).min() >= -1e-10
    assert np.abs(projected - clamped).max() < 1e-9 * np.abs(values).max()


@pytest.mark.parametrize("name", PD)
def test_collapse_and_inversion_are_finite(name):
    F = np.array(
        [np.zeros((3, 3)), np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 0, 0]), -np.eye(3), np.diag([1, 0.5, -0.5])]
    )
    for values in (energy(name, F), stress(name, F), tangent(name, F)):
        assert np.isfinite(values).all()


def test_nearest_determinant_against_brute_force():
    """The nearest point with t1 t2 t3 = v among a fine grid of (t2, t3), signs included."""
    grid = np.linspace(0.02, 2.5, 1241)
    t2, t3 = np.meshgrid(grid, grid, indexing="ij")
    for s, v in (([1.2, 0.9, 0.5], 1.0), ([1.5, 1.2, 0.9], 0.8), ([1.1, 0.6, -0.4], 1.0), ([2.0, 1.0, 0.5], 0.05)):
        t = nearest_with_determinant(np.array([s]), np.array([v]))[0]
        brute = ((v / (t2 * t3) - s[0]) ** 2 + (t2 - s[1]) ** 2 + (t3 - s[2]) ** 2).min()
        mine = np.sum((t - s) ** 2)
        assert abs(np.prod(t) - v) < 1e-14
        assert mine <= brute + 1e-12 and mine > brute - 1e-3
