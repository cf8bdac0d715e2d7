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
from softdeca.benchmarks.studies.mesh.face import RUNS, tabulate_answers
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.reference import solve
from softdeca.reference.solution import write_solution

pytest.importorskip("dolfinx")

pytestmark = pytest.mark.usefixtures("measured_here")


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import sphere_studies

    yield sphere_studies.SphereFaceBenchmark()
    sys.path.remove(str(Path(__file__).parents[1]))


@pytest.fixture(scope="module")
def exported(study, tmp_path_factory):
    """The archive's folder, and the results. 24 s of processor: FEniCSx answers four problems on three meshes."""
    folder = tmp_path_factory.mktemp("face")
    results, size = export(folder / "benchmark.zip", study, folder / "rows")
    assert size == (folder / "benchmark.zip").stat().st_size
    return folder, results


@pytest.fixture(scope="module")
def archive(exported):
    return scorer.Archive(exported[0] / "benchmark.zip")


@pytest.fixture
def judged(archive, tmp_path):
    """Score displacements (n, 3) on a mesh of the archive, with what else the file has."""

    def judge(moved, mesh="coarse", problem="gravity", suffix=".vtu", cells=None, cauchy=None, **arrays):
        with zipfile.ZipFile(archive.path) as file:
            file.extract(f"meshes/{mesh}.vtu", tmp_path)
        read = meshio.read(tmp_path / "meshes" / f"{mesh}.vtu")
        points = arrays.pop("points", read.points)
        arrays = {"displacement": moved} | arrays
        cells = read.cells if cells is None else cells
        on_cells = {} if cauchy is None else {"cauchy": cauchy}
        answer = tmp_path / f"{problem}{suffix}"
        kind = "gmsh22" if suffix == ".msh" else None
        meshio.Mesh(points, cells, point_data=arrays, cell_data=on_cells).write(answer, file_format=kind)
        return scorer.score(answer, archive)

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
        # Held points move linearly between the coarse mesh's vertices: a corner's children have it halved.
        assert np.array_equal(body.jaw[:count], coarse.jaw) and np.abs(coarse.jaw).max() > 1.0
        assert all(0.0 < body.shares[bone].max() <= 1.0 for bone in BONES)


def test_every_problem_has_a_limit_and_its_band(exported):
    folder, results = exported
    assert results.passed and {row.method for row in results.rows} == {*RUNS, "converged"}
    for row in results.rows[-len(PROBLEMS) :]:
        for line in row.values["answers"]:
            name = "FEniCSx, quadratic, fine"
            assert line["off"][name] <= line["band"], line["name"]
            assert line["size"] == pytest.approx(np.linalg.norm(line["value"]))
    content = json.loads((folder / "rows" / "results.json").read_text())
    assert content["rows"][-1]["method"] == "converged"


def test_a_stopped_export_goes_on_and_solves_nothing_twice(study, exported):
    folder, results = exported
    before = (folder / "rows" / "rows.jsonl").read_bytes()
    export(folder / "again.zip", study, folder / "rows")
    assert (folder / "rows" / "rows.jsonl").read_bytes() == before
    export(folder / "small.zip", study, folder / "rows", small=True)
    assert list(scorer.Archive(folder / "small.zip").description["meshes"]) == ["coarse", "medium"]
    names = [set(zipfile.ZipFile(folder / name).namelist()) for name in ("benchmark.zip", "again.zip")]
    meshes = {"meshes/coarse.vtu", "meshes/medium.vtu", "meshes/fine.vtu"}
    texts = {"README.md", "score.py", "benchmark.json", "SHA256SUMS"}
    assert names[0] == names[1] == meshes | texts | {"answers.npz"}


def test_the_archive_says_what_is_asked(archive, study, tmp_path):
    with zipfile.ZipFile(archive.path) as file:
        card, vtu = file.read("README.md").decode(), file.read("meshes/medium.vtu")
    assert all(word in card for word in ("CC0", "Cite", "kPa", "score.py my-jaw.vtu", *PROBLEMS))
    assert "{" not in card and "| gravity | skin, mean [mm] |" in card
    (tmp_path / "medium.vtu").write_bytes(vtu)
    _, medium, _ = study.bodies()
    mesh = scorer.read_mesh(tmp_path / "medium.vtu")
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
    "truncated": (lambda u: np.where(np.arange(len(u))[:, None] < 30, u, 0.0), "TRUNCATED", "from point 30 of 75 on"),
    "nan": (lambda u: np.where(np.arange(len(u))[:, None] == 7, np.nan, u), "NOT FINITE", "1 of 75"),
    "infinite": (lambda u: np.where(np.arange(len(u))[:, None] > 59, np.inf, u), "NOT FINITE", "15 of 75"),
}


@pytest.mark.parametrize("problem", PROBLEMS)
def test_right_answers_of_finer_meshes_are_right(exported, archive, judged, study, problem):
    for mesh, body in zip(("medium", "fine"), study.bodies()[1:], strict=True):
        linear = archive.arrays[f"{problem}.linear.{mesh}"]
        assert judged(linear, mesh, problem).verdict.startswith("right")
        # A little off all over, as another code's answer is.
        free = np.setdiff1d(np.arange(len(linear)), body.held_vertices)
        linear[free] *= 1.005
        assert judged(linear, mesh, problem).verdict.startswith("right")
        linear[free] /= 1.005
    for mesh, verdict in (("medium", "right on this mesh"), ("fine", "right")):
        (row,) = (r for r in exported[1].rows if (r.case, r.method) == (problem, f"FEniCSx, quadratic, {mesh}"))
        better = np.load(exported[0] / "rows" / row.values["displacement"])
        assert judged(better, mesh, problem).verdict in (verdict, "right")


def is_new(moved):
    """Mark the points (n, 1) that refinement added."""
    return (np.arange(len(moved)) >= 75)[:, None]


FINER_FAULTS = {
    "added points at zero": lambda u: np.where(is_new(u), 0.0, u),
    "every other added point at zero": lambda u: np.where(is_new(u) & (np.arange(len(u)) % 2 == 0)[:, None], 0.0, u),
    "added points in another order": lambda u: np.concatenate([u[:75], u[75:][::-1]]),
    "added points far off": lambda u: np.where(is_new(u), 999.0, u),
    "one added point off": lambda u: np.where((np.arange(len(u)) == 400)[:, None], u + 20.0, u),
}


@pytest.mark.parametrize(("problem", "mesh"), [("gravity", "medium"), ("jaw", "fine")])
@pytest.mark.parametrize("fault", FINER_FAULTS)
def test_points_that_refinement_added_are_judged(archive, judged, problem, mesh, fault):
    linear, limit = archive.arrays[f"{problem}.linear.{mesh}"], archive.arrays[f"{problem}.converged"]
    for moved in (linear, np.concatenate([limit, linear[75:]])):
        score = judged(FINER_FAULTS[fault](moved), mesh, problem)
        assert score.verdict == "truncated" or "points that refinement added are" in score.line, score.line
        assert score.verdict in ("wrong", "truncated")


def test_no_single_point_may_be_far_off(archive, judged, study):
    limit, held = archive.arrays["gravity.converged"], study.bodies()[0].held_vertices
    moved = limit.copy()
    moved[held[0]] += [2.0, 0.0, 0.0]
    score = judged(moved)
    assert score.verdict == "wrong" and "held points are up to 2 mm from where they are held" in score.line
    moved = limit.copy()
    moved[np.setdiff1d(np.arange(75), held)[0]] += [6.0, 0.0, 0.0]
    assert judged(moved).verdict == "wrong"


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_other_kinds_of_files_are_read(archive, judged, suffix):
    stress = [np.ones((216, 9 if suffix == ".msh" else 6))]
    score = judged(archive.arrays["jaw.converged"].astype(np.float32), problem="jaw", suffix=suffix, cauchy=stress)
    assert score.verdict == "right" and "stress" in " ".join(each.name for each in score.compared)


def test_turned_corners_and_cells_beside_the_tets_are_accepted(archive, judged, study):
    tets = study.bodies()[0].tets
    cells = [("tetra", tets[:7, [1, 2, 0, 3]]), ("triangle", tets[:5, :3]), ("tetra", tets[7:, [1, 0, 3, 2]])]
    stress = [np.ones((7, 9)), np.full((5, 9), np.nan), np.ones((209, 9))]
    score = judged(archive.arrays["gravity.converged"], cells=cells, cauchy=stress)
    assert score.verdict == "right" and "stress" in " ".join(each.name for each in score.compared)


@pytest.mark.parametrize("changed", ["benchmark.json", "answers.npz", "meshes/coarse.vtu"])
def test_an_archive_is_what_its_checksums_say(archive, judged, tmp_path, changed):
    judged(archive.arrays["gravity.converged"])
    with zipfile.ZipFile(archive.path) as file, zipfile.ZipFile(tmp_path / "other.zip", "w") as other:
        for name in file.namelist():
            other.writestr(name, file.read(name) + b" " * (name == changed))
    with pytest.raises(scorer.AnswerError, match=f"{changed}: its checksum differs"):
        scorer.score(tmp_path / "gravity.vtu", scorer.Archive(tmp_path / "other.zip"))


def test_the_repositorys_archive_scores_right_answers(tmp_path, command):
    """As a fresh clone has it; its values are those of the kept result."""
    archive = scorer.Archive(scorer.ARCHIVE)
    assert scorer.ARCHIVE.stat().st_size < 4e6 and list(archive.description["meshes"]) == ["coarse", "medium"]
    kept = json.loads((scorer.ARCHIVE.parents[1] / "results" / "face-benchmark.json").read_text())
    for row in (row for row in kept["rows"] if row["method"] == "converged"):
        asked = archive.problems[row["case"]]["quantities"]
        for line in row["values"]["answers"]:
            assert asked[line["name"]]["value"] == pytest.approx(line["value"], abs=0.1 * line["band"])
    with zipfile.ZipFile(scorer.ARCHIVE) as file:
        file.extractall(tmp_path)
    for mesh, moved in (("coarse", "jaw.converged"), ("medium", "jaw.linear.medium")):
        read = meshio.read(tmp_path / "meshes" / f"{mesh}.vtu")
        read.point_data = {"displacement": archive.arrays[moved]}
        read.write(tmp_path / f"{mesh}-jaw.vtu")
        ended = command("bench", "score", tmp_path / f"{mesh}-jaw.vtu")
        assert ended.status == 0 and ended.out.startswith(f"jaw, {mesh} mesh: RIGHT"), ended


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_told_apart_in_a_line(archive, judged, fault):
    change, verdict, words = FAULTS[fault]
    for truth in ("gravity.linear.coarse", "gravity.converged"):
        score = judged(change(archive.arrays[truth]))
        assert f": {verdict}: " in score.line and words in score.line and "\n" not in score.line


def test_a_turned_answer_is_shifted(archive, judged):
    angle = np.radians(10.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    places = archive.arrays["points"]
    score = judged((places + archive.arrays["gravity.linear.coarse"]) @ turn.T - places)
    assert "SHIFTED" in score.line and "10 degrees" in score.line


WITHOUT = "import sys; sys.modules.update(dict.fromkeys(('dolfinx', 'skfem', 'petsc4py', 'ufl', 'felupe')));"


def test_the_command_scores_without_our_solvers(exported, judged, archive, tmp_path):
    judged(archive.arrays["gravity.linear.coarse"])
    code = WITHOUT + "from softdeca.cli import main; main()"
    words = ["bench", "score", tmp_path / "gravity.vtu", "--archive", archive.path]
    ended = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith("gravity, coarse mesh: RIGHT ON THIS MESH: ")
    assert "'cauchy' is missing: its quantities are not scored" in ended.stdout
    ended = subprocess.run([sys.executable, "-c", code, *words, "--json"], capture_output=True, text=True)
    (tmp_path / "somebody.json").write_text(ended.stdout)
    ((name, version, where, verdict, within, _),) = tabulate_answers(tmp_path).rows
    assert (name, version, where, verdict) == ("somebody", 2, "gravity, coarse mesh", "right on this mesh")
    assert within.endswith("of 10")
    ended = subprocess.run([sys.executable, "-c", code, *words[:2], "x.vtu"], capture_output=True, text=True)
    assert ended.returncode == 1 and ended.stderr.count("\n") == 1 and "x.vtu" in ended.stderr


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
    """FElupe answers every problem on the coarse mesh without this package."""
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
