"""softdeca head mesh: the tets of a head in a file for other programs, with their shape."""

import json

import meshio
import numpy as np
import pytest

from softdeca.lhm.base.geometry.tets import tet_quality
from softdeca.lhm.head.file import save_head


@pytest.fixture
def file(tmp_path, sphere_head):
    save_head(tmp_path / "head.npz", sphere_head)
    return tmp_path / "head.npz"


def test_layers_are_written_and_their_shape_is_told(command, file, tmp_path, sphere_head):
    out = tmp_path / "head.vtu"
    ended = command("head", "mesh", file, "--layers", "2,3", "--out", out, "--json")
    assert ended.status == 0
    told, read = json.loads(ended.out), meshio.read(out)
    tags = read.cell_data_dict["tag"]["tetra"]
    assert told["vertices"] == len(read.points) == 6 * len(sphere_head.bone)
    for tag, name, layers in ((1, "soft_tissue", 2), (2, "muscle", 3)):
        row = told["tissues"][name]
        assert row["tag"] == tag and row["tets"] == 960 * layers == np.count_nonzero(tags == tag)
        own = getattr(sphere_head, "soft" if tag == 1 else "muscle")
        assert row["volume"] == pytest.approx(own.volumes.sum())
    ended = command("head", "mesh", file, "--out", out)
    assert "soft tissue, tets: 960" in ended.out and str(out) in ended.out


def test_a_size_makes_free_tets(command, file, tmp_path):
    pytest.importorskip("gmsh", reason="gmsh is not installed", exc_type=(ImportError, OSError))
    ended = command("head", "mesh", file, "--size", 20, "--out", tmp_path / "head.msh")
    assert ended.status == 0 and "muscle, smallest dihedral" in ended.out
    assert {"soft_tissue", "skull"} <= meshio.read(tmp_path / "head.msh").field_data.keys()


def test_a_regular_tet_is_measured():
    # Edges of 2 sqrt 2: dihedral arccos(1/3) = 70.53°, aspect sqrt(3/2), volume 8/3.
    x = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    quality = tet_quality(x, np.array([[0, 2, 1, 3]]))
    assert quality.volume == pytest.approx(8 / 3) and quality.smallest_dihedral == pytest.approx(70.5287794)
    assert quality.aspect_max == pytest.approx(np.sqrt(1.5))
