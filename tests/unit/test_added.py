"""Laws, solvers and studies of files of one's own, by those of the tutorials."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks import studies
from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.agreement.material import Material
from softdeca.benchmarks.studies.agreement.study import Agreement
from softdeca.benchmarks.studies.verification import Hard, Verification
from softdeca.lhm import InputError
from softdeca.reference import (
    Scene,
    add_file,
    add_law,
    added,
    materials,
    problems,
    solve,
    terms,
)
from softdeca.reference.materials.material import LameLaw, MixedLaw
from softdeca.surrogate import Surrogate, methods

pytestmark = pytest.mark.usefixtures("measured_here")

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
LAW, SOLVER = TUTORIALS / "gent.py", TUTORIALS / "quasi_newton.py"
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.fixture(autouse=True)
def nothing_added(monkeypatch):
    for name in ("_files", "_laws", "_solvers"):
        monkeypatch.setattr(added, name, {})
    monkeypatch.setattr(studies, "_added", {})
    monkeypatch.setattr(methods, "_added", {})


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


def test_a_law_of_a_file_stands_beside_the_others_on_a_face_and_on_a_cube():
    with pytest.raises(InputError, match="unknown law 'Gent'"):
        Agreement(laws=("Gent",)).tasks()
    add_file(LAW)
    truths = Agreement(laws=("Gent",)).list_truths("jawOpen")
    assert [truth.name for truth in truths][2:] == [methods.FENICSX_NEO_HOOKEAN, "FEniCSx, Gent"]
    beside = Material().measure(next(task for task in Material().tasks() if task.method == "Gent"))
    assert beside["tiny"] < 5.0 < beside["large"]


def test_a_solver_of_a_file_agrees_with_the_others():
    add_file(SOLVER)
    law, pull = materials.NeoHookean(1.0, 9.0), terms.Gravity((0, 0, -1.0), density=0.5)
    pulled = scene(terms.Hyperelastic(law), pull)
    ours = solve(pulled, solver="quasi-newton", tolerance=1e-10)
    theirs = solve(pulled, solver="skfem", tolerance=1e-10)
    assert ours.converged and ours.positions == pytest.approx(theirs.positions, abs=1e-9)
    assert np.abs(ours.positions - CORNERS).max() > 1e-3


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
    assert any(method == "quasi-newton P1" for _, method in ((t.case, t.method) for t in Hard().tasks()))


def test_a_study_of_a_file(tmp_path, command):
    file = tmp_path / "doubling.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from softdeca.benchmarks.harness import Column, Study, Task\n"
        "from softdeca.lhm.base.option import option\n"
        "from softdeca.benchmarks.studies import add_study\n"
        "@add_study\n"
        "@dataclass(frozen=True)\n"
        "class Doubling(Study):\n"
        "    name, question, columns = 'doubling', 'How much is twice as much?', (Column('twice', 'twice'),)\n"
        "    number: int = option(3, 'what is doubled')\n"
        "    def tasks(self):\n"
        "        return [Task('a number', 'by two')]\n"
        "    def measure(self, task):\n"
        "        return {'twice': 2 * self.number}\n"
    )
    ended = command("bench", "--add", file, "doubling", "--number", "4", "--out", tmp_path / "out")
    assert ended.status == 0 and "a number, by two: twice 8" in ended.out
    assert "How much is twice as much?" in command("bench", "--add", file, "list").out


@dataclass(frozen=True)
class Own(LameLaw, MixedLaw):
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 (J - 1)², and what a test makes wrong of it."""

    def density(self, I1, I2, J, p, m):
        return p.mu / 2 * (I1 - 3) - p.mu * m.log(J) + p.lmbda / 2 * (J - 1) ** 2

    def mixed_density(self, I1, I2, J, pressure, p, m):
        return p.mu / 2 * (I1 - 3) - p.mu * m.log(J) + pressure * (J - 1) - pressure**2 / (2 * p.lmbda)


def own(**wrong):
    """Own with members that are others, as a function of its moduli."""
    return dataclass(frozen=True)(type("Own", (Own,), wrong))


def density(change):
    """Own with a change of psi, of psi, I1, J and m."""
    return own(density=lambda self, I1, I2, J, p, m: change(Own.density(self, I1, I2, J, p, m), I1, J, m))


WRONG = {
    "no derivative": (density(lambda psi, I1, J, m: psi + abs(J - 1) ** 3), r"dpsi/ds. at F = diag\(.*\): expected"),
    "energy twice": (
        density(lambda psi, I1, J, m: 2 * psi),
        "mu and lmbda at rest: expected 1 and 9 kPa, by `lame`, got 2 and 18",
    ),
    "stressed at rest": (
        density(lambda psi, I1, J, m: psi + 0.1 * (J - 1)),
        "its stress is 0.1 kPa at rest, expected 0",
    ),
    "mixed": (
        own(mixed_density=lambda self, *args: Own.mixed_density(self, *args) - args[3] ** 2 / 9),
        "mixed_density, greatest at a pressure of .* kPa, at F = ",
    ),
    "square of mu": (lambda mu, lmbda: Own(mu**2, lmbda), r"of moduli \(0.4, 3.1\) kPa it has"),
}


def test_a_law_that_is_an_energy_is_added():
    add_law("own", Own)
    assert added.added_laws()["own"].of_moduli is Own


@pytest.mark.parametrize("wrong", WRONG)
def test_a_law_that_is_no_energy_of_its_moduli_is_refused_with_the_figures(wrong):
    of_moduli, message = WRONG[wrong]
    with pytest.raises(InputError, match=message) as refused:
        add_law("own", of_moduli)
    assert "\n" not in str(refused.value) and not added.added_laws()


def test_what_files_may_not_add(tmp_path):
    ends = tmp_path / "ends.py"
    for words in ("raise SystemExit(0)", "quit()", "raise BaseException('any')", "1 / 0"):
        ends.write_text(words + "\n")
        with pytest.raises(InputError, match=r"ends.py: "):
            add_file(ends)
    add_file(LAW)
    add_file(LAW)
    assert added.added_files() == (LAW,)


def test_a_method_of_a_file_is_scored_beside_the_others(tmp_path):
    """The page's own file."""
    page = (TUTORIALS.parent / "extend.md").read_text().partition("## A method\n")[2]
    file = tmp_path / "half.py"
    file.write_text(page.partition("```{code-block} python\n")[2].partition("```")[0])
    add_file(file)
    ready = methods.ready_methods(Surrogate.load())
    assert list(ready) == [*methods.READY, "half settled"] and ready["half settled"].needs == "simulator"
