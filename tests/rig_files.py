"""Rigs as other programs read them: glTF by its specification, USD by UsdSkel."""

import json
import struct
from dataclasses import dataclass

import numpy as np
import pytest


@dataclass
class Read:
    """A surface of a file [mm]: place of its node, points from there, triangles, and offsets by the target's name."""

    place: np.ndarray
    points: np.ndarray
    triangles: np.ndarray
    offsets: dict[str, np.ndarray]

    def frame(self, weights):
        """Its points under weights of the targets, in their order."""
        moved = sum(w * offsets for w, offsets in zip(weights, self.offsets.values(), strict=True))
        return self.place + self.points + moved


def parse_glb(path):
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


def read_glb(path):
    """Surfaces of a .glb by the names of their nodes, below the one node of its scene; and its notes."""
    content, array = parse_glb(path)
    (root,) = content["scenes"][0]["nodes"]
    surfaces = {}
    for node in (content["nodes"][k] for k in content["nodes"][root]["children"]):
        mesh = content["meshes"][node["mesh"]]
        (primitive,) = mesh["primitives"]
        names = mesh.get("extras", {}).get("targetNames", [])
        offsets = [1e3 * array(target["POSITION"]) for target in primitive.get("targets", [])]
        surfaces[node["name"]] = Read(
            1e3 * np.array(node["translation"]),
            1e3 * array(primitive["attributes"]["POSITION"]),
            array(primitive["indices"]).reshape(-1, 3),
            dict(zip(names, offsets, strict=True)),
        )
    return surfaces, content["asset"]["extras"]


def read_usd(path):
    """Surfaces of a USD file by their prims' names, with the targets of UsdSkel's queries; and its notes."""
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    root = stage.GetDefaultPrim()
    assert root.IsA(UsdSkel.Root) and UsdGeom.GetStageUpAxis(stage) == "Y"
    unit, surfaces = 1e3 * UsdGeom.GetStageMetersPerUnit(stage), {}
    for mesh in (UsdGeom.Mesh(prim) for prim in root.GetChildren() if prim.IsA(UsdGeom.Mesh)):
        bound = UsdSkel.BindingAPI(mesh.GetPrim())
        names = bound.GetBlendShapesAttr().Get() or []
        query = UsdSkel.BlendShapeQuery(bound)
        shapes = [query.GetBlendShape(k) for k in range(query.GetNumBlendShapes())]
        place = mesh.ComputeLocalToWorldTransform(Usd.TimeCode.Default()).ExtractTranslation()
        surfaces[mesh.GetPrim().GetName()] = Read(
            unit * np.array(place),
            unit * np.array(mesh.GetPointsAttr().Get()),
            np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3),
            {name: unit * np.array(shape.GetOffsetsAttr().Get()) for name, shape in zip(names, shapes, strict=True)},
        )
    return surfaces, stage.GetRootLayer().customLayerData


def bake_usd(path, weights=None):
    """Names of the targets, times [s], and frames (k, n, 3) [mm] of the skin as UsdSkel itself deforms it.

    weights (t,): of the one frame, in place of those in the file.
    """
    from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.Open(str(path))
    animation, root = UsdSkel.Animation(stage.GetPrimAtPath("/head/animation")), UsdSkel.Root(stage.GetDefaultPrim())
    if weights is not None:
        animation.GetBlendShapeWeightsAttr().Set(Vt.FloatArray.FromNumpy(np.asarray(weights, dtype=np.float32)))
    codes = animation.GetBlendShapeWeightsAttr().GetTimeSamples() or [Usd.TimeCode.Default()]
    assert UsdSkel.BakeSkinning(root, Gf.Interval.GetFullInterval())
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/head/skin")).GetPointsAttr()
    frames = 1e3 * np.array([points.Get(code) for code in codes])
    times = [] if weights is not None else np.array(codes) / stage.GetTimeCodesPerSecond()
    return list(animation.GetBlendShapesAttr().Get()), times, frames
