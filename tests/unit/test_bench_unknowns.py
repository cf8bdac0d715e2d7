"""Time per unknown: counts of nodes, exponents, and the choice of meshes."""

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.measures import fit_slope
from softdeca.benchmarks.studies.scaling.unknowns import MESHES, Unknowns, count_nodes, fit_exponents
from softdeca.reference import Scene
from softdeca.reference.problems import meshes
from softdeca.surrogate.methods import FENICSX


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_counts_are_the_solvers(element):
    pytest.importorskip("dolfinx")
    from softdeca.reference.fenicsx.mesh.numbering import Numbering

    X, tets = meshes.unstructured(2, 1.0)
    scene = Scene(np.vstack([X, [[9.0, 9.0, 9.0]]]), tets, [])  # a vertex in no tet is no unknown
    order = Numbering(scene, 1 if element == "P1" else 2)
    assert count_nodes(scene, element) == len(order.X)


def rows_of(power):
    return [
        Row("level 2, 1 sub-layer, P1", FENICSX, "done", "", values, 1.0, None, 0.0, "")
        for n in (1000, 4000, 30000)
        for values in [
            {"law": "PD", "element": "P1", "unknowns": n, "cpu_s": 1e-5 * n**power, "peak_mb": 7.0 * n}
            | {"cpu_per_linear_iteration": 1e-7 * n, "linear_iterations": 30.0, "converged": True}
        ]
    ]


def test_exponents_are_those_that_the_figures_were_made_with():
    ((method, element, count, found),) = fit_exponents(rows_of(1.3))
    assert (method, element, count) == (FENICSX, "P1", 3) and found["cpu_s"] == pytest.approx(1.3)
    assert found["peak_mb"] == pytest.approx(1.0) and found["linear_iterations"] == pytest.approx(0.0, abs=1e-12)
    assert (
        fit_exponents(rows_of(1.0)[:1]) == []
        and fit_slope([1.0], [2.0]) is None
        and fit_slope([1.0, 2.0], [3.0, None]) is None
    )


def test_meshes_are_chosen_by_their_unknowns():
    few = [mesh for mesh, count in MESHES.items() if count <= 50_000]
    assert list(Unknowns(up_to=50_000).meshes.values()) == few
    tasks = Unknowns(up_to=50_000).tasks()
    linear = sum(element == "P1" for _, _, element in few)
    assert len(tasks) == 2 * len(few) + linear
    assert len(Unknowns(up_to=max(MESHES.values())).meshes) == len(MESHES) > len(Unknowns().meshes) > 2
