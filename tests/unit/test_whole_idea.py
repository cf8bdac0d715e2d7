"""The method on one sheet, docs/tutorials/whole_idea.py: what it stands on, and that the package has the same."""

import ast
import importlib.util
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import meshio
import numpy as np
import pytest

from softdeca.benchmarks.face.archive import write_archive
from softdeca.benchmarks.face.problems import BONES, MESHES, PROBLEMS, body_of
from softdeca.benchmarks.face.score import measure
from softdeca.benchmarks.harness.study import Task
from softdeca.benchmarks.studies.mesh.face import FaceBenchmark
from softdeca.lhm import expressions
from softdeca.lhm.head.file import load_head, save_head
from softdeca.reference import Face, Parameters
from softdeca.reference.face.dynamics import Recurrence
from softdeca.reference.projective.terms.energy import Energy

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorials" / "whole_idea.py"


@pytest.fixture(scope="module")
def sheet():
    spec = importlib.util.spec_from_file_location("whole_idea", PAGE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def heads(sheet, mean_head, tmp_path_factory):
    """The arrays of a head for the sheet, and the head for the package."""
    file = tmp_path_factory.mktemp("head") / "head.npz"
    save_head(file, mean_head)
    return sheet.read_head(file), load_head(file)


def test_the_method_is_one_sheet_of_numpy_and_scipy():
    text = PAGE.read_text()
    assert len(text.splitlines()) <= 400
    *method, compared = ast.parse(text).body
    assert isinstance(compared, ast.If)
    nodes = [node for statement in method for node in ast.walk(statement)]
    names = [name for node in nodes if isinstance(node, ast.Import) for name in (alias.name for alias in node.names)]
    names += [node.module for node in nodes if isinstance(node, ast.ImportFrom)]
    assert {name.split(".")[0] for name in names} == {"numpy", "scipy"}


@pytest.mark.parametrize("changed", [{}, {"soft_stiffness": 9.0, "strain_limit": 1.1, "muscle_strain_ratio": 0.2}])
def test_its_energy_is_the_packages(sheet, heads, changed):
    arrays, head = heads
    weights = expressions.parse_weights("jawOpen+mouthSmileLeft*0.5")
    face = Face(head, head.rig.deltas, Parameters(**changed), choices={"cells": "tets"})
    problem = sheet.facial_problem(arrays, sheet.PARAMETERS | changed, sheet.blend(arrays, weights))
    u = np.random.default_rng(0).normal(scale=0.5, size=problem.rest.shape)
    energy, gradient = problem.energy(problem.rest + u)
    its_energy, its_gradient = Energy.from_scene(face.scene(weights)).evaluate(u)
    assert energy == pytest.approx(its_energy, rel=1e-11)
    assert np.abs(gradient - its_gradient).max() < 1e-9 * np.abs(its_gradient).max()


def test_its_derivatives_are_the_packages(sheet, heads):
    arrays, head = heads
    problem = sheet.facial_problem(arrays, sheet.PARAMETERS, head.skin.vertices)
    _, by_weights = sheet.derivatives(arrays, problem, problem.rest)
    face = Face(head, head.rig.deltas, choices={"cells": "tets"})
    assert np.abs(by_weights - face.first_order).max() < 1e-8


def test_its_recurrence_is_the_packages(sheet, heads):
    arrays, head = heads
    problem = sheet.facial_problem(arrays, sheet.PARAMETERS, head.skin.vertices)
    last, earlier = problem.rest + 1.0, problem.rest + 3.0
    theirs = Recurrence.from_oscillator(5.0, 0.2, 0.02)
    moving = sheet.in_motion(problem, last, earlier, 5.0, 0.2, 0.02)
    goals = theirs.gamma * problem.goals + 2.0 * theirs.alpha * last - theirs.beta * earlier
    assert np.allclose(moving.goals, goals, rtol=0.0, atol=1e-10)
    assert np.allclose(moving.springs * theirs.gamma, problem.springs)


@pytest.mark.parametrize("problem", ["jaw", "growth"])
def test_it_answers_the_face_benchmark_as_finite_elements_do(mean_head, tmp_path, problem):
    body = body_of(mean_head)
    still = np.zeros_like(body.vertices)
    answers = {f"{name}.{kind}": still for name in PROBLEMS for kind in ("converged", "linear.coarse")}
    limits = {name: {"band_mm": 1.0, "largest_mm": 1.0, "answers": []} for name in PROBLEMS}
    write_archive(tmp_path / "files.zip", (body,) * len(MESHES), limits, answers, "none")
    with zipfile.ZipFile(tmp_path / "files.zip") as file:
        file.extractall(tmp_path)
    script = ROOT / "tests" / "verification" / "face_by_whole_idea.py"
    out = tmp_path / "answer.vtu"
    subprocess.run([sys.executable, script, tmp_path, problem, "coarse", out], check=True, capture_output=True)
    answer, asked = meshio.read(out), json.loads((tmp_path / "benchmark.json").read_text())
    moved, reactions = answer.point_data["displacement"], answer.point_data["reaction"]
    stress = answer.cell_data["cauchy"][0].reshape(-1, 3, 3)
    mine = measure(asked, 0, moved, reactions, stress, {bone: body.shares[bone] for bone in BONES})
    quantities = FaceBenchmark().measure(Task(problem, "FEniCSx, linear, coarse"))["quantities"]
    for name, theirs in quantities.items():
        assert mine[name] == pytest.approx(theirs, rel=1e-4, abs=1e-4 * np.linalg.norm(theirs)), name
