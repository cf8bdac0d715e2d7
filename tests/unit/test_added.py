"""Laws, solvers and studies of files of one's own, by those of the tutorials."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks import studies
from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.verification import Hard, Verification
from softdeca.lhm import InputError
from softdeca.reference import (
    NotModelledError,
    Scene,
    SceneError,
    add_file,
    add_law,
    added,
    materials,
    prepare,
    problems,
    solve,
    terms,
)
from softdeca.reference import add_solver as add
from softdeca.reference.skfem.solids import ByInvariants

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
LAW, SOLVER = TUTORIALS / "gent.py", TUTORIALS / "quasi_newton.py"
MAIN = "from softdeca.cli import main; main()"
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.fixture(autouse=True)
def nothing_added(monkeypatch):
    for name in ("_files", "_laws", "_solvers"):
        monkeypatch.setattr(added, name, {})
    monkeypatch.setattr(studies, "_added", {})


def scene(*more):
    return Scene(CORNERS, [[0, 1, 2, 3]], [*more, terms.Fixed([0, 1, 2])])


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_the_law_of_a_file_is_right_by_both_solvers(solver):
    pytest.importorskip("dolfinx" if solver == "fenicsx" else "skfem")
    add_file(LAW)
    posed = [problem for problem in problems.added_problems() if "stretch 2" in problem.name or "0.36" in problem.name]
    assert len(posed) == 2
    for problem in posed:
        outcome = problems.run(problem, solver)
        assert outcome.passed and outcome.error < 1e-10


def test_the_derivatives_of_the_law_are_those_of_its_energy():
    add_file(LAW)
    law = ByInvariants(added.added_laws()["Gent"].of_moduli(1.0, 9.0))
    rng = np.random.default_rng(0)
    F, h = np.eye(3) + 0.2 * rng.standard_normal((4, 3, 3)), 1e-6
    P, dP = law.stress(F), law.tangent(F)
    for i, j in np.ndindex(3, 3):
        step = h * np.eye(9)[3 * i + j].reshape(3, 3)
        assert P[:, i, j] == pytest.approx((law.psi(F + step) - law.psi(F - step)) / (2 * h), abs=1e-7)
        assert dP[..., i, j] == pytest.approx((law.stress(F + step) - law.stress(F - step)) / (2 * h), abs=1e-5)
    assert np.isinf(law.psi(np.stack([8 * np.eye(3), -np.eye(3)]))).all()


def test_projective_dynamics_and_mixed_elements_refuse_the_law_by_name():
    pytest.importorskip("dolfinx")
    add_file(LAW)
    law = terms.Hyperelastic(added.added_laws()["Gent"].of_moduli(1.0, 9.0))
    with pytest.raises(SceneError, match="cannot model Hyperelastic"):
        prepare(scene(law))
    with pytest.raises(SceneError, match="cannot model Gent by a pressure"):
        prepare(scene(law), solver="fenicsx", element="P2P1")


def test_a_solver_of_a_file_agrees_with_the_others():
    add_file(SOLVER)
    law, pull = materials.NeoHookean(1.0, 9.0), terms.Gravity((0, 0, -1.0), density=0.5)
    pulled = scene(terms.Hyperelastic(law), pull)
    ours = solve(pulled, solver="quasi-newton", tolerance=1e-10)
    theirs = solve(pulled, solver="skfem", tolerance=1e-10)
    assert ours.converged and ours.positions == pytest.approx(theirs.positions, abs=1e-9)
    assert np.abs(ours.positions - CORNERS).max() > 1e-3
    with pytest.raises(NotModelledError, match="'quasi-newton' cannot model Volume"):
        prepare(scene(terms.Volume(1.0)), solver="quasi-newton")
    with pytest.raises(SceneError, match="unknown solver 'quasi'; there are projective, fenicsx, skfem, quasi-newton"):
        prepare(pulled, solver="quasi")


def test_studies_have_what_files_add(tmp_path):
    """Children of a study add the files too; what a solver cannot model is left out with its reason."""
    pytest.importorskip("dolfinx")
    add_file(LAW)
    add_file(SOLVER)
    found = run(
        Verification(solvers=("quasi-newton", "skfem")), tmp_path / "a", match="nu=.45, uniaxial, stretch 2", workers=1
    )
    ended = {(row.case.split()[0], row.method): row.status for row in found.rows}
    assert found.passed and ended == {
        ("NeoHookean", "quasi-newton"): "done",
        ("NeoHookean", "skfem"): "done",
        ("StableNeoHookean", "quasi-newton"): "skipped",
        ("StableNeoHookean", "skfem"): "done",
        ("Corotated", "quasi-newton"): "skipped",
        ("Corotated", "skfem"): "done",
        ("Gent", "quasi-newton"): "skipped",
        ("Gent", "skfem"): "done",
    }
    assert next(row for row in found.rows if row.status == "skipped").reason.startswith("solver 'quasi-newton' cannot")
    hard = run(Hard(), tmp_path / "b", match="mirrored, Gent", workers=1)
    assert hard.passed and {row.values["outcome"] for row in hard.rows} == {"NOT_FINITE"}
    assert any(method == "quasi-newton P1" for _, method in ((t.case, t.method) for t in Hard().tasks()))


def test_a_study_of_a_file(tmp_path, command):
    file = tmp_path / "doubling.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from softdeca.benchmarks.harness import Column, Study, Task\n"
        "from softdeca.benchmarks.studies import add_study\n"
        "@add_study\n"
        "@dataclass(frozen=True)\n"
        "class Doubling(Study):\n"
        "    name, question, columns = 'doubling', 'How much is twice as much?', (Column('twice', 'twice'),)\n"
        "    number: int = 3\n"
        "    def tasks(self):\n"
        "        return [Task('a number', 'by two')]\n"
        "    def measure(self, task):\n"
        "        return {'twice': 2 * self.number}\n"
    )
    ended = command("bench", "--add", file, "doubling", "--number", "4", "--out", tmp_path / "out")
    assert ended.status == 0 and "a number, by two: twice 8" in ended.out
    assert "How much is twice as much?" in command("bench", "--add", file, "list").out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("sys.stdout.close()", "closes stdout"),
        ("sys.stderr.close()", "closes stderr"),
        ("sys.stdout.close(); sys.stderr.close()", "closes stdout and stderr"),
        ("os.close(1); os.close(2)", ""),
        ("sys.stdout = sys.stderr = None", ""),
        ("os.fork()", ""),
        ("os.fork() or os._exit(3)", ""),
        ("os.fork() or sys.exit(3)", ""),
    ],
)
def test_a_file_neither_closes_streams_nor_goes_on_twice(tmp_path, words, said):
    (tmp_path / "mine.py").write_text(f"import os, sys\n{words}\n")
    arguments = [sys.executable, "-c", MAIN, "bench", "--add", tmp_path / "mine.py", "list"]
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    if said:
        assert ended.returncode == 1 and ended.stdout == ""
        assert ended.stderr == f"softdeca: error: {tmp_path / 'mine.py'}: InputError: it {said}\n"
    else:
        assert ended.returncode == 0 and ended.stderr == ""
        assert ended.stdout.count("verification") == 1


def test_what_files_may_not_add(tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text("1 / 0\n")
    ends = tmp_path / "ends.py"
    for words in ("raise SystemExit(0)", "quit()", "import os; os._exit(0)", "raise BaseException('any')"):
        ends.write_text(words + "\n")
        with pytest.raises(InputError, match=r"ends.py: "):
            add_file(ends)
    assert not added.added_files()
    other = tmp_path / "gent.py"
    other.write_text("")
    with pytest.raises(InputError, match=r"broken.py: ZeroDivisionError"):
        add_file(broken)
    with pytest.raises(InputError, match="there is no such Python file"):
        add_file(tmp_path / "none.py")
    add_file(LAW)
    add_file(LAW)
    with pytest.raises(InputError, match="a file of this name was added already"):
        add_file(other)
    assert added.added_files() == (LAW,)
    gent = added.added_laws()["Gent"].of_moduli
    with pytest.raises(InputError, match="law 'Gent' was added already"):
        add_law("Gent", gent)
    with pytest.raises(InputError, match="expected an EnergyLaw, got Corotated"):
        add_law("mine", materials.Corotated)
    with pytest.raises(InputError, match="of moduli 1 and 9 kPa it has"):
        add_law("mine", lambda mu, lmbda: gent(2 * mu, lmbda))
    for name in ("skfem", "mine"):
        with pytest.raises(InputError, match="is there already"):
            add("mine", prepare)
            add(name, prepare)
