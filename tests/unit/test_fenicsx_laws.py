"""V16's loop over every law, in principal stretches or by UFL: psi, P, tangent, frames, rest, projection, inversion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("dolfinx")

from softdeca.reference import Scene, materials, prepare, terms
from softdeca.reference.fenicsx import dolfinx_version as seam
from softdeca.reference.fenicsx import principal
from softdeca.reference.fenicsx.hyperelastic import HyperelasticForms, density
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.solids import (
    Grown,
    StrainLaw,
    VolumeLaw,
    nearest_with_determinant,
)
from softdeca.reference.problems import meshes

from .tangents import tangent

STEP = 1e-5
ROOM = 64
FIBRE = np.array([2.0, -1.0, 2.0]) / 3.0


class Principal:
    """A law of the singular values; `make` gives it for m points, every parameter an array."""

    def __init__(self, make, *parameters):
        self.make = lambda m: make(*(np.full(m, value) for value in parameters))

    def _at(self, F):
        U, s, V = principal.signed_svd(np.ascontiguousarray(F))
        return U, s, V, *self.make(len(F)).by_stretches(s)

    def energy(self, F):
        return self._at(F)[3]

    def stress(self, F):
        U, _, V, _, p, _ = self._at(F)
        return principal.stress(U, V, p)

    def tangent(self, F):
        U, s, V, _, p, h = self._at(F)
        return tangent(U, V, principal.modes(s, p, h))

    def projected(self, F):
        U, s, V, _, p, h = self._at(F)
        return tangent(U, V, principal.modes(s, p, h).softened(0.0))


class ByUfl:
    """A law's density in UFL and what UFL derives, on as many separate tets as there are deformation gradients."""

    def __init__(self, material, growth=1.0):
        self.material, self.growth = material, growth
        self.forms = None

    def _compile(self):
        corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        X = (corners + 2.0 * np.arange(ROOM)[:, None, None] * [1.0, 0.0, 0.0]).reshape(-1, 3)
        numbering = Numbering(Scene(X, np.arange(4 * ROOM).reshape(-1, 4), []))
        u, points = seam.function(numbering.space), seam.quadrature_rule(1)[0]
        cells = numbering.cell
        self.forms = HyperelasticForms.of(u, cells, self.material, growth=self.growth)
        psi, F = density(u, cells, self.material, self.growth)
        self._psi = seam.evaluator(psi, points, numbering.space.mesh)
        self._stress = seam.evaluator(seam.ufl.diff(psi, F), points, numbering.space.mesh)
        self._numbering, self._u = numbering, u

    def set(self, F):
        if self.forms is None:
            self._compile()
        padded = np.concatenate([F, np.tile(np.eye(3), (ROOM - len(F), 1, 1))])
        corners = self._numbering.to_scene(self._numbering.X, np.empty((4 * ROOM, 3))).reshape(ROOM, 4, 3)
        moved = corners @ (padded - np.eye(3)).transpose(0, 2, 1)
        self._u.x.array[:] = self._numbering.to_dofs(moved.reshape(-1, 3)).ravel()
        return slice(len(F))

    def energy(self, F):
        at = self.set(F)
        return self._psi(self._numbering.cell[at]).ravel()

    def stress(self, F):
        at = self.set(F)
        return self._stress(self._numbering.cell[at]).reshape(-1, 3, 3)

    def tangent(self, F):
        at = self.set(F)
        return self.forms.point_tangent()[at]

    def projected(self, F):
        at = self.set(F)
        return self.forms.softened_tangent(0.0)[at]


MU, LMBDA, KAPPA = 1.0, 5.0, 5.0 + 2.0 / 3.0
GROWTH = 1.4
ISOTROPIC = {
    "corotated": Principal(lambda: materials.Corotated(MU, LMBDA)),
    "neo-hooke, principal": Principal(lambda: materials.NeoHookean(MU, LMBDA)),
    "neo-hooke": ByUfl(materials.NeoHookean(MU, LMBDA)),
    "stable neo-hooke, principal": Principal(lambda: materials.StableNeoHookean(MU, LMBDA)),
    "stable neo-hooke": ByUfl(materials.StableNeoHookean(MU, LMBDA)),
    "St. Venant-Kirchhoff": ByUfl(materials.StVenantKirchhoff(MU, LMBDA)),
    "isochoric, quadratic": ByUfl(materials.IsochoricNeoHookean(MU, KAPPA)),
    "isochoric, logarithmic": ByUfl(materials.IsochoricNeoHookean(MU, KAPPA, "kappa/4 (J^2-1-2 ln J)")),
    "Mooney-Rivlin": ByUfl(materials.MooneyRivlin(0.3, 0.2, KAPPA, C20=0.4)),
}
LAWS = {
    "strain": Principal(StrainLaw, 2.0, 1.0, 1.0),
    "strain limit": Principal(StrainLaw, 2.0, 1.1, 1.0),
    "strain growth": Principal(StrainLaw, 2.0, 1.0, GROWTH),
    "volume": Principal(VolumeLaw, 3.0, 1.0),
    "volume target": Principal(VolumeLaw, 3.0, 1.4),
    **ISOTROPIC,
    "Guccione": ByUfl(materials.Guccione(2.0, 8.0, 2.0, 4.0, FIBRE, KAPPA)),
    "corotated growth": Principal(lambda growth: Grown(materials.Corotated(MU, LMBDA), growth), GROWTH),
    "neo-hooke growth": ByUfl(materials.NeoHookean(MU, LMBDA), GROWTH),
}
GROWN = ["volume target", "strain growth", "corotated growth", "neo-hooke growth"]
FINITE = ["strain", "strain limit", "volume", "volume target", "corotated", "stable neo-hooke", "St. Venant-Kirchhoff"]
FINITE += ["strain growth", "corotated growth", "stable neo-hooke, principal"]
INFINITE = [name for name in LAWS if name not in FINITE]


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


def assert_close(actual, expected, relative=1e-7):
    """Within `relative` of each sample's largest entry, or of 1 where that is less."""
    actual, expected = (np.asarray(a).reshape(len(a), -1) for a in (actual, expected))
    assert (np.abs(actual - expected).max(axis=1) <= relative * np.maximum(1.0, np.abs(expected).max(axis=1))).all()


def differences(function, F):
    """Central differences by each entry of F, in the last axis; fourth order."""
    columns = []
    for k in range(9):
        d = STEP * np.eye(9)[k].reshape(3, 3)
        near = function(F + d) - function(F - d)
        far = function(F + 2 * d) - function(F - 2 * d)
        columns.append((8 * near - far) / (12 * STEP))
    return np.stack(columns, axis=-1)


def smooth(name):
    """Samples away from the kinks of the strain limit, where the energy has no second derivative."""
    F = gradients(upright=name in INFINITE)
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
    law, F = LAWS[name], smooth(name)
    assert_close(differences(law.energy, F), law.stress(F).reshape(-1, 9))


@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name):
    law, F = LAWS[name], smooth(name)
    C = law.tangent(F)
    assert_close(differences(lambda G: law.stress(G).reshape(-1, 9), F), C)
    assert_close(C.transpose(0, 2, 1), C, 1e-13)


@pytest.mark.parametrize("name", LAWS)
def test_frame_invariance(name):
    law, F = LAWS[name], gradients(upright=name in INFINITE)
    R, Q = rotations(len(F), 4), rotations(len(F), 5)
    if name == "Guccione":  # turned about its fibres at rest, it stays the same
        Q = np.broadcast_to(Rotation.from_rotvec(FIBRE).as_matrix(), R.shape)
    assert_close(law.energy(R @ F @ Q), law.energy(F), 1e-12)
    assert_close(law.stress(R @ F @ Q), R @ law.stress(F) @ Q, 1e-11)


@pytest.mark.parametrize("name", LAWS)
def test_rest_and_rotations_are_free_of_stress(name):
    """Rest of grown tissue is its shape at that volume."""
    R = np.concatenate([np.eye(3)[None], rotations(8, 6)]) * (GROWTH ** (1 / 3) if name in GROWN else 1.0)
    assert np.abs(LAWS[name].energy(R)).max() < 1e-14
    assert np.abs(LAWS[name].stress(R)).max() < 1e-13


def test_small_strain_moduli():
    """2 mu = stiffness of Strain and 3 lmbda = stiffness of Volume: the tangent at rest is isotropic elasticity's."""
    eye = np.eye(3)
    symmetric = 0.5 * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye)).reshape(9, 9)
    trace = np.einsum("ij,kl->ijkl", eye, eye).reshape(9, 9)
    assert np.allclose(LAWS["strain"].tangent(eye[None])[0], 2.0 * symmetric, atol=1e-12)
    assert np.allclose(LAWS["volume"].tangent(eye[None])[0], 3.0 / 3.0 * trace, atol=1e-12)
    for law in ISOTROPIC.values():
        assert np.allclose(law.tangent(eye[None])[0], 2.0 * MU * symmetric + LMBDA * trace, atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_projection_is_the_nearest_semi_definite_tangent(name):
    law, F = LAWS[name], gradients(upright=name in INFINITE)
    projected = law.projected(F)
    values, vectors = np.linalg.eigh(law.tangent(F))
    clamped = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    scale = np.maximum(1.0, np.abs(values).max(axis=1))
    assert (np.linalg.eigvalsh(projected).min(axis=1) >= -1e-10 * scale).all()
    assert_close(projected, clamped, 1e-9)


COLLAPSED = np.array(
    [np.zeros((3, 3)), np.diag([1.0, 1, 0]), np.diag([1.0, 0, 0]), -np.eye(3), np.diag([1, 0.5, -0.5])]
)


@pytest.mark.parametrize("name", FINITE)
def test_collapse_and_inversion_are_finite(name):
    for values in (LAWS[name].energy(COLLAPSED), LAWS[name].stress(COLLAPSED), LAWS[name].tangent(COLLAPSED)):
        assert np.isfinite(values).all()


@pytest.mark.parametrize("name", [name for name in INFINITE if isinstance(LAWS[name], ByUfl)])
def test_collapse_and_inversion_are_refused(name):
    """The energy that the line search sees is infinite, not a number that is none."""
    law = LAWS[name]
    law.set(law.growth ** (1 / 3) * np.tile(np.eye(3), (ROOM, 1, 1)))
    assert law.forms.assemble_energy() < 1e-12
    for F in COLLAPSED:
        law.set(F[None])
        assert law.forms.assemble_energy() == np.inf


def test_densities_against_their_formulas():
    """By principal stretches, or for Guccione by the strain's components in a frame along the fibre."""
    F = gradients(upright=True)
    s2 = np.linalg.svd(F, compute_uv=False) ** 2
    J = np.linalg.det(F)
    i1, i2 = (
        J ** (-2 / 3) * s2.sum(1),
        J ** (-4 / 3) * (s2[:, 0] * s2[:, 1] + s2[:, 1] * s2[:, 2] + s2[:, 2] * s2[:, 0]),
    )
    volume = KAPPA / 2 * (J - 1) ** 2
    m, k = 4 / 3 * MU, LMBDA + 5 / 6 * MU
    a = 1 + m / k - m / (4 * k)

    def stable(I1, J):
        return m / 2 * (I1 - 3) + k / 2 * (J - a) ** 2 - m / 2 * np.log(I1 + 1)

    frame = np.stack([FIBRE, np.array([1.0, 2.0, 0.0]) / np.sqrt(5), np.cross(FIBRE, [1.0, 2.0, 0.0]) / np.sqrt(5)])
    E = frame @ ((J ** (-2 / 3))[:, None, None] * F.transpose(0, 2, 1) @ F - np.eye(3)) @ frame.T / 2
    Q = 8 * E[:, 0, 0] ** 2 + 2 * np.sum(E[:, 1:, 1:] ** 2, axis=(1, 2)) + 8 * np.sum(E[:, 0, 1:] ** 2, axis=1)
    expected = {
        "stable neo-hooke": stable(s2.sum(1), J) - stable(3.0, 1.0),
        "St. Venant-Kirchhoff": MU * np.sum((s2 - 1) ** 2, 1) / 4 + LMBDA / 8 * (s2.sum(1) - 3) ** 2,
        "isochoric, quadratic": MU / 2 * (i1 - 3) + volume,
        "isochoric, logarithmic": MU / 2 * (i1 - 3) + KAPPA / 4 * (J**2 - 1 - 2 * np.log(J)),
        "Mooney-Rivlin": 0.3 * (i1 - 3) + 0.2 * (i2 - 3) + 0.4 * (i1 - 3) ** 2 + volume,
        "Guccione": np.exp(Q) - 1 + volume,
        "neo-hooke": LAWS["neo-hooke, principal"].energy(F),
        "stable neo-hooke, principal": stable(s2.sum(1), J) - stable(3.0, 1.0),
    }
    for name, values in expected.items():
        assert_close(LAWS[name].energy(F), values, 1e-12)


def test_fibres_follow_their_tets():
    """The energy of an affine motion is the sum over the tets, each with its own fibre, however cells are numbered."""
    rng = np.random.default_rng(8)
    X, tets = meshes.unstructured(2)
    fibres = rng.normal(size=(len(tets), 3))
    A = np.eye(3) + 0.2 * rng.normal(size=(3, 3))
    law = materials.Guccione(2.0, 8.0, 2.0, 4.0, fibres, KAPPA)
    some = rng.permutation(len(tets))[: len(tets) // 2]
    part = materials.Guccione(2.0, 8.0, 2.0, 4.0, fibres[some], KAPPA)
    whole = Scene(X, tets, [terms.Hyperelastic(law)])
    half = Scene(X, tets, [terms.Hyperelastic(part, tets=some)])
    J = np.linalg.det(A)
    E = (J ** (-2 / 3) * A.T @ A - np.eye(3)) / 2
    row = law.fibres @ E
    along, row = np.einsum("ij,ij->i", row, law.fibres) ** 2, np.sum(row**2, axis=1)
    Q = 8 * along + 2 * (np.sum(E**2) - 2 * row + along) + 8 * (row - along)
    psi = np.exp(Q) - 1 + KAPPA / 2 * (J - 1) ** 2
    for scene, acted in ((whole, np.arange(len(tets))), (half, some)):
        solution = prepare(scene, solver="fenicsx").solve(start=X @ A.T, max_iterations=0)
        assert solution.energy == pytest.approx(scene.volumes[acted] @ psi[acted], rel=1e-12)


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
