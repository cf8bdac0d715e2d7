"""Tagged tet meshes through files of other programs."""

import meshio
import numpy as np
import pytest

from softdeca.lhm import MeshError, TetMesh
from softdeca.lhm.base.files.tet_file import TaggedTets, read_tets, write_tets
from softdeca.lhm.head.file import MUSCLE, SOFT, tets_from_head
from softdeca.lhm.head.remesh import refine_head

from ..refusals import refused

SUFFIXES = [".msh", ".vtu", ".xdmf", ".mesh"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_head_survives_each_format(tmp_path, sphere_head, suffix):
    written = tets_from_head(sphere_head, (2, 1))
    path = tmp_path / f"head{suffix}"
    write_tets(path, written)
    again = read_tets(path)
    assert again.mesh.vertices == pytest.approx(written.mesh.vertices, abs=1e-12)
    assert np.array_equal(again.mesh.tets, written.mesh.tets) and np.array_equal(again.tags, written.tags)
    assert {tag: len(t) for tag, t in again.surfaces.items()} == {tag: len(t) for tag, t in written.surfaces.items()}
    assert all(np.array_equal(again.surfaces[tag], t) for tag, t in written.surfaces.items())
    if suffix == ".msh":
        assert again.names == written.names
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("layers", [(1, 1), (2, 3)])
def test_the_named_surfaces_are_the_wraps(sphere_head, layers):
    tagged = tets_from_head(sphere_head, layers)
    by_name = {name: tag for tag, name in tagged.names.items()}
    for name, wrap in (("skin", "skin_wrap"), ("muscle_wrap", "muscle_wrap"), ("skull", "skull_wrap")):
        corners = tagged.mesh.vertices[tagged.surfaces[by_name[name]]]
        surface = getattr(sphere_head, wrap)
        assert np.array_equal(corners, surface.vertices[surface.triangles])
    soft = tagged.mesh.volumes[tagged.tags == SOFT].sum()
    assert soft == pytest.approx(sphere_head.soft.volumes.sum())
    assert np.count_nonzero(tagged.tags == MUSCLE) == layers[1] * len(sphere_head.muscle.tets)


def test_a_volume_mesh_is_written_as_it_is(tmp_path, spheres):
    finer = refine_head(spheres(1))
    write_tets(tmp_path / "finer.vtu", tets_from_head(finer))
    again = read_tets(tmp_path / "finer.vtu")
    assert np.array_equal(again.mesh.tets, finer.tets)
    assert np.array_equal(
        again.mesh.vertices[again.surfaces[13]], finer.skull_wrap.vertices[finer.skull_wrap.triangles]
    )
    refused("volume mesh", tets_from_head, finer, (2, 1), error=MeshError)


def a_tet():
    return np.vstack([np.zeros(3), 10.0 * np.eye(3)]), np.array([[0, 1, 2, 3]])


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0)])
def test_the_unit_is_the_files(tmp_path, unit, factor):
    x, tets = a_tet()
    write_tets(tmp_path / "one.vtu", TaggedTets(TetMesh(x / factor, tets), np.array([7])))
    read = read_tets(tmp_path / "one.vtu", unit=unit)
    assert read.mesh.vertices == pytest.approx(x) and read.tags.tolist() == [7]


def broken(name):
    x, tets = a_tet()
    if name == "nan":
        x[2, 1] = np.nan
    if name == "inverted":
        tets = np.array([[0, 1, 2, 3], [0, 2, 1, 3]])
    if name == "huge":
        x = x * 1e6
    if name == "tiny":
        x = x * 1e-6
    if name == "triangles":
        return meshio.Mesh(x, [("triangle", tets[:, :3])])
    return meshio.Mesh(x, [("tetra", tets)])


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nan", "not finite"),
        ("inverted", "1 are inverted or flat, the first is number 1"),
        ("huge", "is the unit wrong"),
        ("tiny", "is the unit wrong"),
        ("triangles", "no tets .* it has triangle"),
    ],
)
@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_what_is_wrong_is_told_in_a_line(tmp_path, name, told, suffix):
    path = tmp_path / f"{name}{suffix}"
    broken(name).write(path, **({"file_format": "gmsh22"} if suffix == ".msh" else {}))
    assert str(path) in refused(told, read_tets, path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"nothing of the kind\n", bytes(range(256))])
def test_a_file_of_something_else_is_told(tmp_path, capsys, suffix, content):
    path = tmp_path / f"other{suffix}"
    path.write_bytes(content)
    refused("other", read_tets, path)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("form", ["HDF", "Binary"])
def test_an_xdmf_file_opens_no_other(tmp_path, form):
    path = tmp_path / "head.xdmf"
    broken("").write(path, data_format=form)
    for name in ("head.h5", "head0.bin", "head1.bin"):
        (tmp_path / name).unlink(missing_ok=True)
    refused(f"head.xdmf: its numbers are of Format '{form}'; expected 'XML'", read_tets, path)


def test_missing_and_unknown_files_are_told(tmp_path, sphere_head):
    refused("no such file", read_tets, tmp_path / "none.msh")
    refused("expected one of .msh, .vtu", write_tets, tmp_path / "head.stl", tets_from_head(sphere_head))
    refused("unit 'inch'", read_tets, tmp_path / "none.msh", unit="inch")


def test_a_truncated_file_is_told(tmp_path, sphere_head):
    for suffix in SUFFIXES:
        path = tmp_path / f"half{suffix}"
        write_tets(path, tets_from_head(sphere_head))
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        refused("half", read_tets, path)


def test_gmsh_reads_it_with_its_names(tmp_path, sphere_head):
    gmsh = pytest.importorskip("gmsh", reason="gmsh is not installed", exc_type=(ImportError, OSError))
    write_tets(tmp_path / "head.msh", tets_from_head(sphere_head))
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "head.msh"))
        groups = {gmsh.model.getPhysicalName(*group): group for group in gmsh.model.getPhysicalGroups()}
        assert set(groups) == {"soft_tissue", "muscle", "skin", "muscle_wrap", "skull"}
        assert groups["skull"][0] == 2 and groups["muscle"][0] == 3
        (volume,) = gmsh.model.getEntitiesForPhysicalGroup(*groups["muscle"])
        assert len(gmsh.model.mesh.getElementsByType(4, volume)[0]) == len(sphere_head.muscle.tets)
    finally:
        gmsh.finalize()
