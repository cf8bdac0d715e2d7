"""A head through its file, and as VTK."""

import meshio
import numpy as np

from softdeca.lhm.head.file import export_vtk, load_head, save_head
from softdeca.lhm.head.remesh import refine_head

from ..refusals import refused


def test_a_head_survives_the_file(tmp_path, sphere_head):
    save_head(tmp_path / "head.npz", sphere_head)
    again = load_head(tmp_path / "head.npz")
    assert np.array_equal(again.vertices, sphere_head.vertices)
    assert np.array_equal(again.tets, sphere_head.tets)
    assert np.array_equal(again.bone, sphere_head.bone)
    assert (again.wrap_from_skin != sphere_head.wrap_from_skin).nnz == 0
    assert [p.name for p in tmp_path.iterdir()] == ["head.npz"]


def test_a_volume_mesh_survives_the_file(tmp_path, spheres):
    finer = refine_head(spheres(1))
    save_head(tmp_path / "head.npz", finer)
    again = load_head(tmp_path / "head.npz")
    assert again.volume is not None and len(again.vertices) > 3 * len(again.bone)
    assert np.array_equal(again.vertices, finer.vertices)
    assert np.array_equal(again.soft.tets, finer.soft.tets) and np.array_equal(again.muscle.tets, finer.muscle.tets)


def test_a_file_of_something_else_is_named(tmp_path):
    np.savez(tmp_path / "other.npz", a=1)
    refused("other.npz: not a layered head", load_head, tmp_path / "other.npz")


def test_vtk_holds_the_tets_and_their_layers(tmp_path, sphere_head):
    files = export_vtk(tmp_path, sphere_head)
    tissue = meshio.read(next(f for f in files if f.name == "tissue.vtu"))
    assert np.array_equal(tissue.cells_dict["tetra"], sphere_head.tets)
    assert tissue.cell_data_dict["layer"]["tetra"].sum() == len(sphere_head.muscle.tets)
