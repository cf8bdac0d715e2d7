"""Time per unknown: counts of nodes and entries, fitted exponents, and one small mesh measured."""

import numpy as np
import pytest

from softdeca.benchmarks.machine import describe
from softdeca.benchmarks.unknowns import (
    CPU_SECONDS,
    MESHES,
    UnknownsConfig,
    exponents,
    matrix_entries,
    measure,
    nodes_of,
    unknowns_gates,
)
from softdeca.benchmarks.unknowns_report import page
from softdeca.lhm import InputError
from softdeca.reference import Parameters, Scene, facial_scene
from softdeca.reference.problems import meshes


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_counts_are_the_solvers(element):
    pytest.importorskip("dolfinx")
    from softdeca.reference.fenicsx.numbering import Numbering
    from softdeca.reference.fenicsx.problem import Problem

    X, tets = meshes.unstructured(2, 1.0)
    scene = Scene(np.vstack([X, [[9.0, 9.0, 9.0]]]), tets, [])  # a vertex in no tet is no unknown
    order = Numbering(scene, 1 if element == "P1" else 2)
    assert nodes_of(scene, element) == len(order.X)
    if element == "P1":
        assert matrix_entries(scene) == Problem(scene, order).matrix.getInfo()["nz_used"]


def rows_of(power):
    return [
        {"law": "PD", "element": "P1", "unknowns": n, "cpu_seconds": 1e-5 * n**power, "peak_mb": 7.0 * n}
        | {"cpu_per_linear_iteration": 1e-7 * n, "linear_iterations": 30.0, "converged": True}
        | {"level": 2, "sub_layers": k}
        for k, n in enumerate((1000, 4000, 30000))
    ]


def test_exponents_are_those_that_the_figures_were_made_with():
    (found,) = exponents([*rows_of(1.3), rows_of(1.0)[0] | {"element": "P2"}])  # one mesh has no slope
    assert found["meshes"] == 3 and found["cpu_seconds"] == pytest.approx(1.3)
    assert found["peak_mb"] == pytest.approx(1.0) and found["linear_iterations"] == pytest.approx(0.0, abs=1e-12)


def test_a_solve_that_did_not_converge_is_a_wrong_answer_and_a_slow_one_is_not():
    slow, lost = rows_of(1.0)[1] | {"cpu_seconds": 1e3}, rows_of(1.0)[0] | {"converged": False}
    answer, *speed = unknowns_gates([slow, lost])
    assert answer["answer"] and not answer["passed"]
    assert [(gate["passed"], gate["answer"]) for gate in speed] == [(False, False)]
    assert f"at most {CPU_SECONDS['PD']:g}" == speed[0]["bound"]


def test_meshes_are_chosen_by_their_unknowns():
    assert UnknownsConfig(up_to=50_000).meshes == [mesh for mesh, count in MESHES.items() if count <= 50_000]
    assert len(UnknownsConfig(max(MESHES.values())).meshes) == len(MESHES) > len(UnknownsConfig().meshes) > 2
    with pytest.raises(InputError, match="18180"):
        UnknownsConfig(up_to=100)
    with pytest.raises(InputError, match="smirk"):
        UnknownsConfig(expression="smirk")


def test_one_solve_is_measured_and_drawn(sphere_head):
    pytest.importorskip("dolfinx")
    scene = facial_scene(sphere_head, Parameters(gravity=2.0), sphere_head.skin.vertices, bones="prescribed")
    row = measure("PD", scene, "P1") | {"level": 1, "sub_layers": 1}
    assert row["converged"] and row["linear_iterations"] >= row["iterations"] > 0 < row["cpu_seconds"]
    assert row["unknowns"] == 3 * len(scene.vertices) and row["peak_mb"] > 50.0
    results = {
        "title": "time",
        "tolerance": 1e-8,
        "rows": [row],
        "exponents": [],
        "floors": [{"what": "assembly", "ms": 2.0, "floor_ms": 1.0, "ratio": 2.0, "megabytes": 3.0}],
        "gates": unknowns_gates([row]),
        "machine": describe(),
        "seconds": 1.0,
    }
    html = page(results)
    assert html.count("<svg") == 1 and str(row["unknowns"]) in html.replace(",", "").replace("\u202f", "")
