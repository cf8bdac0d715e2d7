"""A scene that processes read from XDMF together: the answer of the whole one, a part in each, errors in one line."""

import pickle
import shutil
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("dolfinx")
pytest.importorskip("h5py")

import dolfinx
import h5py
from mpi4py import MPI

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.scaling.blocks import compare_blocks
from softdeca.benchmarks.studies.scaling.ranks import Ranks
from softdeca.lhm.base.errors import InputError, SceneError
from softdeca.reference import Scene, march, prepare, solve, terms, write_solution
from softdeca.reference.fenicsx import dolfinx_version as seam
from softdeca.reference.fenicsx import read_scene
from softdeca.reference.problems.meshes import box

from . import scenes_in_parts
from .scenes_in_parts import CASES, FIRM, LOW, SIDE, SOFT
from .test_fenicsx_mpi import ENVIRONMENT

needs_mpirun = pytest.mark.skipif(shutil.which("mpirun") is None, reason="mpirun is not installed")


def write_tagged(path):
    """A unit box whose lower half is soft, one face held and another one loaded, by DOLFINx."""
    X, tets = box((7, 6, 5))
    domain = seam.tet_mesh(X, tets, MPI.COMM_SELF)
    for pair in ((2, 3), (3, 2), (2, 0)):
        domain.topology.create_connectivity(*pair)
    low, side = (
        dolfinx.mesh.locate_entities_boundary(domain, 2, lambda x, c=c, at=at: np.isclose(x[c], at))
        for c, at in ((2, 0.0), (0, 1.0))
    )
    facets = np.concatenate([low, side]).astype(np.int32)
    tags, order = np.repeat(np.int32([LOW, SIDE]), [len(low), len(side)]), np.argsort(facets)
    on_facets = dolfinx.mesh.meshtags(domain, 2, facets[order], tags[order])
    height = X[seam.cell_vertices(domain), 2].mean(axis=1)
    every = np.arange(len(tets), dtype=np.int32)
    on_cells = dolfinx.mesh.meshtags(domain, 3, every, np.where(height < 0.5, SOFT, FIRM).astype(np.int32))
    on_facets.name, on_cells.name = "facets", "cells"
    with dolfinx.io.XDMFFile(MPI.COMM_SELF, str(path), "w") as file:
        file.write_mesh(domain)
        for found in (on_cells, on_facets):
            file.write_meshtags(found, *(() if seam.VERSION < (0, 7) else (domain.geometry,)))


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("parts") / "box.xdmf"
    write_tagged(path)
    return path


@pytest.fixture(scope="module")
def together(file):
    """What two processes find, by case, and the file of one answer."""
    out = file.parent / "answer"
    command = ["mpirun", "-n", "2", sys.executable, scenes_in_parts.__file__, file, out]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, cwd=file.parent)
    assert done.returncode == 0, done.stderr
    return pickle.loads(out.read_bytes()), out.with_suffix(".xdmf")


@needs_mpirun
@pytest.mark.parametrize("name", CASES)
def test_parts_give_the_answer_of_the_whole(name, file, together):
    acts, options = CASES[name]
    scene = read_scene(file, acts)
    alone = solve(Scene(scene.vertices, scene.tets, scene.terms), solver="fenicsx", tolerance=1e-12, **options)
    assert alone.converged
    by_part = solve(scene, solver="fenicsx", tolerance=1e-12, **options)
    positions, energy, reactions, stress, counts = together[0][name]
    moved = np.abs(alone.positions - scene.vertices).max()
    assert moved > 0.02
    assert np.abs(by_part.positions - alone.positions).max() <= 1e-10 * moved
    assert np.abs(positions - scene.whole(alone.positions)).max() <= 1e-10 * moved
    assert energy == pytest.approx(alone.energy, rel=1e-12)
    assert np.abs(reactions - scene.whole(alone.reactions)).max() <= 1e-9 * np.abs(alone.reactions).max()
    assert stress == pytest.approx(scene.volumes @ alone.von_mises, rel=1e-10)
    assert sum(tets for _, tets in counts) == len(scene.tets)
    assert max(tets for _, tets in counts) < 0.6 * len(scene.tets)
    assert max(vertices for vertices, _ in counts) < 0.75 * len(scene.vertices)


@needs_mpirun
def test_the_answer_is_written_by_all(file, together):
    assert len(read_scene(together[1], lambda part: [terms.Strain(1.0)]).tets) == 1260
    with h5py.File(together[1].with_suffix(".h5")) as data:
        displacement, J = (data[f"Function/{name}/0"][()] for name in ("displacement", "J"))
    positions = together[0]["skin and springs"][0]
    rest = read_scene(file, lambda part: [terms.Strain(1.0)])
    expected = np.abs(positions - rest.whole(rest.vertices)).max()
    assert np.abs(displacement).max() == pytest.approx(expected, rel=1e-12)
    assert len(J) == 1260 and J.min() > 0.5


def test_boundary_is_the_surface_seen_from_outside(file):
    part = read_scene(file, lambda part: [terms.Strain(1.0)]).part
    a, b, c = (part.vertices[part.boundary[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a) / 2.0
    assert np.abs(normal).sum() == pytest.approx(6.0)
    assert np.einsum("kc,kc->", normal, (a + b + c) / 3.0) == pytest.approx(3.0)  # three times the volume
    assert np.all(part.vertices[part.corners(part.boundary[part.boundary_tags == SIDE]), 0] == 1.0)
    assert np.all(part.vertices[part.tets[part.tags == SOFT], 2].mean(axis=1) < 0.5)


def test_what_cannot_be_had_in_parts_is_refused(file, tmp_path):
    def plain(part):
        return [terms.Strain(1.0), terms.Fixed(part.vertices[:, 2] < 1e-6)]

    scene = read_scene(file, plain)
    with pytest.raises(SceneError, match="solver 'projective' cannot take a scene that ranks have in parts"):
        solve(scene)
    with pytest.raises(InputError, match="its own method write"):
        write_solution(tmp_path / "answer.vtu", scene, solve(scene, solver="fenicsx"))
    with pytest.raises(SceneError, match="march: ranks have this scene in parts"):
        march(scene, time_step=1e-3, steps=1, density=1e-6)
    for term in (terms.RigidBody([0, 1, 2, 3]), terms.Bending([[0, 1, 2]], 1.0), terms.Inertia(1e-6, 1e-3)):
        bad = read_scene(file, lambda part, term=term: [terms.Strain(1.0), term])
        with pytest.raises(SceneError, match=f"cannot model {term.name} of a scene that ranks have in parts"):
            prepare(bad, solver="fenicsx")
    with pytest.raises(SceneError, match="nothing holds translation along x, .* rotation about z; hold it"):
        solve(read_scene(file, lambda part: [terms.Strain(1.0), terms.Gravity((1.0, 1.0, 1.0), 1.0)]), solver="fenicsx")


def test_files_that_are_none_are_refused(file, tmp_path):
    def nothing(part):
        return []

    with pytest.raises(InputError, match="gone.xdmf: No such file"):
        read_scene(tmp_path / "gone.xdmf", nothing)
    (tmp_path / "text.xdmf").write_text("tets")
    with pytest.raises(InputError, match="text.xdmf: no XDMF file"):
        read_scene(tmp_path / "text.xdmf", nothing)
    (tmp_path / "empty.xdmf").write_text("<Xdmf><Domain/></Xdmf>")
    with pytest.raises(InputError, match="empty.xdmf: no grid of tets"):
        read_scene(tmp_path / "empty.xdmf", nothing)
    (tmp_path / "alone.xdmf").write_bytes(file.read_bytes())  # without its HDF5
    with pytest.raises(InputError, match="alone.xdmf: "):
        read_scene(tmp_path / "alone.xdmf", nothing)
    scene = read_scene(file, lambda part: [terms.Strain(1.0)])
    with pytest.raises(InputError, match="expected .xdmf"):
        scene.write(tmp_path / "answer.vtu", None)
    with pytest.raises(InputError, match="no such folder"):
        scene.write(tmp_path / "none" / "answer.xdmf", None)


UNLIKE = """
import sys
from mpi4py import MPI
from softdeca.reference import terms
from softdeca.reference.fenicsx import read_scene
rank = MPI.COMM_WORLD.rank
read_scene(sys.argv[1], lambda part: [terms.Strain(1.0)] + rank * [terms.Volume(1.0)])
"""


@needs_mpirun
def test_unlike_terms_are_told_once(file, tmp_path):
    (tmp_path / "script.py").write_text(UNLIKE)
    command = ["mpirun", "-n", "2", sys.executable, "script.py", file]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 1 and done.stderr.count("terms: Strain on rank 0") == 1, done.stderr


@needs_mpirun
def test_the_study_of_parts_compares_answers_and_memory():
    rows = compare_blocks((1, 2), 4000, each=False)
    one, two = rows
    assert (one["processes"], two["processes"]) == (1, 2) and one["unknowns"] == two["unknowns"] == 3993
    assert one["off"] == 0.0 and two["off"] <= 1e-10
    assert min(line["peak_mb"] for line in rows) > min(line["empty_mb"] for line in rows) > 50.0
    row = Row("strong, 4000 unknowns", "FEniCSx", "done", "", {"rows": rows}, 1.0, None, 0.0, "")
    assert all(gate["passed"] for gate in Ranks().gates([row])) and "largest of 2 processes" in Ranks().words([row])
    two["off"] = 1e-9
    assert [gate["passed"] for gate in Ranks().gates([row])] == [False, True]


@pytest.mark.parametrize("unknowns", [(), ("few",), ("100",)])
def test_a_study_of_ranks_needs_sizes(unknowns):
    with pytest.raises(InputError, match="unknowns: expected 3000 or more each"):
        Ranks(unknowns=unknowns).tasks()
