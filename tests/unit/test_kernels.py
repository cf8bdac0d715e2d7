"""Kernels of laws with a pressure against FEniCSx' own assembly of UFL's forms, and how all are compiled and kept."""

import subprocess
import sys

import numpy as np
import pytest
from mpi4py import MPI
from scipy.linalg import expm
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

import ufl

from softdeca.reference import Scene, materials, terms
from softdeca.reference.fenicsx import dolfinx_version as seam
from softdeca.reference.fenicsx.energy.assembly import Stiffness
from softdeca.reference.fenicsx.energy.quadrature import DEGREES
from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.problems import meshes

from .ufl_forms import HyperelasticForms, assemble_tangent

MU, KAPPA = 1.0, 5.0 + 2.0 / 3.0
X, TETS = meshes.unstructured(2)
LAWS = {
    "neo-Hookean": materials.NeoHookean(MU, 5.0),
    "Mooney-Rivlin": materials.MooneyRivlin(0.3, 0.2, KAPPA, C20=0.4),
    "incompressible": materials.Incompressible(materials.IsochoricNeoHookean(MU, KAPPA)),
}


def deformed(order, seed):
    """A large displacement by node: a linear map that inverts nothing, and noise of a fiftieth of a tet's size."""
    rng = np.random.default_rng(seed)
    noise = 0.02 * np.cbrt(order.cell_volumes.min()) * rng.normal(size=order.X.shape)
    return order.X @ (expm(0.4 * rng.normal(size=(3, 3))) - np.eye(3)) + noise


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


@pytest.mark.parametrize("name", LAWS)
def test_kernels_of_laws_with_a_pressure_are_the_forms_of_ufl(name):
    law, growth = LAWS[name], np.random.default_rng(1).uniform(0.8, 1.2, len(TETS))
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


def test_what_a_killed_process_left_of_a_form_is_compiled_anew(tmp_path, monkeypatch):
    monkeypatch.setitem(seam._DEFAULTS, "cache_dir", (tmp_path, ""))
    domain = seam.tet_mesh(X, TETS, MPI.COMM_SELF)

    def volume():
        return seam.fem.assemble_scalar(seam.compile_form(1.0 * ufl.dx(domain)))

    before = volume()
    for ready in tmp_path.glob("*.c.cached"):
        ready.unlink()
    assert volume() == before == pytest.approx(1.0)
    assert [*tmp_path.glob("*.c.cached")]
