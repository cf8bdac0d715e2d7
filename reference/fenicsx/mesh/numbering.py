"""The scene's mesh in dolfinx, and the maps between both numberings of vertices and tets, and of the nodes on edges.

Of several ranks each has the cells that the partitioner gives it, their nodes, and the triangles and rings of
vertices that it integrates over: a triangle goes to the first rank that has all its nodes, a ring to the one that
owns the vertex in its middle, which takes other nodes as ghosts for it.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import FACES, Floats, Ints
from ...scene import Scene
from ...terms import Bending, OnTriangles
from .. import dolfinx_version as seam
from ..dolfinx_version import ALL, ALONE, MPI
from .parallel import IndexMap, gather

DEGREE_OF = {"P1": 1, "P2": 2, "P2P1": 2}
"""The degree of each element's displacement."""
FEW = 300
"""Tets per rank, below which dividing them costs more than it saves."""

CORNERS = np.repeat(np.arange(4)[:, None], 2, axis=1)
EDGES = np.array([[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]])
"""Ends of the local nodes of quadratic tets after their corners; on faces the nodes lie opposite to the corners."""
# Integrals of the shape functions over a tet and a triangle, per volume and per area.
CELL_SHARES = {1: np.full(4, 1 / 4), 2: np.repeat([-1 / 20, 1 / 5], [4, 6])}
FACE_SHARES = {1: np.full(3, 1 / 3), 2: np.repeat([0.0, 1 / 3], 3)}


def ranks_for(scene: Scene) -> MPI.Intracomm:
    """Give the ranks that divide a scene: all that mpirun has started, or of a small one each alone."""
    return ALL if len(scene.tets) >= FEW * ALL.size else ALONE


class Numbering:
    """A space of degree 1 or 2 on the scene's tets.

    `ends` (n, 2) are the scene's vertices between which a node lies in the middle, twice the same at a corner;
    `corners` (k,) are the nodes at vertices, `vertex` (k,) theirs, and `dof` (scene vertices,) the inverse, -1 for a
    vertex in no tet; `tet` (m,) is the scene's tet per cell, `cell` its inverse; `prisms` (r,) are the scene's prisms
    whose first tet is a cell here, and `prism` (scene's tets,) is which of these a first tet has, -1 for others;
    `X` [mm], shape (n, 3), are rest positions by node. `own_vertices` are this rank's, `own_corners` its nodes there,
    and `all_vertices` those of all ranks, one after the other. Of several ranks these are what each knows of, -1 what
    it does not; `nodes` says what it owns, and `function_nodes` counts the nodes of its cells.
    """

    def __init__(self, scene: Scene, degree: int = 1, *, comm: MPI.Intracomm = ALONE):
        self.degree, self.comm = degree, comm
        domain = seam.tet_mesh(scene.vertices, scene.tets, comm)
        self.cell_vertices, self.tet = seam.cell_vertices(domain), seam.cell_tets(domain)
        self.space = seam.vector_space(domain, degree)
        local = CORNERS if degree == 1 else np.concatenate([CORNERS, EDGES])
        self.cell_dofs = seam.cell_dofs(self.space, len(local))
        self.cell = np.full(len(scene.tets), -1, dtype=np.int64)
        self.cell[self.tet] = np.arange(len(self.tet))
        self.cell_volumes = scene.volumes[self.tet]
        self._in_tets = np.zeros(len(scene.vertices), dtype=bool)
        self._in_tets[scene.tets] = True
        owned, ghosts = seam.dof_counts(self.space)
        self.function_nodes = owned + ghosts
        ends = np.full((self.function_nodes, 2), -1, dtype=np.int64)
        ends[self.cell_dofs] = np.sort(self.cell_vertices[:, local], axis=2)
        self._number(ends)
        self.prisms = np.flatnonzero(self.cell[scene.prisms[:, 0]] >= 0)
        self.prism = np.full(len(scene.tets), -1, dtype=np.int64)
        self.prism[scene.prisms[self.prisms, 0]] = np.arange(len(self.prisms))
        ids = seam.global_dofs(self.space)
        self.own_vertices = self.vertex[self.corners < owned]
        if comm.size > 1:
            ids = self._with_distant(scene, ids, owned)
        self.nodes = IndexMap(comm, owned, ids[owned:], 3)
        self.X: Floats = self.to_dofs(scene.vertices)
        self.all_vertices = gather(self.comm, self.own_vertices)
        self.own_corners = self.dof[self.own_vertices]

    def _number(self, ends: Ints):
        """Number nodes by their ends (n, 2)."""
        self.ends = ends
        self.corners = np.flatnonzero(ends[:, 0] == ends[:, 1])
        self.vertex = ends[self.corners, 0]
        self.dof = np.full(len(self._in_tets), -1, dtype=np.int64)
        self.dof[self.vertex] = self.corners
        keys = ends @ [len(self.dof), 1]
        self._by_key = np.argsort(keys)
        self._keys = keys[self._by_key]

    def _with_distant(self, scene: Scene, ids: Ints, owned: int) -> Ints:
        """Take nodes of triangles and rings that no cell here has; the numbers over all ranks, theirs too."""
        n = len(self.dof)
        vertices = gather(self.comm, self.own_vertices)
        owner = np.full(n, -1)
        owner[vertices] = np.repeat(np.arange(self.comm.size), self.comm.allgather(len(self.own_vertices)))
        self._owner = owner
        keys = gather(self.comm, self.ends[:owned] @ [n, 1])
        order = np.argsort(keys)
        keys, number = keys[order], gather(self.comm, ids[:owned])[order]
        rank = np.repeat(np.arange(self.comm.size), self.comm.allgather(owned))[order]
        needed = [scene.prism_cells.vertices[self.prisms].ravel()]
        for term in scene.of(OnTriangles):  # a ring of vertices needs all triangles around one that is owned here
            triangles = term.triangles
            if self._in_tets[triangles].all():
                mine = (owner[triangles] == self.comm.rank).any(axis=1)
                needed += [triangles[self._here(triangles)].ravel(), triangles[mine].ravel()]
        wanted = [np.concatenate(needed) * (n + 1)]
        for term in scene.of(Bending) if self.degree == 2 else ():  # and of quadratic rings all their nodes
            triangles = term.triangles[self._in_tets[term.triangles].all(axis=1)]
            nodes = np.column_stack([triangles * (n + 1), _sides(triangles) @ [n, 1]])
            slots = np.minimum(np.searchsorted(keys, nodes), len(keys) - 1)
            wanted.append(nodes[((keys[slots] == nodes) & (rank[slots] == self.comm.rank)).any(axis=1)].ravel())
        distant = np.setdiff1d(np.intersect1d(np.concatenate(wanted), keys), self._keys)
        self._number(np.concatenate([self.ends, np.column_stack([distant // n, distant % n])]))
        return np.concatenate([ids, number[np.searchsorted(keys, distant)]])

    def _here(self, triangles: Ints) -> Ints:
        """Those of triangles (k, 3) that this rank integrates over; every rank asks at once."""
        if self.comm.size == 1:
            return np.arange(len(triangles))
        first = self._first_with(triangles)
        return np.flatnonzero(np.where(first < self.comm.size, first, self._owner[triangles[:, 0]]) == self.comm.rank)

    def _first_with(self, triangles: Ints) -> Ints:
        """The first rank whose cells have all nodes of triangles (k, 3); how many there are where none has."""
        dofs = self.dof[triangles]
        known = ((dofs >= 0) & (dofs < self.function_nodes)).all(axis=1)
        if self.degree == 2:
            slots, there = self._slots(triangles)
            known &= (there & (self._by_key[slots] < self.function_nodes)).all(axis=1)
        first = np.where(known, self.comm.rank, self.comm.size)
        self.comm.Allreduce(MPI.IN_PLACE, first, op=MPI.MIN)
        return first

    def dofs_of(self, name: str, vertices: Ints) -> Ints:
        """Dofs of a term's vertices, in their shape; SceneError for a vertex that is in no tet."""
        outside = ~self._in_tets[vertices]
        if outside.any():
            raise SceneError(f"{name}: vertex {vertices[outside][0]} is in no tet; solver 'fenicsx' cannot move it")
        return self.dof[vertices]

    def own_dofs(self, name: str, vertices: Ints) -> tuple[Ints, Ints]:
        """Those of a term's vertices (k,) whose nodes this rank owns, and the nodes; errors as of `dofs_of`."""
        dofs = self.dofs_of(name, vertices)
        mine = np.flatnonzero((dofs >= 0) & (dofs < self.nodes.owned))
        return mine, dofs[mine]

    def faces(self, name: str, triangles: Ints) -> tuple[Ints, Ints]:
        """Those of a term's triangles (k, 3) that this rank integrates over, and their nodes; see `face_dofs`."""
        self.dofs_of(name, triangles)
        if self.comm.size > 1 and self.degree == 2:
            self._check_faces(name, self._first_with(triangles) < self.comm.size)
        here = self._here(triangles)
        return here, self.face_dofs(name, triangles[here])

    def _slots(self, triangles: Ints) -> tuple[Ints, np.ndarray]:
        """Where the nodes on the sides of triangles (k, 3) are in the order of keys, and which of them there are."""
        keys = _sides(triangles) @ [len(self.dof), 1]
        slots = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return slots, self._keys[slots] == keys

    def face_dofs(self, name: str, triangles: Ints) -> Ints:
        """Dofs of a term's triangles (k, 3), their corners first: (k, 3) or, of degree 2, (k, 6).

        Raises SceneError for a vertex in no tet, and of degree 2 for a triangle whose sides are not edges of tets.
        """
        corners = self.dofs_of(name, triangles)
        if self.degree == 1:
            return corners
        slots, there = self._slots(triangles)
        self._check_faces(name, there.all(axis=1))
        return np.concatenate([corners, self._by_key[slots]], axis=1)

    def known_faces(self, name: str, triangles: Ints) -> tuple[Ints, Ints]:
        """Those of a term's triangles (k, 3) of which this rank knows all nodes, and these; see `face_dofs`."""
        there = (self.dofs_of(name, triangles) >= 0).all(axis=1)
        if self.degree == 2 and self.comm.size > 1:
            there &= self._slots(triangles)[1].all(axis=1)
        return np.flatnonzero(there), self.face_dofs(name, triangles[there])

    def _check_faces(self, name: str, there: np.ndarray):
        if not there.all():
            which = np.flatnonzero(~there)[0]
            raise SceneError(f"{name}: triangle {which} is no face of a tet; quadratic elements need its edges' nodes")

    def nodes_between(self, ends: Ints) -> Ints:
        """The nodes, shape (k,), of ends (k, 2) that nodes are known to have; an end twice is a vertex."""
        return self._by_key[np.searchsorted(self._keys, np.sort(ends, axis=1) @ [len(self.dof), 1])]

    def to_dofs(self, values: Floats) -> Floats:
        """Values per scene vertex, shape (scene vertices, 3), by node: their mean on edges."""
        return values[self.ends].mean(axis=1)

    def held(self, held: np.ndarray) -> np.ndarray:
        """Find the components of nodes (n, 3) that are held where vertices (scene vertices, 3) are.

        A node on an edge is, if a face of the boundary has the edge, and all its three vertices are held: an edge
        through the inside is free though both its ends lie on held faces.
        """
        result = held[self.ends].all(axis=1)
        if self.degree == 1:
            return result
        boundary, sides = self._boundary
        on_held = np.zeros_like(result)
        for c in range(3):
            on_held[sides[held[boundary, c].all(axis=1)], c] = True
            on_held[:, c] = self.nodes.spread_mask(on_held[:, c])  # of a face in another rank there may be an edge here
        on_held[self.corners] = True
        return result & on_held

    @cached_property
    def _boundary(self) -> tuple[Ints, Ints]:
        """The scene's vertices of this rank's faces of the boundary, shape (k, 3), and the nodes on their sides."""
        _, beside, local = seam.boundary(self.space.mesh)
        triangles = self.cell_vertices[beside[:, None], FACES[local]]
        return triangles, self._by_key[self._slots(triangles)[0]]

    def to_scene(self, values: Floats, elsewhere: Floats) -> Floats:
        """Values by node (n, 3) per scene vertex, and `elsewhere`'s (scene vertices, 3) for vertices in no tet.

        Every rank gives those that it owns at least, and all of them have the whole.
        """
        result = np.array(elsewhere)
        result[self.all_vertices] = gather(self.comm, values[self.own_corners])
        return result

    def all_nodes(self, values: Floats) -> tuple[Ints, Floats]:
        """The ends (n, 2) and values (n, 3) of the scene's nodes, from those that each rank owns."""
        mine = self.nodes.owned
        return gather(self.comm, self.ends[:mine]), gather(self.comm, values[:mine])


def _sides(triangles: Ints) -> Ints:
    """The ends of the sides of triangles (k, 3), shape (k, 3, 2), lower ones first; each is opposite to its corner."""
    ends: Ints = np.sort(triangles[:, [[1, 2], [0, 2], [0, 1]]], axis=2)
    return ends
