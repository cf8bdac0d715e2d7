"""USD (.usd, .usdc or .usda, metres): a rig as UsdSkel's blend shapes and the take that it plays, or a tet mesh."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InputError, MissingDependencyError
from ..mesh import Ints, TetMesh
from .atomic import replaced
from .morphs import MorphedSurface, MorphRig

METRES = 1e-3
ROOT = "/head"


def check_usd() -> None:
    """Raise MissingDependencyError without usd-core."""
    try:
        import pxr  # noqa: F401
    except ModuleNotFoundError:
        raise MissingDependencyError("USD needs the package usd-core: pip install 'softdeca[usd]'") from None


def write_usd(path: str | os.PathLike[str], rig: MorphRig) -> None:
    """Write a rig below a SkelRoot: a skeleton of one joint, an animation of the weights, and a mesh for each surface.

    The notes stand in the layer's customLayerData. MissingDependencyError without usd-core, InputError for a file that
    cannot be written.
    """
    stage = _new_stage(rig.notes)
    from pxr import Gf, UsdSkel, Vt

    stage.SetDefaultPrim(UsdSkel.Root.Define(stage, ROOT).GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, f"{ROOT}/skeleton")
    skeleton.CreateJointsAttr(["head"])
    for transforms in (skeleton.CreateBindTransformsAttr(), skeleton.CreateRestTransformsAttr()):
        transforms.Set(Vt.Matrix4dArray([Gf.Matrix4d(1.0)]))
    animation = UsdSkel.Animation.Define(stage, f"{ROOT}/animation")
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    names = [name.replace(" ", "_") for name in rig.names]
    animation.CreateBlendShapesAttr(names)
    weights = animation.CreateBlendShapeWeightsAttr(Vt.FloatArray(len(names)))
    if rig.weights.size:
        times = rig.times - rig.times[0]
        rate = (len(times) - 1) / times[-1] if len(times) > 1 else 1.0
        codes = np.round(rate * times, 6)
        stage.SetTimeCodesPerSecond(rate)
        stage.SetStartTimeCode(codes[0])
        stage.SetEndTimeCode(codes[-1])
        for code, row in zip(codes, np.asarray(rig.weights, dtype=np.float32), strict=True):
            weights.Set(Vt.FloatArray.FromNumpy(row), code)
    look = _define_look(stage)
    for surface in rig.surfaces:
        _add_mesh(stage, surface, names, skeleton.GetPath(), look)
    _write(path, stage)


def write_usd_tets(path: str | os.PathLike[str], mesh: TetMesh, tissues: Mapping[str, Ints]) -> None:
    """Write a tet mesh [mm] as UsdGeom.TetMesh with its boundary, and a subset of tets (k,) for each tissue.

    MissingDependencyError without usd-core, InputError for a file that cannot be written.
    """
    stage = _new_stage({})
    from pxr import UsdGeom, Vt

    body = UsdGeom.TetMesh.Define(stage, ROOT)
    stage.SetDefaultPrim(body.GetPrim())
    points = _vectors(METRES * mesh.vertices)
    body.CreatePointsAttr(points)
    body.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    body.CreateTetVertexIndicesAttr(Vt.Vec4iArray.FromNumpy(mesh.tets.astype(np.int32)))
    body.CreateSurfaceFaceVertexIndicesAttr(UsdGeom.TetMesh.ComputeSurfaceFaces(body))
    for name, tets in tissues.items():
        UsdGeom.Subset.CreateGeomSubset(
            body, name, UsdGeom.Tokens.tetrahedron, Vt.IntArray.FromNumpy(tets.astype(np.int32))
        )
    _write(path, stage)


def _new_stage(notes: Mapping[str, Any]) -> Any:
    """Begin a stage in metres with y up; MissingDependencyError without usd-core."""
    check_usd()
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.GetRootLayer().customLayerData = {"generator": "softdeca", **notes}
    return stage


def _write(path: str | os.PathLike[str], stage: Any) -> None:
    """Write a stage, whole or not at all."""
    from pxr import Tf

    with replaced(path) as temporary:
        try:
            stage.GetRootLayer().Export(str(temporary))
        except Tf.ErrorException:  # some ten lines of its own sources
            raise InputError(f"{path}: cannot be written by USD; is the disk full?") from None


def _add_mesh(stage: Any, surface: MorphedSurface, names: Sequence[str], skeleton: Any, look: Any) -> None:
    from pxr import Gf, UsdGeom, UsdShade, UsdSkel

    rest = surface.rest
    mesh = UsdGeom.Mesh.Define(stage, f"{ROOT}/{surface.name}")
    points = _vectors(METRES * rest.vertices)
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateFaceVertexCountsAttr(np.full(len(rest.triangles), 3, dtype=np.int32))
    mesh.CreateFaceVertexIndicesAttr(rest.triangles.ravel().astype(np.int32))
    mesh.CreateNormalsAttr(_vectors(rest.vertex_normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateDisplayColorAttr(_vectors(np.atleast_2d(surface.colour)))
    if np.ndim(surface.colour) > 1:
        mesh.GetDisplayColorPrimvar().SetInterpolation(UsdGeom.Tokens.vertex)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(look)
    mesh.AddTranslateOp().Set(Gf.Vec3d(*(METRES * np.asarray(surface.place, dtype=np.float64)).tolist()))
    if not len(surface.targets):
        return
    bound = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    bound.CreateSkeletonRel().SetTargets([skeleton])
    bound.CreateJointIndicesPrimvar(True, 1).Set([0])
    bound.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    bound.CreateBlendShapesAttr(names)
    paths = []
    for name, moved, turned in zip(names, surface.targets, surface.normals, strict=True):
        target = UsdSkel.BlendShape.Define(stage, f"{mesh.GetPath()}/{name}")
        target.CreateOffsetsAttr(_vectors(METRES * moved))
        target.CreateNormalOffsetsAttr(_vectors(turned))
        paths.append(target.GetPath())
    bound.CreateBlendShapeTargetsRel().SetTargets(paths)


def _define_look(stage: Any) -> Any:
    """Define a material that has each mesh in its own displayColor, which not every renderer looks at by itself."""
    from pxr import Sdf, UsdShade

    kinds = Sdf.ValueTypeNames
    look = UsdShade.Material.Define(stage, f"{ROOT}/look")
    surface = UsdShade.Shader.Define(stage, f"{ROOT}/look/surface")
    colour = UsdShade.Shader.Define(stage, f"{ROOT}/look/colour")
    colour.CreateIdAttr("UsdPrimvarReader_float3")
    colour.CreateInput("varname", kinds.String).Set("displayColor")
    surface.CreateIdAttr("UsdPreviewSurface")
    diffuse = surface.CreateInput("diffuseColor", kinds.Color3f)
    diffuse.ConnectToSource(colour.CreateOutput("result", kinds.Float3))
    look.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", kinds.Token))
    return look


def _vectors(values: Any) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))
