"""Parts of the studies: limits, traces, cuts and volumes, on small spheres."""

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row, run
from softdeca.benchmarks.studies.agreement.pictures import cut_tets
from softdeca.benchmarks.studies.arena.entrants import list_entrants
from softdeca.benchmarks.studies.arena.laws import RIGID
from softdeca.benchmarks.studies.arena.problems import pull_handles
from softdeca.benchmarks.studies.arena.runs import run as run_solver
from softdeca.benchmarks.studies.heads.fit import Heads, collect_values
from softdeca.benchmarks.studies.measures import (
    largest_distance,
    solve_with_tolerance,
    time_solve,
)
from softdeca.benchmarks.studies.mesh.refine import refine_scene
from softdeca.benchmarks.studies.mesh.study import EFFECTS, MeshError, tell_distance
from softdeca.benchmarks.studies.scaling.unknowns import count_nodes
from softdeca.lhm import check_head, fit_head, identities, load_template
from softdeca.reference import Parameters, Scene, facial_scene, prepare, terms
from softdeca.reference.problems import meshes
from softdeca.reference.terms.term import triangle_areas
from softdeca.surrogate.methods import FENICSX_P2, PD, PD_TETS

pytestmark = pytest.mark.usefixtures("measured_here")


def test_a_cut_box_has_the_area_of_its_side():
    X, tets = meshes.box((3, 2, 2), (3.0, 2.0, 5.0))
    polygons = cut_tets(X - [1.3, 0.0, 0.0], tets)
    areas = [0.5 * abs(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1])) for p in polygons]
    assert sum(areas) == pytest.approx(10.0) and cut_tets(X + [1.0, 0.0, 0.0], tets) == []


def sum_stiffness(scene):
    solids = [t.stiffness * scene.volumes[scene.tets_of(t)] for t in scene.of(terms.Strain) + scene.of(terms.Volume)]
    skin = [t.stiffness * triangle_areas(scene.vertices, t.triangles) for t in scene.of(terms.SurfaceStrain)]
    return [np.sum(each) for each in solids + skin + [t.stiffness for t in scene.of(terms.Target)]]


def test_a_refined_scene_is_the_same_problem(spheres):
    pytest.importorskip("dolfinx")
    from softdeca.reference.fenicsx.energy.bending import Rings
    from softdeca.reference.fenicsx.mesh.numbering import Numbering

    head, count = spheres(1), len(spheres(1).vertices)
    p = Parameters(soft_stiffness=np.linspace(2.0, 3.0, len(head.skin_wrap.triangles)), skin_bending=3.0)
    scene = facial_scene(head, p, head.skin.vertices * [1.05, 1.0, 1.0], bones="prescribed", cells="tets")
    finer, ends = refine_scene(scene)
    assert len(finer.tets) == 8 * len(scene.tets) and finer.volumes.sum() == pytest.approx(scene.volumes.sum())
    quadratic = Numbering(scene, 2)
    assert len(quadratic.X) == len(finer.vertices) == len(scene.vertices) + len(ends)
    assert quadratic.held(scene.dirichlet()[0]).sum() == finer.dirichlet()[0].sum()
    assert sum_stiffness(finer) == pytest.approx(sum_stiffness(scene))
    places = finer.vertices + np.random.default_rng(0).normal(scale=0.3, size=finer.vertices.shape)
    by_ends = {tuple(pair): count + k for k, pair in enumerate(ends)} | {(k, k): k for k in range(count)}
    linear = Numbering(finer, 1)
    at_nodes = places[[by_ends[tuple(pair)] for pair in quadratic.ends]]
    bends = [
        sum(rings.energy(x) for rings in Rings.from_scene(each, numbering))
        for each, numbering, x in ((scene, quadratic, at_nodes), (finer, linear, places[linear.vertex]))
    ]
    assert bends[0] == pytest.approx(bends[1])


def mesh_row(case, tets, prisms, left=None):
    kind = "refined" if left is not None else "effects" if case in EFFECTS else "expressions"
    about = {"case": case, "what": case, "kind": kind, "status": "done"}
    shares = {PD_TETS: tets, PD: prisms}
    lines = [about | {"method": name, "to": {FENICSX_P2: {"share": share}}} for name, share in shares.items()]
    return Row(case, "", "done", "", {"rows": lines} | ({} if left is None else {"left": left}), 1.0, None, 0.0, "")


def missed(*rows):
    return [gate["what"] for gate in MeshError().gates(rows) if not gate["passed"]]


def test_a_mesh_that_locks_misses_its_gates():
    good = mesh_row("skin +15 %", 0.3, 0.1), mesh_row("jawOpen", 0.2, 0.09), mesh_row("skin +15 %", 0.4, 0.3, left=0.04)
    assert missed(*good) == []
    assert tell_distance(good) == (
        "The simulator misses converged finite elements by 10 % of the motion over effects (by tets 30 %) and "
        "9 % of the motion over expressions (by tets 20 %)."
    )
    assert len(missed(mesh_row("skin +15 %", 0.3, 0.3))) == 2 and len(missed(mesh_row("jawOpen", 0.3, 0.11))) == 1
    assert len(missed(mesh_row("skin +15 %", 0.4, 0.1, left=0.06))) == 1


@pytest.fixture(scope="module")
def targets(sphere_head):
    """The sphere's skin, drawn out by 3 mm where it looks forward."""
    skin = sphere_head.skin.vertices
    return skin + 3.0 * np.maximum(skin[:, 2:] / np.abs(skin).max(), 0.0) * np.array([0.0, 0.3, 1.0])


def test_the_tolerance_that_a_solve_names_leads_to_its_end(sphere_head, targets):
    end, tolerance = solve_with_tolerance(prepare(facial_scene(sphere_head, Parameters(), targets)))
    answer, cost = time_solve(lambda: facial_scene(sphere_head, Parameters(), targets), tolerance)
    assert end.converged and 1e-10 < tolerance < 1e-2
    assert largest_distance(answer.positions, end.positions) <= 0.01 and 0 < cost["iterations"] < end.iterations
    assert min(cost[f"{part}_s"] for part in ("scene", "prepare", "solve", "cpu")) > 0


def test_libigl_and_we_minimise_the_same_energy(sphere_head, targets):
    pytest.importorskip("igl")
    problem = pull_handles(sphere_head, targets)
    held, _ = facial_scene(sphere_head, Parameters(), targets).dirichlet()
    assert set(np.flatnonzero(held.all(axis=1))) < set(problem.held)
    scene = problem.scene(RIGID)
    assert [type(term) for term in scene.terms] == [terms.Strain, terms.Fixed]
    truth = prepare(scene).solve(tolerance=1e-10).positions
    (entrant,) = (each for each in list_entrants() if each.file == "libigl_arap")
    found = run_solver(entrant, problem, RIGID, [truth], 2.0, scene.vertices)
    moved = largest_distance(truth, scene.vertices)
    assert moved > 1.0 and found["max_mm"] < 2e-3 * moved


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_counts_are_the_solvers(element):
    pytest.importorskip("dolfinx")
    from softdeca.reference.fenicsx.mesh.numbering import Numbering

    X, tets = meshes.unstructured(2, 1.0)
    scene = Scene(np.vstack([X, [[9.0, 9.0, 9.0]]]), tets, [])  # a vertex in no tet is no unknown
    order = Numbering(scene, 1 if element == "P1" else 2)
    assert count_nodes(scene, element) == len(order.X)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two heads: the folder and its results."""
    out = tmp_path_factory.mktemp("heads")
    return out, run(Heads(count=2, level=1), out, workers=1)


def test_each_head_is_that_of_its_seed(two):
    _, results = two
    space = identities.Anny()
    _, skin = space.sample(np.random.default_rng(1))
    report = check_head(fit_head(load_template(space, level=1), skin))
    assert results.passed and results.rows[1].case == "seed 1"
    assert results.rows[1].values["figures"]["smallest_dihedral"] == report.smallest_dihedral
    found = {name: list(collect_values(results.rows[:2], name).values()) for name in ("lip_path", "fit_cpu_s")}
    assert report.lip_path in found["lip_path"] and len(set(found["lip_path"])) == 2 and min(found["fit_cpu_s"]) > 0
