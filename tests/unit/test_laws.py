"""One loop over every law in every form that a solver takes: psi, P, tangent, frames, rest, projection, inversion.

FEniCSx has laws by kernels, scikit-fem by complex steps and by hand.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.reference import Scene, materials
from softdeca.reference.fenicsx.energy.assembly import Stiffness
from softdeca.reference.fenicsx.energy.kernels import Elements, Kernel
from softdeca.reference.fenicsx.energy.solids import VolumeLaw, hyperelastic_law, strain_law
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.skfem import solids as skfem

STEP = 1e-5
ROOM = 64
MU, LMBDA, KAPPA = 1.0, 5.0, 5.0 + 2.0 / 3.0
GROWTH = 1.4


class Apart:
    """As many separate tets as there are deformation gradients, each the corner of a unit cube."""

    def __init__(self):
        corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        X = (corners + 2.0 * np.arange(ROOM)[:, None, None] * [1.0, 0.0, 0.0]).reshape(-1, 3)
        self.numbering = Numbering(Scene(X, np.arange(4 * ROOM).reshape(-1, 4), []))

    def displacement(self, F):
        """The displacement by node that has the gradients F, and none in the tets left over."""
        padded = np.concatenate([F, np.tile(np.eye(3), (ROOM - len(F), 1, 1))])
        corners = self.numbering.to_scene(self.numbering.X, np.empty((4 * ROOM, 3))).reshape(ROOM, 4, 3)
        moved = corners @ (padded - np.eye(3)).transpose(0, 2, 1)
        return self.numbering.to_dofs(moved.reshape(-1, 3))


class ByKernel:
    """A law of FEniCSx' kernels; `make` gives it for m tets from parameters, which become arrays."""

    def __init__(self, make, *parameters):
        self._law = lambda m: make(*(np.full(m, value) for value in parameters))
        self._tets = None

    def _prepare(self):
        if self._tets is None:
            self._tets = Apart()
            numbering = self._tets.numbering
            self._all = Kernel(Elements.from_tets(numbering, numbering.cell, 1), [self._law(ROOM)])
            self._first = Kernel(Elements.from_tets(numbering, numbering.cell[:1], 1), [self._law(1)])
            self._stiffness = Stiffness([numbering.cell_dofs], numbering.nodes)
        return self._tets

    def energy(self, F):
        tets, volume = self._prepare(), 1.0 / 6.0
        places = [tets.displacement(one[None]) for one in F]
        found = np.array([self._first.add_energy(u, np.zeros_like(u)) / volume for u in places])
        return np.where(np.isfinite(found), found, np.inf)

    def stress(self, F):
        tets = self._prepare()
        return self._all.stress(tets.displacement(F))[: len(F)]

    def _assembled(self, F, kept):
        """dP/dF from the stiffness by the three corners whose shape functions have unit vectors as gradients."""
        tets = self._prepare()
        self._stiffness.clear()
        self._all.add_hessian(tets.displacement(F), kept, self._stiffness)
        rows, columns, values = self._stiffness.assemble().getValuesCSR()
        whole = csr_matrix((values, columns, rows)).toarray()
        nodes = tets.numbering.dof.reshape(ROOM, 4)[: len(F), 1:]
        dofs = (3 * nodes[:, None, :] + np.arange(3)[:, None]).reshape(len(F), 9)
        return 6.0 * whole[dofs[:, :, None], dofs[:, None, :]]

    def tangent(self, F):
        return self._assembled(F, 1.0)

    def projected(self, F):
        return self._assembled(F, 0.0)


class ByHand:
    """A law of scikit-fem; `make` gives it for m points, every parameter an array."""

    def __init__(self, make, *parameters):
        self.make = lambda m: make(*(np.full(m, value) for value in parameters))

    def energy(self, F):
        return self.make(len(F)).psi(F)

    def stress(self, F):
        return self.make(len(F)).stress(F)

    def tangent(self, F):
        return self.make(len(F)).tangent(F).reshape(-1, 9, 9)

    def projected(self, F):
        return skfem.project_spd(self.make(len(F)).tangent(F)).reshape(-1, 9, 9)


def forms(law):
    """A material in each form that it has."""
    found = {"by kernel": ByKernel(lambda growth: hyperelastic_law(law, growth), 1.0)}
    kind = skfem.ByRotation if isinstance(law, materials.Corotated) else skfem.ByInvariants
    return found | {"by hand": ByHand(lambda: kind(law))}


MATERIALS = {
    "corotated": materials.Corotated(MU, LMBDA),
    "neo-Hookean": materials.NeoHookean(MU, LMBDA),
    "stable": materials.StableNeoHookean(MU, LMBDA),
    "St. Venant-Kirchhoff": materials.StVenantKirchhoff(MU, LMBDA),
    "isochoric, quadratic": materials.IsochoricNeoHookean(MU, KAPPA),
    "isochoric, logarithmic": materials.IsochoricNeoHookean(MU, KAPPA, "kappa/4 (J^2-1-2 ln J)"),
    "Mooney-Rivlin": materials.MooneyRivlin(0.3, 0.2, KAPPA, C20=0.4),
}
NEO_HOOKEAN, COROTATED = MATERIALS["neo-Hookean"], MATERIALS["corotated"]
FORMS = {
    **{name: forms(law) for name, law in MATERIALS.items()},
    "strain": {
        "by kernel": ByKernel(strain_law, 2.0, 1.0),
        "by hand": ByHand(skfem.Strain, 2.0, 1.0),
    },
    "strain limit": {
        "by kernel": ByKernel(strain_law, 2.0, 1.1),
        "by hand": ByHand(skfem.Strain, 2.0, 1.1),
    },
    "volume": {"by kernel": ByKernel(VolumeLaw, 3.0, 1.0), "by hand": ByHand(skfem.Volume, 3.0, 1.0)},
    "volume grown": {"by kernel": ByKernel(VolumeLaw, 3.0, GROWTH), "by hand": ByHand(skfem.Volume, 3.0, GROWTH)},
    "corotated grown": {
        "by kernel": ByKernel(lambda g: hyperelastic_law(COROTATED, g), GROWTH),
        "by hand": ByHand(lambda g: skfem.Grown(skfem.ByRotation(COROTATED), g), GROWTH),
    },
    "neo-Hookean grown": {
        "by kernel": ByKernel(lambda g: hyperelastic_law(NEO_HOOKEAN, g), GROWTH),
        "by hand": ByHand(lambda g: skfem.Grown(skfem.ByInvariants(NEO_HOOKEAN), g), GROWTH),
    },
}
LAWS = {(name, form): law for name, of_name in FORMS.items() for form, law in of_name.items()}
FINITE = ("strain", "volume", "corotated", "stable", "St. Venant-Kirchhoff")
every_law = pytest.mark.parametrize(("name", "form"), LAWS)
finite_law = pytest.mark.parametrize(("name", "form"), [key for key in LAWS if key[0].startswith(FINITE)])
infinite_law = pytest.mark.parametrize(("name", "form"), [key for key in LAWS if not key[0].startswith(FINITE)])


def rotations(count, seed):
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))[0]
    return q * np.sign(np.linalg.det(q))[:, None, None]


def gradients(upright):
    """Deformation gradients: generic, repeated singular values, far from rest, and (not upright) inverted."""
    rng = np.random.default_rng(1)
    s = [[1.3, 1.3, 0.8], [0.7, 0.7, 0.7], [1.4, 0.9, 0.9], [1.0 + 1e-7, 1.0, 0.9], [2.5, 0.5, 0.4], [1.2, 1.2, 1.2]]
    if not upright:
        s += [[1.2, 0.8, -0.3], [1.5, 1.5, -0.2], [0.9, 0.5, -0.1], [1.3, 0.7, 1e-3]]
        s += list(np.sort(rng.uniform(0.3, 2.0, (10, 3)))[:, ::-1] * [1.0, 1.0, -1.0])
    s = np.array(s)
    special = rotations(len(s), 2) @ (s[:, :, None] * rotations(len(s), 3))
    generic = np.eye(3) + 0.25 * rng.normal(size=(20, 3, 3))
    generic = generic[np.linalg.det(generic) > 0.2]
    return np.concatenate([special, generic])


def samples(name, smooth=False):
    """Gradients where the law holds; smooth: away from the kinks of the strain limit."""
    F = gradients(upright=not name.startswith(FINITE))
    if smooth and name == "strain limit":
        s = np.linalg.svd(F, compute_uv=False)
        F = F[(np.abs(s[:, :, None] - [1.1, 1 / 1.1]) > 1e-3).all(axis=(1, 2))]
    return F


def assert_close(actual, expected, relative=1e-7):
    """Within `relative` of each sample's largest entry, or of 1 where that is less."""
    actual, expected = (np.asarray(a).reshape(len(a), -1) for a in (actual, expected))
    assert (np.abs(actual - expected).max(axis=1) <= relative * np.maximum(1.0, np.abs(expected).max(axis=1))).all()


def differences(function, F, step=STEP):
    """Central differences by each entry of F, in the last axis; fourth order."""
    columns = []
    for i, j in product(range(3), range(F.shape[2])):
        d = np.zeros(F.shape[1:])
        d[i, j] = step
        near = function(F + d) - function(F - d)
        far = function(F + 2 * d) - function(F - 2 * d)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def test_every_law_is_in_the_loop():
    laws = {type(law) for law in MATERIALS.values()}
    assert laws == set(materials.LAWS) - {materials.EnergyLaw, materials.Incompressible}


@every_law
def test_stress_and_tangent_are_the_derivatives(name, form):
    law, F = LAWS[name, form], samples(name, smooth=True)
    assert_close(differences(law.energy, F), law.stress(F).reshape(-1, 9))
    C = law.tangent(F)
    assert_close(differences(lambda G: law.stress(G).reshape(-1, 9), F), C)
    assert_close(C.transpose(0, 2, 1), C, 1e-13)


@pytest.mark.parametrize("name", FORMS)
def test_the_forms_of_a_law_are_one_law(name):
    """Energy, stress and tangent of each against those of the first."""
    F = samples(name, smooth=True)
    first, *others = FORMS[name].values()
    for law in others:
        assert_close(law.energy(F), first.energy(F), 1e-12)
        assert_close(law.stress(F), first.stress(F), 1e-11)
        assert_close(law.tangent(F), first.tangent(F), 1e-8)


@every_law
def test_frame_invariance(name, form):
    law, F = LAWS[name, form], samples(name)
    R, Q = rotations(len(F), 4), rotations(len(F), 5)
    assert_close(law.energy(R @ F @ Q), law.energy(F), 1e-12)
    assert_close(law.stress(R @ F @ Q), R @ law.stress(F) @ Q, 1e-11)


@every_law
def test_rest_and_rotations_are_free_of_stress(name, form):
    """Rest of grown tissue is its shape at that volume."""
    R = np.concatenate([np.eye(3)[None], rotations(8, 6)]) * (GROWTH ** (1 / 3) if "grown" in name else 1.0)
    assert np.abs(LAWS[name, form].energy(R)).max() < 1e-14
    assert np.abs(LAWS[name, form].stress(R)).max() < 1e-13


@every_law
def test_projection_is_the_nearest_semi_definite_tangent(name, form):
    law, F = LAWS[name, form], samples(name)
    projected = law.projected(F)
    values, vectors = np.linalg.eigh(law.tangent(F))
    clamped = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    scale = np.maximum(1.0, np.abs(values).max(axis=1))
    assert (np.linalg.eigvalsh(projected).min(axis=1) >= -1e-10 * scale).all()
    assert_close(projected, clamped, 1e-9)


ISOTROPIC = [key for key in LAWS if key[0] in (*MATERIALS, "strain", "volume")]


@pytest.mark.parametrize(("name", "form"), ISOTROPIC)
def test_small_strain_moduli(name, form):
    """2 mu = stiffness of Strain and 3 lmbda = stiffness of Volume: the tangent at rest is isotropic elasticity's."""
    eye = np.eye(3)
    symmetric = 0.5 * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye)).reshape(9, 9)
    trace = np.einsum("ij,kl->ijkl", eye, eye).reshape(9, 9)
    mu, lmbda = {"strain": (1.0, 0.0), "volume": (0.0, 1.0)}.get(name, (MU, LMBDA))
    assert np.allclose(LAWS[name, form].tangent(eye[None])[0], 2.0 * mu * symmetric + lmbda * trace, atol=1e-12)


COLLAPSED = np.array(
    [np.zeros((3, 3)), 2 * np.eye(3), np.diag([1.0, 1, 0]), np.diag([1.0, 0, 0]), -np.eye(3), np.diag([1, 0.5, -0.5])]
)
"""With 2 I, where nearest points of det F = 1 merge."""


@finite_law
def test_collapse_and_inversion_are_finite(name, form):
    law = LAWS[name, form]
    for values in (law.energy(COLLAPSED), law.stress(COLLAPSED), law.tangent(COLLAPSED)):
        assert np.isfinite(values).all()


@infinite_law
def test_collapse_and_inversion_are_refused(name, form):
    """The energy that the line search sees is infinite, not a number that is none."""
    bad = np.delete(COLLAPSED, 1, axis=0)
    if form == "by kernel":
        # Derivatives of shape functions are rounded as the processor has it, so that a collapse is none to the bit.
        bad = bad[np.linalg.det(bad) < 0]
    assert (LAWS[name, form].energy(bad) == np.inf).all()


def test_densities_against_their_formulas():
    """Formulas of principal stretches."""
    F = gradients(upright=True)
    s = np.linalg.svd(F, compute_uv=False)
    s2, J = s**2, np.linalg.det(F)
    i1 = J ** (-2 / 3) * s2.sum(1)
    i2 = J ** (-4 / 3) * (s2[:, 0] * s2[:, 1] + s2[:, 1] * s2[:, 2] + s2[:, 2] * s2[:, 0])
    volume = KAPPA / 2 * (J - 1) ** 2
    m, k = 4 / 3 * MU, LMBDA + 5 / 6 * MU
    a = 1 + m / k - m / (4 * k)

    def stable(I1, J):
        return m / 2 * (I1 - 3) + k / 2 * (J - a) ** 2 - m / 2 * np.log(I1 + 1)

    expected = {
        "corotated": MU * np.sum((s - 1) ** 2, 1) + LMBDA / 2 * (s.sum(1) - 3) ** 2,
        "neo-Hookean": MU / 2 * (s2.sum(1) - 3) - MU * np.log(J) + LMBDA / 2 * np.log(J) ** 2,
        "stable": stable(s2.sum(1), J) - stable(3.0, 1.0),
        "St. Venant-Kirchhoff": MU * np.sum((s2 - 1) ** 2, 1) / 4 + LMBDA / 8 * (s2.sum(1) - 3) ** 2,
        "isochoric, quadratic": MU / 2 * (i1 - 3) + volume,
        "isochoric, logarithmic": MU / 2 * (i1 - 3) + KAPPA / 4 * (J**2 - 1 - 2 * np.log(J)),
        "Mooney-Rivlin": 0.3 * (i1 - 3) + 0.2 * (i2 - 3) + 0.4 * (i1 - 3) ** 2 + volume,
    }
    assert expected.keys() == MATERIALS.keys()
    for name, values in expected.items():
        for law in FORMS[name].values():
            assert_close(law.energy(F), values, 1e-12)


@dataclass(frozen=True)
class Branched(materials.EnergyLaw):
    """A law of every operation that kernels know; of no physical meaning."""

    mu: float = 1.0

    @property
    def lame(self):
        return self.mu, self.mu

    def density(self, I1, I2, J, p, m):
        away = m.where(J > 0.9, m.sin(J), m.cos(J) ** 3)
        bounded = m.where(J > 1.0, m.sqrt(J - 1) ** 3 + (J - 1) ** 2.5, 0.0)  # no numbers below 1
        bounded += m.where(I1 < 3.1, 3.1, I1)
        smooth = m.sqrt(I1) + m.exp(-I1) + m.tanh(J) + m.arctan(J) + I1**1.5 + J**p.mu + I1**-3 + J**-0.5
        return p.mu * 6 * I1 + away + bounded + smooth + (1 - I2) / (2 / I1) - m.log(J)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_kernels_know_every_operation():
    F = gradients(upright=True)
    F = F[np.abs(np.linalg.det(F)[:, None] - [0.9, 1.0]).min(axis=1) > 1e-3]  # away from its kinks
    by_kernel, by_hand = forms(Branched()).values()
    assert_close(by_kernel.energy(F), by_hand.energy(F), 1e-12)
    assert_close(by_kernel.stress(F), by_hand.stress(F), 1e-11)
    assert_close(by_kernel.tangent(F), by_hand.tangent(F), 1e-8)


@pytest.mark.parametrize("F", [gradients(False), np.zeros((1, 3, 3)), np.diag([0.0, 2.0, 0.0])[None], -np.eye(3)[None]])
def test_signed_svd(F):
    U, s, Vt = skfem.signed_svd(F)
    V = Vt.transpose(0, 2, 1)
    assert np.allclose((U * s[:, None, :]) @ V.transpose(0, 2, 1), F, atol=1e-14)
    for rotation in (U, V):
        assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3), atol=1e-14)
        assert np.allclose(np.linalg.det(rotation), 1.0)
    assert (np.diff(s, axis=1) <= 1e-15).all() and (s[:, 1] >= np.abs(s[:, 2]) - 1e-15).all()
    assert np.allclose(np.abs(s), np.linalg.svd(F, compute_uv=False), atol=1e-14)
