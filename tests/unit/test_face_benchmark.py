"""The open face benchmark on a small sphere: nested meshes, the archive, and scores of answers right and wrong."""

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import meshio
import numpy as np
import pytest

from softdeca.benchmarks.face import score as scorer
from softdeca.benchmarks.face.export import export
from softdeca.benchmarks.face.problems import BONES, PROBLEMS
from softdeca.benchmarks.studies.mesh.face import METHODS
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.reference import solve
from softdeca.reference.solution import write_solution

pytest.importorskip("dolfinx")


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import sphere_studies

    yield sphere_studies.SphereFaceBenchmark()
    sys.path.remove(str(Path(__file__).parents[1]))


@pytest.fixture(scope="module")
def exported(study, tmp_path_factory):
    folder = tmp_path_factory.mktemp("face")
    results, size = export(folder / "benchmark.zip", study, folder / "rows", workers=1)
    assert size == (folder / "benchmark.zip").stat().st_size
    return folder, results


@pytest.fixture(scope="module")
def archive(exported):
    return scorer.Archive(exported[0] / "benchmark.zip")


@pytest.fixture
def judged(archive, tmp_path):
    """Score displacements (n, 3) on a mesh of the archive, with what else the file has."""

    def judge(moved, mesh="coarse", problem="gravity", **arrays):
        with zipfile.ZipFile(archive.path) as file:
            file.extract(f"meshes/{mesh}.vtu", tmp_path)
        read = meshio.read(tmp_path / "meshes" / f"{mesh}.vtu")
        points = arrays.pop("points", read.points)
        arrays = {"displacement": moved} | arrays
        meshio.Mesh(points, read.cells, point_data=arrays).write(tmp_path / f"{problem}.vtu")
        return scorer.score(tmp_path / f"{problem}.vtu", archive)

    return judge


def area(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_finer_meshes_are_the_same_body_under_the_same_loads(study):
    coarse, medium, fine = study.bodies()
    for body in (medium, fine):
        count, children = len(coarse.vertices), 8**body.level
        assert np.array_equal(body.vertices[:count], coarse.vertices)
        mine = tet_volumes(body.vertices, body.tets).reshape(-1, children).sum(axis=1)
        assert mine == pytest.approx(tet_volumes(coarse.vertices, coarse.tets), rel=1e-12)
        for name in ("held", "skin", "patch"):
            assert area(body.vertices, getattr(body, name)) == pytest.approx(
                area(coarse.vertices, getattr(coarse, name))
            )
        for problem in ("gravity", "cheek"):
            loads = [each.scene(problem).loads().sum(axis=0) for each in (coarse, body)]
            assert np.abs(loads[0]).max() > 0 and loads[1] == pytest.approx(loads[0], abs=1e-9)
        # What is held moves linearly between the coarse mesh's vertices: a corner's children have it halved.
        assert np.array_equal(body.jaw[:count], coarse.jaw) and np.abs(coarse.jaw).max() > 1.0
        assert all(0.0 < body.shares[bone].max() <= 1.0 for bone in BONES)


def test_every_problem_has_a_limit_and_its_band(exported):
    folder, results = exported
    assert results.passed and {row.method for row in results.rows} == {*METHODS, "converged"}
    for row in results.rows[-len(PROBLEMS) :]:
        for line in row.values["answers"]:
            name = "FEniCSx, quadratic, medium"
            assert line["off"][name] <= line["band"], line["name"]
            assert line["size"] == pytest.approx(np.linalg.norm(line["value"]))
    content = json.loads((folder / "rows" / "results.json").read_text())
    assert content["rows"][-1]["method"] == "converged"


def test_a_stopped_export_goes_on_and_solves_nothing_twice(study, exported):
    folder, results = exported
    before = (folder / "rows" / "rows.jsonl").read_bytes()
    export(folder / "again.zip", study, folder / "rows", workers=1)
    assert (folder / "rows" / "rows.jsonl").read_bytes() == before
    names = [set(zipfile.ZipFile(folder / name).namelist()) for name in ("benchmark.zip", "again.zip")]
    meshes = {"meshes/coarse.vtu", "meshes/coarse.msh", "meshes/medium.vtu", "meshes/medium.msh", "meshes/fine.vtu"}
    assert names[0] == names[1] == meshes | {"README.md", "score.py", "benchmark.json", "answers.npz"}


def test_the_archive_says_what_is_asked(archive, study):
    with zipfile.ZipFile(archive.path) as file:
        card, msh = file.read("README.md").decode(), file.read("meshes/coarse.msh")
        vtu = file.read("meshes/medium.vtu")
    assert all(word in card for word in ("CC0", "Cite", "kPa", "score.py my-jaw.vtu", *PROBLEMS))
    gmsh = scorer.read_mesh("coarse.msh", msh)
    coarse, medium, _ = study.bodies()
    assert np.array_equal(gmsh.points, coarse.vertices) and np.array_equal(gmsh.cells[0].data, coarse.tets)
    assert np.array_equal(gmsh.cell_data["gmsh:physical"][0], coarse.layer + 1)
    mesh = scorer.read_mesh("medium.vtu", vtu)
    assert np.array_equal(mesh.point_data["held"] > 0, np.isin(np.arange(len(mesh.points)), medium.held_vertices))
    assert np.array_equal(mesh.point_data["force_gravity_mN"], medium.scene("gravity").loads())
    assert np.array_equal(mesh.point_data["force_cheek_mN"], medium.scene("cheek").loads())
    held = medium.held_vertices
    places = medium.scene("jaw").dirichlet()[1]
    assert mesh.point_data["held_displacement_jaw_mm"][held] == pytest.approx((places - medium.vertices)[held])


@pytest.mark.parametrize("problem", PROBLEMS)
def test_right_answers_are_right(archive, judged, problem):
    assert judged(archive.arrays[f"{problem}.converged"], problem=problem).verdict == "right"
    linear = archive.arrays[f"{problem}.linear.coarse"]
    score = judged(linear, problem=problem)
    assert score.verdict == "right on this mesh" and "linear tets' answer on it to 0 mm" in score.line
    assert "mm RMS from the converged answer" in score.line and "\n" not in score.line
    between = judged(0.5 * (linear + archive.arrays[f"{problem}.converged"]), problem=problem)
    assert between.verdict == "right" or "50 % of the way from linear tets' answer" in between.line


def test_a_solution_is_scored_with_its_stress_and_forces(archive, study, tmp_path):
    body = study.bodies()[1]
    scene = body.scene("growth")
    write_solution(tmp_path / "my-growth.vtu", scene, solve(scene, solver="skfem", tolerance=1e-8))
    score = scorer.score(tmp_path / "my-growth.vtu", archive)
    assert score.verdict.startswith("right") and "growth, medium mesh" in score.line
    asked = archive.problems["growth"]["quantities"]
    assert [each.name for each in score.compared] == list(asked) and {each.unit for each in score.compared} == {
        "mm", "kPa", "mN",
    }  # fmt: skip
    lines = scorer.describe_score(score)
    assert len(lines) == 1 + len(asked) and all("converged" in line for line in lines)
    (mandible,) = (each for each in score.compared if each.name == "force on mandible")
    solution = solve(scene, solver="fenicsx", tolerance=1e-9)
    force = np.linalg.norm(body.shares["mandible"] @ solution.reactions)
    assert mandible.value == pytest.approx(force, rel=1e-5)


FAULTS = {
    "wrong": (lambda u: -0.5 * u, "WRONG", "linear tets on this mesh are"),
    "zero": (lambda u: 0.0 * u, "WRONG", "every displacement is zero"),
    "metres": (lambda u: 1e-3 * u, "WRONG", "displacements are in metres; expected mm"),
    "centimetres": (lambda u: 0.1 * u, "WRONG", "in centimetres"),
    "shifted": (lambda u: u + [3.0, 0.0, -1.0], "SHIFTED", "as a whole by (3, "),
    "truncated": (lambda u: np.where(np.arange(len(u))[:, None] < 60, u, 0.0), "TRUNCATED", "from point 60 of 126 on"),
    "nan": (lambda u: np.where(np.arange(len(u))[:, None] == 7, np.nan, u), "NOT FINITE", "1 of 126"),
    "infinite": (lambda u: np.where(np.arange(len(u))[:, None] > 99, np.inf, u), "NOT FINITE", "26 of 126"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_told_apart_in_a_line(archive, judged, fault):
    change, verdict, words = FAULTS[fault]
    score = judged(change(archive.arrays["gravity.linear.coarse"]))
    assert f": {verdict}: " in score.line and words in score.line and "\n" not in score.line


def test_a_turned_answer_is_shifted(archive, judged):
    angle = np.radians(10.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    places = archive.arrays["points"]
    score = judged((places + archive.arrays["gravity.linear.coarse"]) @ turn.T - places)
    assert "SHIFTED" in score.line and "10 degrees" in score.line


def test_held_points_that_moved_are_told(archive, judged, study):
    moved = archive.arrays["gravity.linear.coarse"].copy()
    moved[study.bodies()[0].held_vertices] += 50.0
    assert "held points are up to 86.6 mm from where" in judged(moved).line


def test_what_cannot_be_scored_is_named(archive, judged, tmp_path):
    moved, points = archive.arrays["gravity.linear.coarse"], archive.arrays["points"]

    def told(act):
        with pytest.raises(scorer.AnswerError) as error:
            act()
        assert "\n" not in str(error.value)
        return str(error.value)

    assert told(lambda: judged(moved, points=1e-3 * points)) == "wrong unit: points are in metres; expected mm"
    assert "points are in another order" in told(lambda: judged(moved[::-1], points=points[::-1]))
    assert "wrong mesh: point " in told(lambda: judged(moved, points=points + moved))
    assert "expected shape (126, 3), got (126, 2)" in told(lambda: judged(moved[:, :2]))
    meshio.Mesh(points[:100], [("tetra", [[0, 1, 2, 3]])]).write(tmp_path / "gravity.vtu")
    assert "wrong mesh: 100 points; the benchmark's meshes have 126 (coarse)" in told(
        lambda: scorer.score(tmp_path / "gravity.vtu", archive)
    )
    meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]])], point_data={"u": moved}).write(tmp_path / "gravity.vtu")
    assert told(lambda: scorer.score(tmp_path / "gravity.vtu", archive)) == (
        "'displacement' [mm] is missing; arrays on points are: u"
    )
    whole = (tmp_path / "gravity.vtu").read_bytes()
    (tmp_path / "gravity.vtu").write_bytes(whole[: len(whole) // 2])
    assert "cannot be read; damaged, or cut short" in told(lambda: scorer.score(tmp_path / "gravity.vtu", archive))
    assert "names no problem of gravity, jaw" in told(lambda: scorer.score(tmp_path / "answer.vtu", archive))
    assert "problem 'twist': there are" in told(lambda: scorer.score(tmp_path / "gravity.vtu", archive, "twist"))
    assert "no archive of the face benchmark" in told(lambda: scorer.Archive(tmp_path / "gravity.vtu"))


WITHOUT = "import sys; sys.modules.update(dict.fromkeys(('dolfinx', 'skfem', 'petsc4py', 'ufl', 'felupe')));"


def test_the_command_scores_without_our_solvers(exported, judged, archive, tmp_path):
    judged(archive.arrays["gravity.linear.coarse"])
    code = WITHOUT + "from softdeca.cli import main; main()"
    words = ["bench", "score", tmp_path / "gravity.vtu", "--archive", archive.path]
    ended = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith("gravity, coarse mesh: RIGHT ON THIS MESH: ")
    assert "'cauchy' is missing: its quantities are not scored" in ended.stdout
    refused = subprocess.run([sys.executable, "-c", code, *words[:2], "x.vtu"], capture_output=True, text=True)
    assert refused.returncode == 1 and refused.stderr.count("\n") == 1 and "face-benchmark.zip" in refused.stderr


def test_the_archives_own_script_needs_numpy_and_meshio_alone(judged, archive, tmp_path):
    score = judged(archive.arrays["gravity.linear.coarse"] + 5.0)
    with zipfile.ZipFile(archive.path) as file:
        file.extractall(tmp_path / "benchmark")
    code = WITHOUT + "sys.modules.update(dict.fromkeys(('softdeca', 'scipy', 'numba')));"
    code += "import runpy; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    words = [tmp_path / "benchmark" / "score.py", tmp_path / "gravity.vtu"]
    ended = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert ended.returncode == 1, ended.stderr
    assert ended.stdout.splitlines()[0] == score.line and "SHIFTED" in score.line


def test_another_package_answers_from_the_files_alone(archive, tmp_path):
    pytest.importorskip("felupe")
    pytest.importorskip("pyamg")
    with zipfile.ZipFile(archive.path) as file:
        file.extractall(tmp_path)
    script = Path(__file__).parents[1] / "verification" / "face_by_felupe.py"
    code = "import sys, runpy; sys.modules['softdeca'] = None; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0])"
    for problem in PROBLEMS:
        words = [script, tmp_path, problem, "coarse", tmp_path / f"{problem}.vtu"]
        subprocess.run([sys.executable, "-c", code, *words], check=True, capture_output=True)
        score = scorer.score(tmp_path / f"{problem}.vtu", archive)
        assert "linear tets' answer on it to" in score.line and len(score.compared) == 16, score.line
