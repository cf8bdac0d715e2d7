"""What the studies are made of: limits, traces, cuts and volumes, on small spheres."""

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row, run
from softdeca.benchmarks.studies.agreement.pictures import cut_tets
from softdeca.benchmarks.studies.arena.contest import run_outside, summarise
from softdeca.benchmarks.studies.arena.laws import RIGID
from softdeca.benchmarks.studies.arena.problems import pull_handles
from softdeca.benchmarks.studies.heads import fit as study
from softdeca.benchmarks.studies.heads.fit import Heads, sample
from softdeca.benchmarks.studies.measures import (
    largest_distance,
    limit_of_three,
    limit_of_two,
    time_solve,
    trace_solve,
    trace_to_itself,
)
from softdeca.benchmarks.studies.mesh.limits import compare_finer_meshes
from softdeca.benchmarks.studies.mesh.study import (
    FINER,
    MeshError,
)
from softdeca.benchmarks.studies.scaling.unknowns import count_nodes
from softdeca.lhm import check_head, fit_head, identities, load_template
from softdeca.reference import Parameters, Scene, facial_scene, prepare, terms
from softdeca.reference.problems import meshes

pytestmark = pytest.mark.usefixtures("measured_here")


def test_a_cut_box_has_the_area_of_its_side():
    X, tets = meshes.box((3, 2, 2), (3.0, 2.0, 5.0))
    polygons = cut_tets(X - [1.3, 0.0, 0.0], tets)
    areas = [0.5 * abs(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1])) for p in polygons]
    assert sum(areas) == pytest.approx(10.0) and cut_tets(X + [1.0, 0.0, 0.0], tets) == []


@pytest.mark.parametrize("order", [0.8, 1.0, 1.7, 2.0])
def test_the_limit_of_an_answer_of_one_order_is_exact(order):
    rng = np.random.default_rng(0)
    exact, slope = rng.normal(size=(2, 50, 3))
    coarse, middle, fine = (exact + slope * size**order for size in (1.0, 0.5, 0.25))
    limit = limit_of_three(coarse, middle, fine)
    assert limit.observed == pytest.approx(order) and limit.used == pytest.approx(order)
    assert limit.positions == pytest.approx(exact, abs=1e-12)
    # Roache: 1.25 times the true error of the finest, here the slope's RMS times its size to the order.
    slopes = np.sqrt((slope**2).sum(axis=1).mean())
    assert limit.index == pytest.approx(1.25 * slopes * 0.25**order)
    two = limit_of_two(coarse, middle, order)
    assert two.positions == pytest.approx(exact, abs=1e-12)
    assert two.index == pytest.approx(3.0 * slopes * 0.5**order)


def row(case, method, *lines):
    return Row(case, method, "done", "", {"rows": list(lines)}, 1.0, None, 0.0, "")


def passed(rows):
    return [gate["passed"] for gate in MeshError().gates(rows)]


def test_every_mesh_is_solved_and_the_finest_is_nearest(spheres):
    head = spheres(1)
    own, two, four, split = compare_finer_meshes(head, head.skin.vertices * [1.05, 1.0, 1.0])["rows"]
    finer = row("wider", FINER, own, two, four, split)
    assert passed([finer])[0]
    # Tets split into eight are eight times as many as the head's.
    assert split["tets"] == 8 * own["tets"] and four["tets"] == 4 * own["tets"]
    assert four["across"]["rms"] < two["across"]["rms"] < own["across"]["rms"]
    assert split["along"]["rms"] == pytest.approx(0.5 * two["along"]["rms"])
    assert own["rms"] <= own["across"]["rms"] + two["along"]["rms"] + 1e-12
    split["energy"] = 1e9
    assert not passed([finer])[0]


@pytest.fixture(scope="module")
def targets(sphere_head):
    """The sphere's skin, drawn out by 3 mm where it looks forward."""
    skin = sphere_head.skin.vertices
    return skin + 3.0 * np.maximum(skin[:, 2:] / np.abs(skin).max(), 0.0) * np.array([0.0, 0.3, 1.0])


def test_a_solve_seen_from_its_end_is_seen_from_the_truth(sphere_head, targets):
    prepared = prepare(facial_scene(sphere_head, Parameters(), targets))
    solution, own = trace_to_itself(prepared)
    again, trace = trace_solve(prepared, solution.positions)
    assert again.converged and trace.error[-1] == 0.0
    assert np.allclose(own.error, trace.error, atol=2e-5) and own.gradient == pytest.approx(trace.gradient)
    stopped, short = trace_solve(prepared, solution.positions, enough=0.1)
    assert not stopped.converged and short.error[-1] <= 0.1 < short.error[-2]
    # The tolerance that a trace names leads a solve of its own to that accuracy.
    answer, cost = time_solve(lambda: facial_scene(sphere_head, Parameters(), targets), trace.tolerance_for(0.01))
    assert largest_distance(answer.positions, solution.positions) <= 0.01
    assert cost["iterations"] >= trace.iterations_to(0.01)
    assert min(cost[f"{part}_s"] for part in ("scene", "prepare", "solve", "cpu")) > 0


def test_libigl_and_we_minimise_the_same_energy(sphere_head, targets):
    pytest.importorskip("igl")
    problem = pull_handles(sphere_head, targets)
    held, _ = facial_scene(sphere_head, Parameters(), targets).dirichlet()
    assert set(np.flatnonzero(held.all(axis=1))) < set(problem.held)
    scene = problem.scene(RIGID)
    assert [type(term) for term in scene.terms] == [terms.Strain, terms.Fixed]
    truth = prepare(scene).solve(tolerance=1e-10).positions
    found = summarise(run_outside("libigl_arap", problem.arrays(), {"own": truth}, {}, 2.0))
    moved = largest_distance(truth, scene.vertices)
    assert moved > 1.0 and found["max_mm"] < 2e-3 * moved and found["max_mm"] < 0.01 * found["first_mm"]


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
    """Two heads, of which one is drawn: the folder and its results."""
    out = tmp_path_factory.mktemp("heads")
    return out, run(Heads(count=2, gallery=1, level=1), out, workers=1)


def test_each_head_is_that_of_its_seed(two):
    _, results = two
    space = identities.Anny()
    _, skin = space.sample(np.random.default_rng(1))
    report = check_head(fit_head(load_template(space, level=1), skin))
    assert results.passed and results.rows[1].case == "seed 1"
    assert results.rows[1].values["figures"]["smallest_dihedral"] == report.smallest_dihedral
    found = {figure.name: [value for value, _ in values] for figure, values in study.collect_figures(results.rows[:2])}
    assert report.lip_path in found["lip_path"] and len(set(found["lip_path"])) == 2 and min(found["fit_s"]) > 0


def test_scaled_samples_reach_further():
    space = identities.Anny()
    mean = space.mean.vertices
    default, far = (sample(space, 0, sigma).vertices - mean for sigma in (2.5, 4.0))
    np.testing.assert_allclose(far, 1.6 * default, atol=1e-9)
