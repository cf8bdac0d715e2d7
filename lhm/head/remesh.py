"""Other tets for a head's layers: each split into eight, or free ones by gmsh (`pip install softdeca[mesh]`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import ModuleType

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack
from scipy.sparse import identity as sparse_identity

from ..base.errors import InputError, MeshError, MissingDependencyError
from ..base.geometry.topology import midpoints, split_triangles
from ..base.mesh import FACES, Floats, Ints, Surface, TetMesh
from .head import LayeredHead

# Edges of a tet by their two corners; the corner tets of the red refinement, and the octahedron's four tets about each
# of its three diagonals (pairs of opposite edges), as indices into the ten nodes (corners, then edges' middles).
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
CORNER_TETS = np.array([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])
DIAGONALS = np.array([[4, 9], [5, 8], [6, 7]])
AROUND = np.array([[5, 6, 8, 7], [4, 7, 9, 6], [4, 5, 9, 8]])
TRIANGLE, TET = 2, 4
"""Numbers of gmsh's types of elements."""
NETGEN = "Netgen"
"""The optimiser that takes slivers away: of the default head's tets below 2 degrees, all but 1 in 30,000."""
SMALLEST_SIZE = 0.2


def refine_tets(mesh: TetMesh) -> tuple[TetMesh, Ints]:
    """Split every tet into eight (Bey's red refinement); also each new tet's parent, shape (8 m,).

    The domain and each parent's volume stay; old vertices come first. The inner octahedron is cut along its shortest
    diagonal.
    """
    ends, middles = midpoints(mesh.tets, EDGES, len(mesh.vertices))
    vertices = np.vstack([mesh.vertices, mesh.vertices[ends].mean(axis=1)])
    nodes = np.hstack([mesh.tets, len(mesh.vertices) + middles])
    along = vertices[nodes[:, DIAGONALS[:, 0]]] - vertices[nodes[:, DIAGONALS[:, 1]]]
    shortest = np.argmin(np.einsum("mkd,mkd->mk", along, along), axis=1)
    first, last = np.take_along_axis(nodes, DIAGONALS[shortest], axis=1).T
    ring = np.take_along_axis(nodes, AROUND[shortest], axis=1)
    inner = [np.stack([first, last, ring[:, k], ring[:, (k + 1) % 4]], axis=1) for k in range(4)]
    tets = np.stack([*(nodes[:, corner] for corner in CORNER_TETS), *inner], axis=1).reshape(-1, 4)
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    negative = np.einsum("md,md->m", np.cross(b - a, c - a), d - a) < 0.0
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return TetMesh(vertices, tets), np.repeat(np.arange(len(mesh.tets)), 8)


def refine_head(head: LayeredHead) -> LayeredHead:
    """Split every triangle of a head's wraps into four at its edges' middles: the same surfaces, finer.

    Its tets, a `volume`, are the head's split into eight (prisms between the finer wraps could be inverted where the
    head's are twisted), so a layer of tets becomes two. Old vertices of a wrap come first. The skin stays, tied to
    them. A new vertex belongs to a bone if both ends of its edge do, and to a region likewise.
    """
    triangles, n = head.skin_wrap.triangles, len(head.bone)
    finer, ends = split_triangles(triangles, n)
    count = len(ends)
    mean = csr_matrix((np.full(2 * count, 0.5), (np.repeat(np.arange(count), 2), ends.ravel())), shape=(count, n))
    carry = vstack([sparse_identity(n, format="csr"), mean]).tocsr()

    def surface(wrap: Surface) -> Surface:
        return Surface(_carry(carry, wrap.vertices), finer)

    bone = np.where(head.bone[ends[:, 0]] == head.bone[ends[:, 1]], head.bone[ends[:, 0]], 0)
    return LayeredHead(
        skin=head.skin,
        skin_wrap=surface(head.skin_wrap),
        muscle_wrap=surface(head.muscle_wrap),
        skull_wrap=surface(head.skull_wrap),
        bone=np.concatenate([head.bone, bone]),
        wrap_from_skin=(carry @ head.wrap_from_skin).tocsr(),
        skin_from_wrap=hstack([head.skin_from_wrap, csr_matrix((head.skin_from_wrap.shape[0], count))]).tocsr(),
        regions={name: np.concatenate([mask, mask[ends].all(axis=1)]) for name, mask in head.regions.items()},
        muscles=head.muscles,
        skull=head.skull,
        volume=_refine_volume(head, ends),
    )


def _refine_volume(head: LayeredHead, ends: Ints) -> tuple[TetMesh, TetMesh]:
    """Soft tissue and muscle split into eight, the finer wraps' vertices first; `ends` (e, 2) of a wrap's edges."""
    old, n = len(head.vertices), len(head.bone)
    finer, parent = refine_tets(TetMesh(head.vertices, head.tets))
    edges, _ = midpoints(head.tets, EDGES, old)
    keys = edges[:, 0] * old + edges[:, 1]
    wraps = []
    for first in (0, n, 2 * n):
        a, b = (ends + first).T
        wraps += [first + np.arange(n), old + np.searchsorted(keys, a * old + b)]
    first_ones = np.concatenate(wraps)
    order = np.concatenate([first_ones, np.setdiff1d(np.arange(len(finer.vertices)), first_ones)])
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    vertices, tets, soft = finer.vertices[order], place[finer.tets], parent < len(head.soft.tets)
    return TetMesh(vertices, tets[soft]), TetMesh(vertices, tets[~soft])


def _carry(carry: csr_matrix, vertices: Floats) -> Floats:
    return np.asarray(carry @ vertices)


def remesh(head: LayeredHead, size: float) -> LayeredHead:
    """Fill the space between a head's wraps with free tets of `size` [mm], its `volume`; wraps and all else are kept.

    The wraps' triangles stay as they are and grade the size: tets are as large as the triangles by the wraps, and where
    a layer is thick no larger than `size` inside. Where it is thinner than its triangles are wide, tets reach from wrap
    to wrap whatever the size: smaller ones take finer wraps (`refine_head`) first.
    Raises InputError for a size outside 0.2..1000 mm, MissingDependencyError without gmsh, and MeshError with gmsh's
    reason where it fails (wraps that cross or all but touch), or where it changed a wrap.
    """
    if not SMALLEST_SIZE <= size <= 1000.0:
        raise InputError(f"size: expected {SMALLEST_SIZE:g} to 1000 mm, got {size:g}")
    stack = np.vstack([wrap.vertices for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap)])
    with _gmsh() as gmsh:
        vertices, layers = _generate(gmsh, stack, head.skin_wrap.triangles, size)
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
        raise MissingDependencyError(f"gmsh is installed, but does not load ({error}); install that library") from None
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.logger.start()
        yield gmsh
    finally:
        gmsh.finalize()


def _generate(gmsh: ModuleType, stack: Floats, triangles: Ints, size: float) -> tuple[Floats, list[Ints]]:
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
    errors = [line.partition(": ")[2] for line in gmsh.logger.get() if line.startswith("Error")]
    return (errors or [str(error)])[0].strip()


def _fills(tets: Ints, triangles: Ints, outer: int, inner: int) -> bool:
    """Whether the border of some tets is just the triangles of two wraps, whose first vertices are given."""
    faces = np.sort(tets[:, FACES].reshape(-1, 3), axis=1)
    distinct, count = np.unique(faces, axis=0, return_counts=True)
    wraps = np.sort(np.vstack([triangles + outer, triangles + inner]), axis=1)
    return np.array_equal(distinct[count == 1], np.unique(wraps, axis=0))
