"""Every study from its options to its page, on small spheres."""

import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.agreement.material import Material
from softdeca.benchmarks.studies.arena.problems import Problem
from softdeca.benchmarks.studies.verification import compare_felupe
from softdeca.reference import Parameters, facial_scene, terms

pytestmark = pytest.mark.usefixtures("measured_here")

# test_study runs the others, in the main study.
CHEAP = {
    "SphereUnknowns": {"up_to": 50_000},
    "SphereMeshError": {
        "people": 1,
        "effects": ("volume +40 %",),
        "expressions": (),
        "refined": ("volume +40 %",),
        "methods": ("PD, tets", "PD"),
    },
    "SphereMinimal": {"level": 1, "expressions": ("jawOpen",), "effects": ("3 g",)},
    "SphereThroughput": {"level": 1, "people": 1, "frames": 13},
    "SphereWorkPrecision": {"level": 1, "expressions": ("jawOpen",)},
    "SphereRanks": {"level": 1, "processes": (1, 2), "repeats": 1},
}


@pytest.fixture
def of_spheres(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    import sphere_studies

    return sphere_studies


@pytest.mark.parametrize("name", CHEAP)
def test_a_study_of_a_sphere_from_its_tasks_to_its_page(of_spheres, tmp_path, name):
    study = getattr(of_spheres, name)(**CHEAP[name])
    results = run(study, tmp_path)
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    # A worker's memory is that of the process that runs these tests.
    missed = [gate for gate in results.gates if gate["answer"] and not gate["passed"] and "[MB]" not in gate["what"]]
    assert missed == [] and results.words
    text = unescape((tmp_path / "index.html").read_text())
    text = text.replace('<link rel="icon" href="data:,">', "")
    assert not re.search(r"<(script|link|iframe|object)|@import|(src|href)=\"(?!#|data:)", text)
    assert all(row.case in text for row in results.rows)
    json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)


def test_the_law_that_pd_stands_for(tmp_path):
    results = run(Material(poisson=(0.45,)), tmp_path, match="one axis, corotated", workers=1)
    (row,) = results.rows
    assert results.passed and "corotated law" in results.words
    # Verified: the corotated law's nominal stress along one axis is E times the strain.
    strain = [stretch - 1.0 for stretch in row.values["stretch"]]
    assert row.values["law_kpa"] == pytest.approx(strain, abs=1e-6)
    # At rest PD's energy is as stiff; compressed to half, volume's projection is softer than tr² of the strain.
    assert row.values["pd_kpa"][6:8] == pytest.approx(strain[6:8], rel=0.01)


def test_felupe_finds_what_fenicsx_finds(sphere_head):
    pytest.importorskip("felupe", reason="FElupe is not installed")
    pytest.importorskip("dolfinx", reason="FEniCSx is not installed")
    skin = sphere_head.skin.vertices
    scene = facial_scene(
        sphere_head, Parameters(), skin * [1.02, 1.0, 1.0], bones="prescribed", without=("skin",), cells="tets"
    )
    (bones,), full, everywhere = scene.of(terms.Fixed), np.ones(len(scene.tets)), np.arange(len(scene.vertices))
    springs = scene.of(terms.Target)
    outcome = compare_felupe(
        Problem(scene.vertices, scene.tets, bones.vertices, bones.values, springs, 3.0 * full, 9.0 * full, everywhere)
    )
    assert outcome.passed and outcome.error < 1e-8 and outcome.value > 1.0
