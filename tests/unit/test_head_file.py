"""A head through its file."""

import re
from dataclasses import replace

import numpy as np

from softdeca.lhm import InputError
from softdeca.lhm.expressions.rig import Rig
from softdeca.lhm.head.detail import Detail, count_fine_vertices
from softdeca.lhm.head.file import load_head, save_head
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


def test_a_file_of_something_else_or_of_an_earlier_version_is_named(tmp_path):
    np.savez(tmp_path / "other.npz", a=1)
    refused("other.npz: not a layered head", load_head, tmp_path / "other.npz")
    np.savez(tmp_path / "old.npz", format="softdeca layered head 1", bone=np.zeros(3))
    refused("old.npz: .*fit the head again by `softdeca head fit`", load_head, tmp_path / "old.npz")


def test_a_head_whose_bits_flip_or_whose_arrays_change_is_refused_or_the_same(tmp_path, sphere_head):
    """Each array has a checksum in the archive; its list of arrays has none, and may lose some, but for the file's."""
    path, rng = tmp_path / "head.npz", np.random.default_rng(0)
    save_head(path, replace(sphere_head, notes=("a note",), skull=sphere_head.skull_wrap))
    whole = path.read_bytes()
    flips = [(int(place), int(bit)) for place, bit in rng.integers((0, 0), (len(whole), 8), (200, 2))]
    for entry in re.finditer(rb"PK\x01\x02", whole):  # lengths of what follows an entry's name
        flips += [(entry.start() + place, bit) for place in range(30, 34) for bit in range(8)]
    for place, bit in flips:
        content = bytearray(whole)
        content[place] ^= 1 << bit
        path.write_bytes(content)
        try:
            again = load_head(path)
        except InputError:
            continue
        assert again.notes == ("a note",) and again.skull is not None, (place, bit)
        assert np.array_equal(again.vertices, sphere_head.vertices), (place, bit)
    path.write_bytes(whole)
    arrays = dict(np.load(path))
    for changed in ({"skin.vertices": arrays["skin.vertices"] + 1e-9}, {"bone": arrays["bone"].astype(np.int32)}):
        np.savez(path, **arrays | changed)
        refused("head.npz: damaged, its checksum is another; fit the head again", load_head, path)
    del arrays["skull.vertices"], arrays["skull.triangles"]
    np.savez(path, **arrays)
    refused("head.npz: damaged, its checksum is another", load_head, path)


def test_a_head_with_all_parts_survives_the_file(tmp_path, sphere_head):
    n, fine = len(sphere_head.skin.vertices), count_fine_vertices(sphere_head.skin)
    rig = Rig(np.random.default_rng(0).normal(size=(52, n, 3)), "made up", ("jawOpen",))
    detail = Detail(np.ones(fine, np.float32), np.ones((fine, 3), np.uint8))
    save_head(tmp_path / "head.npz", replace(sphere_head, rig=rig, detail=detail, notes=("one", "two")))
    again = load_head(tmp_path / "head.npz")
    assert (again.rig.source, again.rig.missing, again.notes) == (rig.source, rig.missing, ("one", "two"))
    assert np.array_equal(again.rig.deltas, rig.deltas) and again.detail.place is None
    assert np.array_equal(again.detail.heights, detail.heights) and again.detail.colours.dtype == np.uint8
    assert again.regions.keys() == sphere_head.regions.keys() and again.muscles is None
