"""Several processes by mpirun: the serial answer, one error, one end. The shares of a problem sum to the whole."""

import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.ranks import PHASES, SETTINGS, RanksConfig, compare, without_notices
from softdeca.lhm.errors import InputError, MissingDependencyError
from softdeca.reference import Parameters, Scene, facial_scene, march, ranks, solve
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.fenicsx.shares import Share, small_scene
from softdeca.reference.materials import Guccione, NeoHookean, StableNeoHookean
from softdeca.reference.problems import stretched_bars
from softdeca.reference.problems.meshes import box, triangles_at, vertices_at
from softdeca.reference.terms import Fixed, Hyperelastic, Pressure, Strain, SurfaceStrain, Target, Traction, Volume

needs_mpirun = pytest.mark.skipif(shutil.which("mpirun") is None, reason="mpirun is not installed")
ENVIRONMENT = {
    **os.environ,
    **SETTINGS,
    "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
}
TIGHT = 1e-12


def stretched(cells, *solids):
    """A box whose lower end is held and whose upper end is pulled and sheared."""
    X, tets = box(cells)
    low, high = vertices_at(X, 2, 0.0), vertices_at(X, 2, 1.0)
    return Scene(X, tets, (*solids, Fixed(low), Fixed(high, X[high] + [0.1, 0.05, 0.2])))


def pulled_far(cells):
    """A bar to five times its length: by load steps, as elements beside its held end snap."""
    X, tets = box(cells, (6.0, 1.0, 1.0))
    stress = stretched_bars.neo_hookean(5.0)[1]
    pull = Traction(triangles_at(X, tets, 0, 6.0), stress * np.eye(3)[0])
    law = NeoHookean.from_young(stretched_bars.YOUNG, stretched_bars.POISSON)
    return Scene(X, tets, (Hyperelastic(law), Fixed(vertices_at(X, 0, 0.0)), pull))


def drawn(head):
    """A head whose skin is drawn forward at the cheeks, its mandible free."""
    skin = head.skin.vertices
    bump = np.exp(-((skin[:, 1] / 40.0) ** 2))[:, None] * [0.0, 0.0, 6.0]
    return facial_scene(head, Parameters(), skin + bump)


def by_tet(count, low, high):
    return np.random.default_rng(3).uniform(low, high, count)


@pytest.fixture(scope="module")
def cases(sphere_head):
    """Scenes with options: every law's way, both elements and solvers, and what one process does for all."""
    small, large = (5, 5, 5), (10, 10, 10)
    m, big = len(box(small)[1]), len(box(large)[1])
    fibres = np.random.default_rng(4).normal(size=(m, 3))
    neo = Hyperelastic(NeoHookean.from_young(10.0, 0.4))
    plain = stretched(large, neo)
    outside = triangles_at(plain.vertices, plain.tets, 0, 1.0)
    pulled = vertices_at(plain.vertices, 0, 1.0)
    few = np.arange(40)
    return {
        "neo-Hookean": (plain, {}),
        "neo-Hookean, MUMPS": (plain, {"linear_solver": "mumps"}),
        "by tet": (stretched(large, Strain(by_tet(big, 4.0, 8.0), 1.05), Volume(9.0, by_tet(big, 0.9, 1.1))), {}),
        "quadratic": (stretched(small, Hyperelastic(StableNeoHookean.from_young(10.0, 0.4))), {"element": "P2"}),
        "fibres": (stretched(small, Hyperelastic(Guccione(2.0, 3.0, 1.0, 2.0, fibres, 20.0))), {}),
        "a law on few tets": (stretched(small, neo, Strain(5.0, tets=few)), {}),
        "skin and springs": (
            replace(
                plain, terms=(*plain.terms, SurfaceStrain(outside, 3.0), Target(pulled[:9], outside[:9] * 0.0, 2.0))
            ),
            {},
        ),
        "pressure": (replace(plain, terms=(*plain.terms, Pressure(outside, 0.2))), {}),
        "with a pressure": (stretched(small, neo), {"element": "P2P1"}),
        "load steps": (pulled_far((12, 2, 2)), {}),
        "head": (drawn(sphere_head), {}),
    }


def run_together(tmp_path, script, *arguments, count=2, timeout=120):
    """Run a script in processes that mpirun starts; what it has printed."""
    file = tmp_path / "script.py"
    file.write_text(script)
    command = ["mpirun", "-n", str(count), sys.executable, str(file), *map(str, arguments)]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=timeout, cwd=tmp_path)


SOLVE = """
import pickle, sys
from softdeca.reference import ranks, solve
team = ranks.join()
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.fenicsx.shares import SharedProblem
from softdeca.reference.fenicsx.shared_linear import SpreadSolver
shared = []
for kind, method in ((SharedProblem, "at"), (SpreadSolver, "solve")):
    def seen(self, *arguments, _inner=getattr(kind, method), _name=kind.__name__, **more):
        shared.append(_name)
        return _inner(self, *arguments, **more)
    setattr(kind, method, seen)
answers = {}
for name, (scene, options) in pickle.load(open(sys.argv[1], "rb")).items():
    shared.clear()
    solution = solve(scene, solver="fenicsx", tolerance=1e-12, **options)
    answers[name] = (solution.positions, solution.energy, set(shared))
pickle.dump(answers, open(sys.argv[2], "wb"))
print("done by", team.size)
"""


@pytest.fixture(scope="module")
def answers(cases, tmp_path_factory):
    """Positions, energy, and what was shared, of every case by two processes."""
    folder = tmp_path_factory.mktemp("together")
    (folder / "cases").write_bytes(pickle.dumps(cases))
    done = run_together(folder, SOLVE, folder / "cases", folder / "answers", timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "done by 2\n"
    return pickle.loads((folder / "answers").read_bytes())


NAMES = (
    "neo-Hookean",
    "neo-Hookean, MUMPS",
    "by tet",
    "quadratic",
    "fibres",
    "a law on few tets",
    "skin and springs",
    "pressure",
    "with a pressure",
    "load steps",
    "head",
)


@needs_mpirun
@pytest.mark.parametrize("name", NAMES)
def test_two_processes_give_the_serial_answer(name, cases, answers):
    scene, options = cases[name]
    alone = solve(scene, solver="fenicsx", tolerance=TIGHT, **options)
    positions, energy, _ = answers[name]
    largest = np.linalg.norm(alone.positions - scene.vertices, axis=1).max()
    assert largest > 0.05
    assert np.abs(positions - alone.positions).max() <= 1e-10 * largest
    assert energy == pytest.approx(alone.energy, rel=1e-12)


@needs_mpirun
def test_tets_and_rows_are_shared_but_for_a_mixed_element(answers):
    both = {"SharedProblem", "SpreadSolver"}
    assert all(answers[name][2] == both for name in ("neo-Hookean", "neo-Hookean, MUMPS", "by tet", "quadratic"))
    assert "SharedProblem" in answers["head"][2] and "SharedProblem" in answers["pressure"][2]
    assert answers["with a pressure"][2] == set()


@pytest.mark.parametrize("degree", [1, 2])
def test_energies_and_gradients_of_shares_sum_to_the_whole(degree):
    m = len(box((3, 3, 3))[1])
    solids = Strain(by_tet(m, 4.0, 8.0), 1.05), Hyperelastic(NeoHookean.from_young(10.0, 0.4), np.arange(0, m, 2))
    scene = stretched((3, 3, 3), *solids)
    order = Numbering(scene, degree)
    u = np.random.default_rng(1).normal(0.0, 0.01, order.X.shape)
    whole = Problem(scene, order).at(u)
    energy, gradient = 0.0, np.zeros_like(u)
    for tets in np.array_split(np.arange(m), 3):
        part, vertices = small_scene(scene, tets)
        share = Share(part, degree)
        nodes = order.nodes_between(vertices[share.pattern()[0]])
        energy += share.energy(1, u[nodes])
        gradient[nodes] += share.gradient(1, u[nodes])
    assert energy == pytest.approx(whole.energy, rel=1e-12)
    assert np.abs(gradient - whole.gradient()).max() <= 1e-12 * np.abs(gradient).max()


def test_a_share_goes_back_to_an_earlier_state():
    X, tets = box((1, 1, 1))
    share = Share(Scene(X, tets, (Hyperelastic(NeoHookean.from_young(10.0, 0.4)),)), 1)
    rest, moved = np.zeros((8, 3)), np.random.default_rng(1).normal(0.0, 0.05, (8, 3))
    share.energy(1, moved)
    there = share.hessian(1, moved, None).copy()
    share.energy(2, rest)
    at_rest = share.hessian(2, rest, None).copy()
    assert not np.allclose(there, at_rest)
    assert np.array_equal(share.hessian(1, moved, None), there)


MARCH = """
import pickle, sys
from softdeca.reference import march, ranks
ranks.join()
scene, options = pickle.load(open(sys.argv[1], "rb"))
pickle.dump(march(scene, **options).positions, open(sys.argv[2], "wb"))
"""


@needs_mpirun
def test_a_march_by_three_processes_is_the_serial_one(tmp_path):
    X, tets = box((4, 4, 4))
    solid = Hyperelastic(NeoHookean.from_young(10.0, 0.4))
    scene = Scene(X, tets, (solid, Fixed(vertices_at(X, 2, 0.0))))
    push = np.zeros_like(X)
    push[:, 0] = 2.0 * X[:, 2]
    options = {"density": 1e-6, "time_step": 1e-3, "steps": 5, "velocities": push}
    (tmp_path / "in").write_bytes(pickle.dumps((scene, options)))
    done = run_together(tmp_path, MARCH, tmp_path / "in", tmp_path / "out", count=3)
    assert done.returncode == 0, done.stderr
    together, alone = pickle.loads((tmp_path / "out").read_bytes()), march(scene, **options).positions
    assert np.abs(together - alone).max() <= 1e-10 * np.abs(alone - X).max()


FAILING = """
import os, sys
from softdeca.lhm.errors import SceneError
from softdeca.reference import ranks

class Part:
    def fail(self):
        raise SceneError("the part is broken")
    def die(self):
        os.kill(os.getpid(), 9)
    def answer(self, x):
        return x * x
"""
USING = """
import os, sys, time
from softdeca.reference import ranks
team = ranks.join()
from part import Part
remote = team.make(Part, [()] * (team.size - 1))
def sleep():
    print("ready", flush=True)
    time.sleep(60)
try:
    if sys.argv[1] == "raise":
        try:
            remote.call("fail", [()] * (team.size - 1))
        except Exception as error:
            print(type(error).__name__, error, remote.call("answer", [(k,) for k in range(1, team.size)]))
            sys.exit(3)
    if sys.argv[1] == "together":
        with remote.together("fail", [()] * (team.size - 1)):
            team.comm.recv(source=1, tag=99)
    if sys.argv[1] == "die":
        remote.call("die", [()] * (team.size - 1))
    if sys.argv[1] == "first alone":
        with remote.together("answer", [(k,) for k in range(1, team.size)]):
            raise SystemExit(4)
    if sys.argv[1] == "sleep":
        sleep()
except KeyboardInterrupt:
    open("interrupted", "w").close()
    sys.exit(130)
"""


@needs_mpirun
@pytest.mark.parametrize(
    ("how", "status", "said", "error"),
    [
        ("raise", 3, "SceneError the part is broken [1, 4]", ""),
        ("together", 1, "", "softdeca: error: the part is broken"),
        ("first alone", 1, "", ""),
        ("die", 137, "", ""),
    ],
)
def test_what_fails_in_one_process_ends_all(how, status, said, error, tmp_path):
    (tmp_path / "part.py").write_text(FAILING)
    done = run_together(tmp_path, USING, how, count=3, timeout=60)
    assert done.returncode == status
    assert done.stdout.strip() == said
    assert error in done.stderr and "Traceback" not in done.stderr


FIRST_ALONE = """
from mpi4py import MPI
from softdeca.reference import Scene, solve, terms
corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
scene = Scene(corners, [[0, 1, 2, 3]], [terms.Strain(1.0), terms.Fixed([0, 1, 2]), terms.Gravity((0, 0, -1), 1.0)])
if MPI.COMM_WORLD.rank == 0:
    print(solve(scene, solver="fenicsx").converged)
MPI.COMM_WORLD.Barrier()
"""


@needs_mpirun
def test_a_script_whose_first_process_alone_solves_goes_on(tmp_path):
    """PETSc of all processes waited for those at the barrier, in silence."""
    done = run_together(tmp_path, FIRST_ALONE, count=2, timeout=60)
    assert done.returncode == 0 and done.stdout == "True\n"


@needs_mpirun
def test_an_interruption_reaches_the_first_process_and_ends_all(tmp_path):
    (tmp_path / "part.py").write_text(FAILING)
    (tmp_path / "script.py").write_text(USING)
    command = ["mpirun", "-n", "2", sys.executable, "script.py", "sleep"]
    with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as run:
        assert run.stdout.readline() == "ready\n"
        begin = time.monotonic()
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=30)
    assert (tmp_path / "interrupted").exists()  # printed, it would not come through Open MPI 5
    assert run.returncode != 0
    assert time.monotonic() - begin < 20


@needs_mpirun
def test_the_command_says_an_error_once(tmp_path):
    command = [sys.executable, "-c", "from softdeca.cli import main; main()", "bench", "verification", "--solver", "no"]
    done = subprocess.run(["mpirun", "-n", "2", *command], env=ENVIRONMENT, capture_output=True, text=True)
    alone = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == alone.returncode != 0
    assert without_notices(done.stderr).strip() == alone.stderr.strip()
    assert len(alone.stderr.strip().splitlines()) == 1


@needs_mpirun
def test_the_study_of_ranks_compares_answers_and_phases(cases):
    results = compare({"block": cases["neo-Hookean"][0]}, RanksConfig(rounds=1, repeats=1), lambda *_: None)
    one, two = results["rows"]
    assert (one["processes"], two["processes"]) == (1, 2) and one["tets"] == 6000
    assert one["off"] == 0.0 < two["off"] <= 1e-10  # sums in another order
    assert set(two["seconds"]) == set(two["gain"]) == set(PHASES)
    for phase in PHASES:
        assert two["gain"][phase] == pytest.approx(one["seconds"][phase] / two["seconds"][phase])
    assert all(gate["passed"] for gate in results["gates"])


@pytest.mark.parametrize("counts", [(), (2, 1), (1, 0)])
def test_a_study_of_ranks_begins_with_one_process(counts):
    with pytest.raises(InputError, match="expected 1 and others"):
        RanksConfig(counts=counts)


def test_counts_that_are_no_numbers_are_refused(command):
    ended = command("bench", "ranks", "--processes", "1,two")
    assert ended.status == 1
    assert ended.errors == ["softdeca: error: --processes: expected counts with commas between, got '1,two'"]


def test_a_process_alone_has_no_team(monkeypatch):
    for name in ranks.SIZES:
        monkeypatch.delenv(name, raising=False)
    assert ranks.join() is None and ranks.team() is None


def test_mpirun_of_another_mpi_is_refused(monkeypatch):
    monkeypatch.setenv("PMI_SIZE", "4")
    monkeypatch.setenv("PMI_RANK", "0")
    monkeypatch.setenv("OMPI_MCA_mpi_yield_when_idle", "1")
    with pytest.raises(MissingDependencyError, match="mpirun has started 4 processes, but mpi4py knows 1"):
        ranks.join()
    monkeypatch.setenv("PMI_RANK", "1")
    with pytest.raises(SystemExit):
        ranks.join()
