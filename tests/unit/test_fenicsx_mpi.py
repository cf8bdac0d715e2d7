"""Several processes by mpirun: the serial answer, a part of the mesh in each, one error, one end."""

import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.harness.mpirun import SETTINGS, strip_notices
from softdeca.reference import Parameters, Scene, facial_scene, march, prepare
from softdeca.reference.materials import Incompressible, MooneyRivlin, NeoHookean
from softdeca.reference.problems import bars
from softdeca.reference.problems.meshes import box, triangles_at, vertices_at
from softdeca.reference.terms import (
    Bending,
    Fixed,
    Gravity,
    Hyperelastic,
    Pressure,
    RigidBody,
    Strain,
    SurfaceStrain,
    Target,
    Traction,
)

needs_mpirun = pytest.mark.skipif(shutil.which("mpirun") is None, reason="mpirun is not installed")
ENVIRONMENT = {
    **os.environ,
    **SETTINGS,
    "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
}
TIGHT = 1e-12
MUMPS = {"linear_solver": "mumps"}


def stretched(cells, *solids):
    """A box whose lower end is held and whose upper end is pulled and sheared."""
    X, tets = box(cells)
    low, high = vertices_at(X, 2, 0.0), vertices_at(X, 2, 1.0)
    return Scene(X, tets, (*solids, Fixed(low), Fixed(high, X[high] + [0.1, 0.05, 0.2])))


def on_part(scene, law):
    """A scene whose solid has another law on half of its tets."""
    solid, *others = scene.terms
    tets = np.arange(len(scene.tets))
    low = scene.vertices[scene.tets, 2].mean(axis=1) < 0.5
    return replace(scene, terms=(replace(solid, tets=tets[~low]), Hyperelastic(law, tets=tets[low]), *others))


def pulled_far(cells):
    """A bar to five times its length: by load steps, as elements beside its held end snap."""
    X, tets = box(cells, (6.0, 1.0, 1.0))
    stress = bars.neo_hookean_law(5.0)[1]
    pull = Traction(triangles_at(X, tets, 0, 6.0), stress * np.eye(3)[0])
    law = NeoHookean.from_young(bars.YOUNG, bars.POISSON)
    return Scene(X, tets, (Hyperelastic(law), Fixed(vertices_at(X, 0, 0.0)), pull))


def drawn(head):
    """A head whose skin is drawn forward at the cheeks, its mandible free."""
    skin = head.skin.vertices
    bump = np.exp(-((skin[:, 1] / 40.0) ** 2))[:, None] * [0.0, 0.0, 6.0]
    return facial_scene(head, Parameters(), skin + bump)


def boxes():
    """Scenes with options: each gives what crosses the border between processes in a way of its own."""
    small, large = (5, 5, 5), (7, 7, 7)
    neo = Hyperelastic(NeoHookean.from_young(10.0, 0.4))
    plain, few = stretched(large, neo), stretched(small, neo)
    rows = np.arange(len(plain.vertices)).reshape(-1, large[2] + 1)
    outside = triangles_at(plain.vertices, plain.tets, 0, 1.0)
    pulled, bone = (vertices_at(plain.vertices, c, 1.0) for c in (0, 2))
    m = len(few.tets)
    by_tet = np.random.default_rng(3).uniform(0.9, 1.1, m)
    grown = Hyperelastic(MooneyRivlin(1.0, 0.5, 20.0, C20=0.4), growth=by_tet)
    springs = Target(pulled[:9], plain.vertices[pulled[:9]] + 0.1, 2.0)
    side = triangles_at(few.vertices, few.tets, 0, 1.0)
    moved = Target(bone[:9], plain.vertices[bone[:9]] + [0.2, 0.1, 0.2], 2.0)
    body = (neo, Fixed(vertices_at(plain.vertices, 2, 0.0)), RigidBody(bone), moved, Gravity((3e5, 0.0, 0.0), 1e-6))
    return {
        "neo-Hookean": (plain, {}),
        "factors, fields by tet": (stretched(small, grown, Strain(5.0, tets=np.arange(40))), MUMPS),
        "sub-layers": (replace(plain, columns=(rows[:, :6], rows[:, 5:])), {}),
        "skin and springs": (
            replace(plain, terms=(*plain.terms, SurfaceStrain(outside, 3.0), Bending(outside, 0.05), springs)),
            {},
        ),
        "body": (replace(plain, terms=body), {}),
        "quadratic skin": (
            replace(few, terms=(*few.terms, SurfaceStrain(side, 3.0), Bending(side, 0.05), Pressure(side, 0.2))),
            {"element": "P2"},
        ),
        "Taylor-Hood by GMRES": (
            on_part(few, Incompressible(NeoHookean(10.0, 10.0))),
            {"element": "P2P1", "linear_solver": "block"},
        ),
        "load steps": (pulled_far((12, 3, 3)), {}),
    }


BOXES = boxes()
NAMES = (*BOXES, "head")


@pytest.fixture(scope="module")
def cases(sphere_head):
    return {**BOXES, "head": (drawn(sphere_head), {})}


def run_together(tmp_path, script, *arguments, count=2, timeout=120):
    """Run a script in processes that mpirun starts; what it has printed."""
    file = tmp_path / "script.py"
    file.write_text(script)
    command = ["mpirun", "-n", str(count), sys.executable, "-m", "mpi4py", str(file), *map(str, arguments)]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=timeout, cwd=tmp_path)


SOLVE = """
import pickle, sys
from mpi4py import MPI
from softdeca.reference import prepare
answers = {}
for name, (scene, options) in pickle.load(open(sys.argv[1], "rb")).items():
    prepared = prepare(scene, solver="fenicsx", **options)
    solution = prepared.solve(tolerance=1e-12)
    fields = prepared.fields(1)
    tissue = prepared._numbering.nodes
    answers[name] = (solution.positions, solution.energy, solution.reactions, fields.weights @ fields.u,
                     MPI.COMM_WORLD.allgather((tissue.owned, tissue.total)))
if MPI.COMM_WORLD.rank == 0:
    pickle.dump(answers, open(sys.argv[2], "wb"))
    print("done by", MPI.COMM_WORLD.size)
"""


@pytest.fixture(scope="module")
def answers(cases, tmp_path_factory):
    """Positions, energy, reactions, mean displacement and the nodes of each process, by two of them, of every case."""
    folder = tmp_path_factory.mktemp("together")
    (folder / "cases").write_bytes(pickle.dumps(cases))
    done = run_together(folder, SOLVE, folder / "cases", folder / "answers", timeout=900)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "done by 2\n"
    return pickle.loads((folder / "answers").read_bytes())


@needs_mpirun
@pytest.mark.parametrize("name", NAMES)
def test_two_processes_give_the_serial_answer(name, cases, answers):
    scene, options = cases[name]
    prepared = prepare(scene, solver="fenicsx", **options)
    alone = prepared.solve(tolerance=TIGHT)
    fields = prepared.fields(1)
    positions, energy, reactions, displacement, parts = answers[name]
    (mine, total), (other, same) = parts
    assert mine + other == total == same and min(mine, other) > 0.3 * total  # each has a part of the mesh
    largest = np.linalg.norm(alone.positions - scene.vertices, axis=1).max()
    assert largest > 0.05
    assert np.abs(positions - alone.positions).max() <= 1e-10 * largest
    assert energy == pytest.approx(alone.energy, rel=1e-12)
    assert np.abs(reactions - alone.reactions).max() <= 1e-9 * np.abs(alone.reactions).max()
    assert np.allclose(displacement, fields.weights @ fields.u, rtol=0.0, atol=1e-10 * largest * fields.weights.sum())


MARCH = """
import pickle, sys
from mpi4py import MPI
from softdeca.reference import march
scene, options = pickle.load(open(sys.argv[1], "rb"))
found = [moment.positions for moment in march(scene, **options)]
if MPI.COMM_WORLD.rank == 1:
    pickle.dump(found, open(sys.argv[2], "wb"))
"""


@needs_mpirun
def test_a_march_by_three_processes_is_the_serial_one(tmp_path):
    X, tets = box((6, 6, 6))
    solid = Hyperelastic(NeoHookean.from_young(10.0, 0.4))
    scene = Scene(X, tets, (solid, Fixed(vertices_at(X, 2, 0.0))))
    push = np.zeros_like(X)
    push[:, 0] = 2.0 * X[:, 2]
    options = {"density": 1e-6, "time_step": 1e-3, "steps": 5, "velocities": push, "damping": 1.0, "tolerance": 1e-11}
    (tmp_path / "in").write_bytes(pickle.dumps((scene, options)))
    done = run_together(tmp_path, MARCH, tmp_path / "in", tmp_path / "out", count=3)
    assert done.returncode == 0, done.stderr
    together, alone = (
        pickle.loads((tmp_path / "out").read_bytes()),
        [moment.positions for moment in march(scene, **options)],
    )
    assert np.abs(np.subtract(together, alone)).max() <= 1e-10 * np.abs(alone - X).max()


FAILING = """
import os, pickle, sys
from dataclasses import replace
import numpy as np
from mpi4py import MPI
from softdeca.reference import SceneError, materials, solve, terms
world, scene = MPI.COMM_WORLD, pickle.load(open(sys.argv[1], "rb"))
solid = terms.Hyperelastic(materials.NeoHookean(1.0 + world.rank, 5.0))
far = terms.Gaps([[0, *np.argsort(scene.vertices.sum(axis=1))[-3:]]], np.array([False]), 1.0, 9.0)
for other in (
    scene.with_fixed(scene.of(terms.Fixed)[0].values + world.rank),
    replace(scene, terms=[solid, *scene.terms[1:]]),
    replace(scene, terms=[*scene.terms, far]),
):
    said = "taken"
    try:
        solve(other, solver="fenicsx")
    except SceneError as error:
        said = str(error)
    told = world.gather(said)
    if world.rank == 0:
        print(*told, sep="|", flush=True)
if world.rank == 1:
    if sys.argv[2] == "broken":
        raise RuntimeError("one process alone")
    os.kill(os.getpid(), 9)
solve(scene, solver="fenicsx")
"""


@needs_mpirun
@pytest.mark.parametrize(
    ("how", "status", "error"), [("broken", 1, "RuntimeError: one process alone"), ("dead", 137, "")]
)
def test_all_refuse_what_they_do_not_share_and_end_with_one_that_fails(how, status, error, tmp_path):
    """Other scenes, other laws, and a pair of contact whose parts lie in two processes; all go on after a refusal."""
    X, tets = box((6, 6, 6))
    ends = np.concatenate([vertices_at(X, 2, 0.0), vertices_at(X, 2, 1.0)])
    scene = Scene(X, tets, (Hyperelastic(NeoHookean.from_young(10.0, 0.4)), Fixed(ends, X[ends])))
    (tmp_path / "scene").write_bytes(pickle.dumps(scene))
    done = run_together(tmp_path, FAILING, tmp_path / "scene", how)
    assert done.returncode == status and error in done.stderr
    told = [line.split("|") for line in done.stdout.splitlines()]
    unlike = "the ranks of mpirun were given different scenes"
    assert [all(said.startswith(unlike) for said in pair) for pair in told] == [True, True, False]
    assert "taken" not in told[2]


FIRST_ALONE = """
import petsc4py
from mpi4py import MPI
petsc4py.init(comm=MPI.COMM_SELF)
from softdeca.reference import Scene, solve, terms
from softdeca.reference.problems.meshes import box
X, tets = box((6, 6, 6))
low = X[:, 2] < 1e-9
scene = Scene(X, tets, [terms.Strain(1.0), terms.Fixed(low), terms.Gravity((0, 0, -1), 1e-3)])
if MPI.COMM_WORLD.rank == 0:
    print(solve(scene, solver="fenicsx").converged)
MPI.COMM_WORLD.Barrier()
"""


@needs_mpirun
def test_processes_of_a_program_may_solve_each_on_their_own(tmp_path):
    done = run_together(tmp_path, FIRST_ALONE, count=2)
    assert done.returncode == 0 and done.stdout == "True\n"


@needs_mpirun
def test_a_command_is_refused_under_mpirun():
    command = [sys.executable, "-c", "from softdeca.cli import main; main()", "bench", "list"]
    done = subprocess.run(["mpirun", "-n", "2", *command], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 1
    line = "softdeca: error: mpirun shares the solves of a script, not of a command; run softdeca without it"
    # mpirun may put a process' line into another's.
    assert line in done.stderr and not strip_notices(done.stderr).replace(line, "").strip()
