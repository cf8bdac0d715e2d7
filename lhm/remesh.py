"""Volume meshes between a head's wraps at a chosen size, by gmsh (an extra: `pip install softdeca[mesh]`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import ModuleType

import numpy as np

from .base.errors import InputError, MeshError, MissingDependencyError
from .base.mesh import Floats, Ints, TetMesh
from .head import LayeredHead

TRIANGLE, TET = 2, 4
"""Numbers of gmsh's types of elements."""
NETGEN = "Netgen"
"""The optimiser that takes slivers away: of the default head's tets below 2 degrees, all but 1 in 30,000."""
SMALLEST_SIZE = 0.2


def remeshed(head: LayeredHead, size: float) -> LayeredHead:
    """The head with free tets of `size` [mm] between its wraps, as its `volume`; wraps and all else are kept.

    The wraps' triangles stay as they are and grade the size: tets are as large as the triangles by the wraps, and where
    a layer is thick no larger than `size` inside. Where it is thinner than its triangles are wide, tets reach from wrap
    to wrap whatever the size: smaller ones take finer wraps (`refined_head`) first.
    Raises InputError for a size outside 0.2..1000 mm, MissingDependencyError without gmsh, and MeshError with gmsh's
    reason where it fails (wraps that cross or all but touch), or where it changed a wrap.
    """
    if not SMALLEST_SIZE <= size <= 1000.0:
        raise InputError(f"size: expected {SMALLEST_SIZE:g} to 1000 mm, got {size:g}")
    stack = np.vstack([wrap.vertices for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap)])
    with _gmsh() as gmsh:
        vertices, layers = _generated(gmsh, stack, head.skin_wrap.triangles, size)
    for name, tets, first in zip(("soft tissue", "muscle"), layers, (0, len(head.bone)), strict=True):
        if not _fills(tets, head.skin_wrap.triangles, first, first + len(head.bone)):
            raise MeshError(f"{name}: gmsh changed the triangles of a wrap; its layers may all but touch there")
    return replace(head, volume=(TetMesh(vertices, layers[0]), TetMesh(vertices, layers[1])))


@contextmanager
def _gmsh() -> Iterator[ModuleType]:
    try:
        import gmsh
    except ImportError:
        raise MissingDependencyError("volume meshes need gmsh: pip install softdeca[mesh]") from None
    except OSError as error:  # the wheel's library asks for some of the system's
        raise MissingDependencyError(f"gmsh is installed, but does not load ({error}); see the README") from None
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.logger.start()
        yield gmsh
    finally:
        gmsh.finalize()


def _generated(gmsh: ModuleType, stack: Floats, triangles: Ints, size: float) -> tuple[Floats, list[Ints]]:
    n = len(stack) // 3
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    for wrap in range(3):
        surface = gmsh.model.addDiscreteEntity(2)
        ids = wrap * n + np.arange(1, n + 1)
        gmsh.model.mesh.addNodes(2, surface, ids, stack[wrap * n : (wrap + 1) * n].ravel())
        gmsh.model.mesh.addElementsByType(surface, TRIANGLE, [], (triangles + wrap * n + 1).ravel())
    loops = [gmsh.model.geo.addSurfaceLoop([surface]) for _, surface in gmsh.model.getEntities(2)]
    volumes = [gmsh.model.geo.addVolume(list(pair)) for pair in zip(loops[:-1], loops[1:], strict=True)]
    gmsh.model.geo.synchronize()
    try:
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.optimize(NETGEN)
    except Exception as error:  # gmsh raises nothing more special
        raise MeshError(f"gmsh cannot mesh the layers: {_reason(gmsh, error)}") from None
    ids, flat, _ = gmsh.model.mesh.getNodes()
    place = np.full(int(np.max(ids)) + 1, -1, dtype=np.int64)
    ids = np.asarray(ids, dtype=np.int64)
    order = np.argsort(ids)
    place[ids[order]] = np.arange(len(ids))
    tets = [place[_tets(gmsh, volume)] for volume in volumes]
    return np.reshape(flat, (-1, 3))[order], tets


def _tets(gmsh: ModuleType, volume: int) -> Ints:
    _, corners = gmsh.model.mesh.getElementsByType(TET, volume)
    if not len(corners):
        raise MeshError(f"gmsh cannot mesh the layers: {_reason(gmsh, 'no tets were made')}")
    return np.asarray(corners, dtype=np.int64).reshape(-1, 4)


def _reason(gmsh: ModuleType, error: object) -> str:
    told = [line.partition(": ")[2] for line in gmsh.logger.get() if line.startswith("Error")]
    return (told or [str(error)])[0].strip()


def _fills(tets: Ints, triangles: Ints, outer: int, inner: int) -> bool:
    """Whether the border of some tets is just the triangles of two wraps, whose first vertices are given."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    distinct, count = np.unique(faces, axis=0, return_counts=True)
    wraps = np.sort(np.vstack([triangles + outer, triangles + inner]), axis=1)
    return np.array_equal(distinct[count == 1], np.unique(wraps, axis=0))
