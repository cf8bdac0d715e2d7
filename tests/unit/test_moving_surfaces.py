"""VTKHDF and glTF: what other programs read back is what was written."""

import json
import struct

import numpy as np
import pytest
import trimesh

from softdeca.lhm import Surface
from softdeca.lhm.base.files.moving_surface import reduce_to_morphs, write_gltf, write_vtkhdf

from ..refusals import refused

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


def test_vtkhdf_is_the_same_bytes_again_and_refuses_what_does_not_fit(tmp_path):
    frames = SKIN.vertices + moving()
    for name in ("a", "b"):
        write_vtkhdf(tmp_path / name, SKIN.triangles, TIMES, iter(frames))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    for bad, message in (
        (frames[:5], "5 frames for 7 times"),
        ([*frames, frames[0]], "frame 7"),
        ([frames[0], frames[1][:9]], r"frame 1 of shape \(9, 3\)"),
        ([], "0 frames"),
    ):
        refused(message, write_vtkhdf, tmp_path / "c", SKIN.triangles, TIMES, bad)
    assert not (tmp_path / "c").exists()


def parsed(path):
    """The JSON of a .glb, and a function from an accessor's number to its array, by the specification alone."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    size, kind = struct.unpack_from("<I4s", data, 12)
    content = json.loads(data[20 : 20 + size])
    rest, rest_kind = struct.unpack_from("<I4s", data, 20 + size)
    assert (magic, version, length, kind, rest_kind) == (b"glTF", 2, len(data), b"JSON", b"BIN\0")
    binary = data[28 + size : 28 + size + rest]

    def array(number):
        accessor = content["accessors"][number]
        view = content["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        values = np.frombuffer(binary, kind, view["byteLength"] // 4, view["byteOffset"])
        values = values.reshape(accessor["count"], -1)
        assert values.min(axis=0) == pytest.approx(accessor["min"]) and values.max(axis=0) == pytest.approx(
            accessor["max"]
        )
        return values

    return content, array


def test_gltf_animates_the_motion_within_its_stated_error(tmp_path):
    motion = moving()
    found = write_gltf(tmp_path / "take.glb", SKIN, TIMES, motion, tolerance=0.01)
    content, array = parsed(tmp_path / "take.glb")
    primitive = content["meshes"][0]["primitives"][0]
    assert np.array_equal(array(primitive["indices"]).reshape(-1, 3), SKIN.triangles)
    sampler = content["animations"][0]["samplers"][0]
    assert array(sampler["input"]).ravel() == pytest.approx(TIMES - TIMES[0])
    assert len(primitive["targets"]) == 3, "the motion is of rank 3"
    weights = array(sampler["output"]).reshape(7, 3)
    neutral, normal = array(primitive["attributes"]["POSITION"]), array(primitive["attributes"]["NORMAL"])
    targets = np.array([array(target["POSITION"]) for target in primitive["targets"]])
    played = 1000 * (neutral + np.tensordot(weights, targets, axes=1))
    off = np.linalg.norm(played - (SKIN.vertices + motion), axis=2).max()
    assert off <= 0.0102 and found.error <= 0.01
    assert content["meshes"][0]["extras"] == {"greatest_error_mm": found.error, "morph_targets": 3}
    turned = normal + np.tensordot(weights, [array(target["NORMAL"]) for target in primitive["targets"]], axes=1)
    for frame, normals in zip(SKIN.vertices + motion, turned, strict=True):
        exact = SKIN.with_vertices(frame).vertex_normals
        angles = np.einsum("ij,ij->i", exact, normals) / np.linalg.norm(normals, axis=1)
        assert angles.min() > np.cos(np.radians(6))
    loaded = trimesh.load(tmp_path / "take.glb", force="mesh", process=False)
    assert np.asarray(loaded.vertices) == pytest.approx(SKIN.vertices / 1000, abs=1e-7)
    assert np.array_equal(loaded.faces, SKIN.triangles)


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
    write_gltf(tmp_path / "still.glb", SKIN, TIMES, np.zeros((7, *SKIN.vertices.shape), np.float32))
    content, _ = parsed(tmp_path / "still.glb")
    assert "animations" not in content and "targets" not in content["meshes"][0]["primitives"][0]
    refused("motion of shape", write_gltf, tmp_path / "bad.glb", SKIN, TIMES, np.zeros((3, 5, 3), np.float32))
