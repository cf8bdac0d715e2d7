"""VTKHDF, glTF and USD: what other programs read back is what was written."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from softdeca.lhm import Surface
from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.lhm.base.files.glb import write_glb
from softdeca.lhm.base.files.morphs import MorphedSurface, MorphRig, morph_take, reduce_to_morphs
from softdeca.lhm.base.files.moving_surface import write_vtkhdf
from softdeca.lhm.base.files.usd import write_usd

from ..refusals import refused
from ..rig_files import bake_usd, parse_glb, read_glb, read_usd

SPHERE = trimesh.creation.icosphere(2, radius=100)
SKIN = Surface(SPHERE.vertices, SPHERE.faces)
TIMES = 0.5 + np.arange(7) / 60


def moving(frames=7):
    """Displacements [mm] of rank 3: jaw, smile and a twist."""
    x, t = SKIN.vertices, np.arange(frames)[:, None, None] / 2
    shapes = [np.clip(-x[:, 1:2] / 20, 0, 5) * [0, -1, 0.2], x[:, :1] * [0.02, 0.01, 0], x[:, [1, 2, 0]] * 0.01]
    return sum(np.sin((k + 1) * t + k) * shape for k, shape in enumerate(shapes)).astype(np.float32)


def test_vtk_reads_every_step_back(tmp_path):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    frames = SKIN.vertices + moving()
    write_vtkhdf(tmp_path / "take.vtkhdf", SKIN.triangles, TIMES, frames)
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(tmp_path / "take.vtkhdf"))
    reader.UpdateInformation()
    steps = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert steps == pytest.approx(TIMES)
    for time, frame in zip(TIMES, frames, strict=True):
        reader.UpdateTimeStep(time)
        mesh = reader.GetOutputDataObject(0)
        assert mesh.GetNumberOfPolys() == len(SKIN.triangles)
        assert np.array_equal(vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3), SKIN.triangles)
        assert np.array_equal(vtk_to_numpy(mesh.GetPoints().GetData()), frame.astype(np.float32))


def test_vtkhdf_is_the_same_bytes_again(tmp_path):
    frames = SKIN.vertices + moving()
    for name in ("a", "b"):
        write_vtkhdf(tmp_path / name, SKIN.triangles, TIMES, iter(frames))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert not (tmp_path / "c").exists()


def morphed(motion, tolerance=0.01):
    found = reduce_to_morphs(motion, tolerance=tolerance)
    return found, morph_take("skin", SKIN, TIMES, found, found.weights)


def test_gltf_animates_the_motion_within_its_stated_error(tmp_path):
    motion = moving()
    found, rig = morphed(motion)
    write_glb(tmp_path / "take.glb", rig)
    content, array = parse_glb(tmp_path / "take.glb")
    (primitive,) = content["meshes"][0]["primitives"]
    sampler = content["animations"][0]["samplers"][0]
    assert array(sampler["input"]).ravel() == pytest.approx(TIMES - TIMES[0])
    weights = array(sampler["output"]).reshape(7, 3)
    surfaces, notes = read_glb(tmp_path / "take.glb")
    assert notes == {"greatest_error_mm": found.error} and found.error <= 0.01
    skin = surfaces["skin"]
    assert list(skin.offsets) == ["component 1", "component 2", "component 3"], "the motion is of rank 3"
    assert np.array_equal(skin.triangles, SKIN.triangles)
    for row, frame in zip(weights, SKIN.vertices + motion, strict=True):
        assert np.linalg.norm(skin.frame(row) - frame, axis=1).max() <= 0.0102
    normal = array(primitive["attributes"]["NORMAL"])
    turned = normal + np.tensordot(weights, [array(target["NORMAL"]) for target in primitive["targets"]], axes=1)
    for frame, normals in zip(SKIN.vertices + motion, turned, strict=True):
        exact = SKIN.with_vertices(frame).vertex_normals
        angles = np.einsum("ij,ij->i", exact, normals) / np.linalg.norm(normals, axis=1)
        assert angles.min() > np.cos(np.radians(6))
    loaded = trimesh.load(tmp_path / "take.glb", force="mesh", process=False)
    assert np.asarray(loaded.vertices) == pytest.approx(SKIN.vertices / 1000, abs=1e-7)
    assert np.array_equal(loaded.faces, SKIN.triangles)


def test_usd_animates_the_motion_within_its_stated_error(tmp_path):
    pytest.importorskip("pxr")
    motion = moving()
    found, rig = morphed(motion)
    write_usd(tmp_path / "take.usd", rig)
    names, times, frames = bake_usd(tmp_path / "take.usd")
    assert names == ["component_1", "component_2", "component_3"] and times == pytest.approx(TIMES - TIMES[0])
    assert np.linalg.norm(frames - SKIN.vertices - motion, axis=2).max() <= 0.0102
    surfaces, notes = read_usd(tmp_path / "take.usd")
    assert notes == {"generator": "softdeca", "greatest_error_mm": found.error}
    assert np.array_equal(surfaces["skin"].triangles, SKIN.triangles)


@pytest.mark.parametrize(("write", "read", "name"), [(write_glb, read_glb, "a.glb"), (write_usd, read_usd, "a.usda")])
def test_a_rig_without_a_take_has_its_surfaces_and_their_places(tmp_path, write, read, name):
    """One that stands still keeps its node's place and colours, one that moves its targets, also one of zeros."""
    targets = np.array([0.1 * SKIN.vertices, np.zeros_like(SKIN.vertices)])
    colours = np.abs(SKIN.vertices) / 100
    still = MorphedSurface.from_targets("ball", SKIN, targets[:0], colour=colours, place=(10.0, 20.0, -30.0))
    rig = MorphRig([MorphedSurface.from_targets("skin", SKIN, targets), still], ("jawOpen", "none"), {"mean": 0.25})
    write(tmp_path / name, rig)
    surfaces, notes = read(tmp_path / name)
    assert notes["mean"] == 0.25 and list(surfaces) == ["skin", "ball"]
    assert list(surfaces["skin"].offsets) == ["jawOpen", "none"] and surfaces["ball"].offsets == {}
    assert surfaces["skin"].frame([1.0, 1.0]) == pytest.approx(1.1 * SKIN.vertices, abs=1e-4)
    assert surfaces["ball"].frame([]) == pytest.approx(SKIN.vertices + [10.0, 20.0, -30.0], abs=1e-4)
    if name == "a.glb":
        content, array = parse_glb(tmp_path / name)
        assert "animations" not in content
        assert array(content["meshes"][1]["primitives"][0]["attributes"]["COLOR_0"]) == pytest.approx(colours)


def test_usd_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    rig = SimpleNamespace(notes={})
    refused(r"pip install 'softdeca\[usd\]'", write_usd, tmp_path / "a.usd", rig, error=MissingDependencyError)


def test_morphs_meet_their_bound_with_no_more_targets_than_frames():
    noise = np.random.default_rng(0).normal(size=(9, 40, 3)).astype(np.float32)
    for tolerance in (3.0, 1.0, 1e-3):
        found = reduce_to_morphs(noise, tolerance=tolerance)
        off = np.linalg.norm(np.tensordot(found.weights, found.targets, axes=1) - noise, axis=2).max()
        assert off <= tolerance and off == pytest.approx(found.error, rel=1e-2, abs=1e-5)
        assert found.weights.shape[1] <= 9
    limited = reduce_to_morphs(noise, tolerance=1e-3, most=2)
    assert limited.weights.shape[1] == 2 and limited.error > 1


def test_a_motion_that_is_none_is_a_still_head(tmp_path):
    found, rig = morphed(np.zeros((7, *SKIN.vertices.shape), np.float32))
    write_glb(tmp_path / "still.glb", rig)
    content, _ = parse_glb(tmp_path / "still.glb")
    assert found.error == 0 and "animations" not in content and "targets" not in content["meshes"][0]["primitives"][0]
