"""The arena: a solver's file from the page alone, rows of solvers that fail, refuse or are absent."""

import json
import textwrap
from dataclasses import replace

import numpy as np
import pytest

from softdeca.benchmarks.harness.study import Row
from softdeca.benchmarks.studies.arena import problems, runs
from softdeca.benchmarks.studies.arena.entrants import list_entrants, load_file
from softdeca.benchmarks.studies.arena.laws import LAWS, PlainStable
from softdeca.benchmarks.studies.arena.solvers import NAMES
from softdeca.benchmarks.studies.arena.solvers.protocol import RefusalError
from softdeca.benchmarks.studies.arena.study import CLOCK, Arena
from softdeca.benchmarks.studies.person import person
from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.reference import Parameters, facial_scene, solve, terms
from softdeca.reference.added import NotModelledError
from softdeca.reference.face.tissue import Guard
from softdeca.reference.problems.meshes import block, vertices_at
from softdeca.surrogate.methods import METHODS

pytestmark = pytest.mark.usefixtures("measured_here")

HEAD = """
TITLE, PACKAGES, LAW, DTYPE, TOLERANCE = {title!r}, {packages!r}, "neo-Hookean", "float64", 1.0
SETTINGS = {{"default": {{}}}}

def run(problem, settings, clock):
    clock.end("set-up")
"""


@pytest.fixture
def solver(tmp_path):
    """Write a solver's file of a body of `run`."""

    def write(title, body, packages=("numpy",)):
        path = tmp_path / f"{title}.py"
        path.write_text(HEAD.format(title=title, packages=packages) + textwrap.indent(textwrap.dedent(body), "    "))
        return str(path)

    return write


@pytest.fixture
def small(monkeypatch):
    """Leave one small problem: a block whose top is moved up by a millimetre."""

    def make():
        X, tets = block(3, 10.0)
        held = np.concatenate([vertices_at(X, 2, 0.0), vertices_at(X, 2, 10.0)])
        places = X[held] + np.where(X[held, 2:] > 5.0, [[0.0, 0.0, 1.0]], 0.0)
        full = np.ones(len(tets))
        return problems.Problem(X, tets, held, places, [], 5.0 * full, 20.0 * full, np.arange(len(X)))

    case = problems.Case("small block", make, start_at_answer=True, quadratic=True)
    monkeypatch.setattr(problems, "CASES", {case.name: case})
    problems.make.cache_clear()
    yield case.name
    problems.make.cache_clear()


@pytest.mark.parametrize("name", [name for name in NAMES if np.isfinite(load_file(name).TOLERANCE)])
def test_each_solver_ends_at_the_answer_of_the_bar(name):
    """Each entrant is run by its best setting."""
    bar, entrants = problems.make("bar"), [each for each in list_entrants() if each.file == name]
    ends = []
    for entrant in entrants:
        answers = [problems.answer(bar, entrant.law)]
        try:
            values = runs.run(entrant, bar, entrant.law, answers, 1.0, bar.vertices)
        except MissingDependencyError:
            pytest.skip("not installed: docs/arena.md")
        # A clock that ticks would call a set-up of milliseconds none.
        assert 0.0 < values["clock_s"] < CLOCK and values["warm_up_s"] > 0.0 and values["set_up_s"] > 0.0
        ends.append(values["max_mm"])
    assert min(end for end in ends if end is not None) <= entrants[0].tolerance


def test_failures_are_rows(small, solver, monkeypatch):
    study = Arena()
    files = {
        "raises": solver("raises", "raise RuntimeError('no')"),
        "infinite": solver("infinite", "clock.see(problem.vertices * float('nan'), 1)"),
        "dies": solver("dies", "import os\nos._exit(3)"),
        "refuses": solver("refuses", "problem.refuse('it takes no block')"),
        "absent": solver("absent", "", ("no-such-package==1",)),
        "endless": solver("endless", "while clock.see(problem.vertices, 1) or len(problem.tets) > 48: pass"),
    }
    monkeypatch.setattr(runs, "GRACE", 0.5)
    study = Arena(files=tuple(files.values()), budget=0.2)

    def measure(title):
        (task,) = [task for task in study.tasks() if task.method == f"{title}; default; from rest"]
        return study.measure(task)

    assert measure("raises")["ended"] == "RuntimeError: no"
    assert measure("infinite")["ended"] == "positions are not finite"
    assert measure("dies")["ended"].startswith("its process ended with 3")
    assert measure("endless")["ended"].startswith("no end of its solve in") and measure("endless")["max_mm"] > 0.9
    with pytest.raises(NotModelledError, match="it takes no block"):
        measure("refuses")
    with pytest.raises(MissingDependencyError, match="pip install no-such-package==1"):
        measure("absent")


def test_our_solvers_meet_fenicsx_and_the_study_writes_its_page(small, tmp_path, monkeypatch):
    monkeypatch.setattr("softdeca.benchmarks.studies.arena.entrants.NAMES", ())
    study = Arena(whole=True, budget=5.0)
    rows = [Row(task.case, task.method, "done", "", study.measure(task), 0.0, None, 0.0, "") for task in study.tasks()]
    of_faces = {name for name, method in METHODS.items() if method.solver is not None}
    assert {row.values["solver"] for row in rows} == of_faces - {"PD, tets", "FEniCSx, tets"}
    assert max(row.values["max_mm"] for row in rows) < 1e-5
    away = {row.values["solver"]: row.values["element_mm"] for row in rows if "element_mm" in row.values}
    assert away.keys() == {"FEniCSx, P2", "FEniCSx, P2-P1", "scikit-fem, P2"} and all(
        0.01 < each < 0.5 for each in away.values()
    )
    json.dumps([row.values for row in rows], allow_nan=False)
    assert "small block" in study.words(rows) and [gate["passed"] for gate in study.gates(rows)] == [True]
    tables = study.tables(rows)
    assert len(tables[0].rows) == len(rows)
    assert all("<svg" in picture for picture in study.pictures(rows).values())
    energies = {claim: energy for claim, _, energy, _ in tables[-1].rows}
    assert energies["L-BFGS over that factor is faster than Newton."] == "projective dynamics"
    (apart,) = (energy for energy in energies.values() if "," in energy)
    assert apart == "each its own: projective dynamics, neo-Hookean"


def test_the_bar_has_its_closed_form():
    bar = problems.make("bar")
    for law in ("neo-Hookean", "St. Venant-Kirchhoff"):
        assert problems.answer(bar, law) == pytest.approx(bar.closed(law), abs=1e-8)
    assert bar.closed("stable neo-Hookean") is None


def test_a_posed_face_is_the_face_of_the_simulator():
    face, of = problems.face(1), person(seed=None, level=1)
    targets = of.shape(problems.EXPRESSION)
    scene = facial_scene(of.head, Parameters(muscle_strain_ratio=1.0), targets, bones="prescribed", cells="tets")
    guards = {id(term) for term in scene.of(terms.Strain) if isinstance(term, Guard)}
    scene = replace(scene, terms=tuple(term for term in scene.terms if id(term) not in guards))
    end = solve(scene, tolerance=1e-9).positions
    assert np.abs(end - scene.vertices).max() > 5.0
    assert solve(face.scene("projective dynamics"), tolerance=1e-9).positions == pytest.approx(end, abs=1e-3)
    arrays = face.arrays()
    assert arrays.springs[face.skin].min() > 0.0 and arrays.springs.sum() == pytest.approx(
        arrays.springs[face.skin].sum()
    )
    with pytest.raises(RefusalError, match="it takes no springs and no membrane"):
        arrays.check_taken(())
    with pytest.raises(RefusalError, match="it takes no membrane"):
        arrays.check_taken(("springs",))
    problems.face(1, membrane=False).arrays().check_taken(("springs",))
    assert arrays.one_material() == pytest.approx((2.5, 22.5))


def test_laws_are_alike_at_rest():
    # A thousandth of the twist moves the cube by laws whose moduli are the same.
    cube = problems.cube(0.45)
    small = cube.vertices[cube.held] + 1e-3 * (cube.places - cube.vertices[cube.held])
    cube = problems.Problem(cube.vertices, cube.tets, cube.held, small, [], cube.mu, cube.lmbda, cube.skin)
    ends = {
        law: solve(cube.scene(law), solver="fenicsx", tolerance=1e-10).positions
        for law in LAWS
        if law != "as rigid as possible"
    }
    for law, end in ends.items():
        assert end == pytest.approx(ends["neo-Hookean"], abs=2e-4), law


def test_the_plain_stable_law_is_at_rest_at_rest():
    law = PlainStable(2.0, 7.0)
    rest = np.array([[3.0], [3.0], [1.0]])
    (by_I1,), _, (by_J,) = law.slopes(rest)
    # The stress at rest is 2 dpsi/dI1 + dpsi/dJ.
    assert law.energy(rest) == pytest.approx(0.0) and 2 * by_I1 + by_J == pytest.approx(0.0)
