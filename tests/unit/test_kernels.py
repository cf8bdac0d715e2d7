"""Compiled kernels against FEniCSx' own assembly of UFL's forms, and how they are compiled and kept."""

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.reference import Scene, materials, terms
from softdeca.reference.fenicsx import dolfinx_version as seam
from softdeca.reference.fenicsx.energy.assembly import Stiffness
from softdeca.reference.fenicsx.energy.quadrature import DEGREES, Quadrature
from softdeca.reference.fenicsx.energy.solids import Solids
from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.problems import meshes

from .ufl_forms import HyperelasticForms, assemble_tangent

MU, LMBDA, KAPPA = 1.0, 5.0, 5.0 + 2.0 / 3.0
X, TETS = meshes.unstructured(2)
LAWS = {
    "neo-Hookean": materials.NeoHookean(MU, LMBDA),
    "stable": materials.StableNeoHookean(MU, LMBDA),
    "St. Venant-Kirchhoff": materials.StVenantKirchhoff(MU, LMBDA),
    "isochoric, quadratic": materials.IsochoricNeoHookean(MU, KAPPA),
    "isochoric, logarithmic": materials.IsochoricNeoHookean(MU, KAPPA, "kappa/4 (J^2-1-2 ln J)"),
    "Mooney-Rivlin": materials.MooneyRivlin(0.3, 0.2, KAPPA, C20=0.4),
}


def solids_of(degree, law, growth=1.0):
    scene = Scene(X, TETS, [terms.Hyperelastic(law, growth=growth)])
    order = Numbering(scene, degree)
    return order, Solids(scene, order, None)


def deformed(order, seed, size=0.4):
    """A large displacement by node: a linear map that inverts nothing, and noise of a fiftieth of a tet's size."""
    rng = np.random.default_rng(seed)
    noise = 0.02 * np.cbrt(order.cell_volumes.min()) * rng.normal(size=order.X.shape)
    return order.X @ (expm(size * rng.normal(size=(3, 3))) - np.eye(3)) + noise


def assert_close(actual, expected, relative):
    assert np.abs(actual - expected).max() <= relative * np.abs(expected).max()


def assert_hessians_close(state, forms, order, points, matrices, *, exact, projected):
    """Assemble a state's Hessian by kernels and by UFL's forms, with all, half and none of its negative curvature."""
    ours, theirs = matrices
    for kept in (1.0, 0.5, 0.0):
        ours.clear()
        theirs.clear()
        state.add_hessian(ours, kept)
        if kept == 1.0:
            seam.add_matrix(forms.tangent, theirs.local)
            theirs.local.assemble()
            assert_close(ours.values, theirs.values, exact)
        else:
            dense = csr_matrix(ours.assemble().getValuesCSR()[::-1]).toarray()
            assert_close(dense, assemble_tangent(order, points, forms.cells, forms.softened_tangent(kept)), projected)


@pytest.mark.parametrize(("name", "degree"), [("neo-Hookean", 1), *((name, 2) for name in LAWS)])
def test_kernels_are_the_forms_of_ufl(name, degree):
    growth = np.random.default_rng(1).uniform(0.8, 1.2, len(TETS)) if name == "Mooney-Rivlin" else 1.0
    order, solids = solids_of(degree, LAWS[name], growth)
    assert solids.kernels
    u = seam.function(order.space)
    forms = HyperelasticForms(u, order.cell, LAWS[name], DEGREES[degree], growth)
    points = Quadrature(order, np.arange(len(TETS)), DEGREES[degree])
    at = solids.points(order.cell)
    ours, theirs = (Stiffness([order.cell_dofs], order.nodes) for _ in range(2))
    for seed in range(3):
        u.x.array[:] = deformed(order, seed).ravel()
        state = solids.at(u.x.array.reshape(-1, 3), None)
        energy = forms.assemble_energy()
        assert np.isfinite(energy) and abs(state.energy() - energy) <= 1e-13 * energy
        gradient, expected = np.zeros_like(order.X), np.zeros(order.X.size)
        state.add_gradient(gradient)
        forms.add_gradient(expected)
        assert_close(gradient.ravel(), expected, 1e-12)
        assert_close(state.stresses()[1][at], forms.point_stress(), 1e-13)
        assert_hessians_close(state, forms, order, points, (ours, theirs), exact=1e-12, projected=1e-10)


MIXED = {
    "neo-Hookean": LAWS["neo-Hookean"],
    "Mooney-Rivlin": LAWS["Mooney-Rivlin"],
    "incompressible": materials.Incompressible(LAWS["isochoric, quadratic"]),
}


@pytest.mark.parametrize("name", MIXED)
def test_kernels_of_laws_with_a_pressure_are_the_forms_of_ufl(name):
    law, growth = MIXED[name], np.random.default_rng(1).uniform(0.8, 1.2, len(TETS))
    scene = Scene(X, TETS, [terms.Hyperelastic(law, growth=growth)])
    problem = DiscreteProblem(scene, Numbering(scene, 2), mixed=True)
    order, solids = problem.numbering, problem.solids
    forms = HyperelasticForms(solids._displacement, order.cell, law, DEGREES[2], growth, solids._pressure)
    assert solids.kernels
    ours, theirs = (Stiffness([order.cell_dofs], order.nodes) for _ in range(2))
    for seed in range(2):
        u, p = deformed(order, seed), 0.3 * KAPPA * np.random.default_rng(seed).normal(size=problem.pressures.count)
        state = solids.at(u, p)
        gradient, expected = np.zeros_like(order.X), np.zeros(order.X.size)
        state.add_gradient(gradient)
        forms.add_gradient(expected)
        energy = forms.assemble_energy()
        assert abs(state.energy() - energy) <= 1e-13 * np.abs(gradient).sum()
        assert_close(gradient.ravel(), expected, 1e-13)
        assert_close(state.stresses()[1][solids.points(forms.cells)], forms.point_stress(), 1e-13)
        assert_hessians_close(state, forms, order, solids.quadrature, (ours, theirs), exact=1e-12, projected=1e-12)


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


def test_every_operation_that_kernels_know():
    order, solids = solids_of(1, Branched())
    u = seam.function(order.space)
    forms = HyperelasticForms(u, np.arange(len(TETS)), Branched())
    assert solids.kernels
    for seed in range(3):
        u.x.array[:] = deformed(order, seed, size=0.1).ravel()
        state = solids.at(u.x.array.reshape(-1, 3), None)
        gradient, expected = np.zeros_like(order.X), np.zeros(order.X.size)
        state.add_gradient(gradient)
        forms.add_gradient(expected)
        ours, theirs = (Stiffness([order.cell_dofs], order.nodes) for _ in range(2))
        state.add_hessian(ours, 1.0)
        seam.add_matrix(forms.tangent, theirs.local)
        theirs.local.assemble()
        assert state.energy() == pytest.approx(forms.assemble_energy(), rel=1e-13)
        assert_close(gradient.ravel(), expected, 1e-12)
        assert_close(ours.values, theirs.values, 1e-11)


USE = """
from softdeca.reference import Scene, materials, terms
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.fenicsx.energy.solids import Solids
from softdeca.reference.problems import meshes
scene = Scene(*meshes.unstructured(1), [terms.Hyperelastic(materials.NeoHookean(1.0, 2.0))])
order = Numbering(scene)
print(Solids(scene, order, None).at(0.1 * order.X, None).energy())
"""


def test_two_processes_at_once_share_one_library(tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTDECA_CACHE", str(tmp_path))
    both = [subprocess.Popen([sys.executable, "-c", USE], stdout=subprocess.PIPE, text=True) for _ in range(2)]
    energies = [process.communicate(timeout=300)[0] for process in both]
    assert energies[0] == energies[1] and float(energies[0]) > 0.0
    assert [path.suffix for path in sorted(tmp_path.glob("kernels/*"))] == [".lock", ".so"]


IMPORT = "from softdeca.lhm.base.kernels import njit"
MODULES = {
    "sizes": "SIZE = 2.0",
    "inner": f"{IMPORT}\nfrom sizes import SIZE\n@njit()\ndef grow(x): return SIZE * x",
    "outer": f"{IMPORT}\nfrom inner import grow\n@njit(cache=True)\ndef use(x): return grow(x)",
}


@pytest.mark.parametrize(("changed", "source", "value"), [("sizes", "SIZE = 5.0", 15.0), ("inner", "{}+1.0", 7.0)])
def test_kernels_are_compiled_anew_where_a_source_of_theirs_has_changed(tmp_path, monkeypatch, changed, source, value):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    for name, text in MODULES.items():
        (tmp_path / f"{name}.py").write_text(text)
    ask = [sys.executable, "-c", "from outer import use; print(use(3.0), sum(use.stats.cache_hits.values()))"]
    both = [subprocess.Popen(ask, stdout=subprocess.PIPE, text=True) for _ in range(2)]  # one waits for the other
    answers = sorted(process.communicate(timeout=120)[0].split() for process in both)
    (tmp_path / f"{changed}.py").write_text(source.format(MODULES[changed]))
    answers.append(subprocess.check_output(ask, text=True).split())
    assert answers == [["6.0", "0"], ["6.0", "1"], [str(value), "0"]]
