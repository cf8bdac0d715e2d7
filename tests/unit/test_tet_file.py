"""Tagged tet meshes through files of other programs."""

import meshio
import numpy as np
import pytest

from softdeca.lhm.base.files.tet_file import FORMATS, TAG, write_tets
from softdeca.lhm.head.file import MUSCLE, SOFT, tets_from_head
from softdeca.lhm.head.remesh import refine_head


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_head_survives_each_format(tmp_path, sphere_head, suffix):
    written = tets_from_head(sphere_head, (2, 1))
    path = tmp_path / f"head{suffix}"
    write_tets(path, written)
    again = meshio.read(path, file_format=FORMATS[suffix])
    tags = again.cell_data_dict[TAG[suffix]]
    assert again.points == pytest.approx(written.mesh.vertices, abs=1e-12)
    assert np.array_equal(again.cells_dict["tetra"], written.mesh.tets) and np.array_equal(tags["tetra"], written.tags)
    triangles = again.cells_dict["triangle"]
    assert len(triangles) == sum(map(len, written.surfaces.values()))
    assert all(np.array_equal(triangles[tags["triangle"] == tag], t) for tag, t in written.surfaces.items())
    if suffix == ".msh":
        assert {int(tag): name for name, (tag, _) in again.field_data.items()} == written.names
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
    again = meshio.read(tmp_path / "finer.vtu")
    assert np.array_equal(again.cells_dict["tetra"], finer.tets)
    skull = again.cells_dict["triangle"][again.cell_data_dict["tag"]["triangle"] == 13]
    assert np.array_equal(again.points[skull], finer.skull_wrap.vertices[finer.skull_wrap.triangles])


def test_dolfinx_reads_its_tets_tags_and_surfaces(tmp_path, sphere_head):
    pytest.importorskip("dolfinx")
    from dolfinx.io import XDMFFile
    from mpi4py import MPI

    tagged = tets_from_head(sphere_head, (2, 1))
    write_tets(tmp_path / "head.xdmf", tagged)
    assert {path.name for path in tmp_path.iterdir()} == {"head.xdmf", "head.h5"}
    with XDMFFile(MPI.COMM_WORLD, str(tmp_path / "head.xdmf"), "r") as file:
        mesh = file.read_mesh()
        mesh.topology.create_connectivity(2, 3)
        tags, surfaces = file.read_meshtags(mesh, name="mesh"), file.read_meshtags(mesh, name="surfaces")
    assert np.array_equal(np.bincount(tags.values), np.bincount(tagged.tags))
    assert {tag: len(t) for tag, t in tagged.surfaces.items()} == {
        t: np.sum(surfaces.values == t) for t in (11, 12, 13)
    }
    corners = mesh.geometry.x[mesh.geometry.dofmap.array.reshape(-1, 4)]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    for tag in (SOFT, MUSCLE):
        expected = tagged.mesh.volumes[tagged.tags == tag].sum()
        assert volumes[tags.indices[tags.values == tag]].sum() == pytest.approx(expected)


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


def test_usd_has_tets_of_the_right_hand_their_boundary_and_tissues(tmp_path, sphere_head):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    tagged = tets_from_head(sphere_head, (2, 1))
    write_tets(tmp_path / "head.usda", tagged)
    stage = Usd.Stage.Open(str(tmp_path / "head.usda"))
    body = UsdGeom.TetMesh(stage.GetDefaultPrim())
    points = np.array(body.GetPointsAttr().Get()) / 1e-3 * UsdGeom.GetStageMetersPerUnit(stage)
    assert points == pytest.approx(tagged.mesh.vertices, abs=1e-4)
    assert np.array_equal(body.GetTetVertexIndicesAttr().Get(), tagged.mesh.tets)
    assert not UsdGeom.TetMesh.FindInvertedElements(body)
    faces = np.array(body.GetSurfaceFaceVertexIndicesAttr().Get())
    assert len(faces) == 2 * len(sphere_head.skin.triangles), "the outside and the hollow"
    tissues = {
        s.GetPrim().GetName(): np.array(s.GetIndicesAttr().Get()) for s in UsdGeom.Subset.GetAllGeomSubsets(body)
    }
    assert tissues.keys() == {"soft_tissue", "muscle"}
    assert np.array_equal(tissues["muscle"], np.flatnonzero(tagged.tags == MUSCLE))
