"""Values by node that processes share: domain decomposition as DOLFINx and PETSc have it.

A process integrates over its own cells and needs the values at all their nodes. Each node is owned by one process, and
a ghost of the others that use it. A vector of unknowns is an array of what a process owns, and is PETSc's; a field is
an array of what it owns and then its ghosts. `spread` makes a field of a vector, `summed` a vector of the parts that
the processes' cells have added to it. Alone a process owns everything, and both give back what they are given.
"""

from __future__ import annotations

from typing import Any
from zlib import crc32

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from .dolfinx_version import MPI, PETSc


class Shared:
    """Numbers `owned` here and `ghosts`, known by their numbers over all processes, with `size` values each.

    `ids` are those numbers, shape (count,), `first` the first of them that is owned here, `total` how many there are.
    """

    def __init__(self, comm: MPI.Intracomm, owned: int, ghosts: Ints, size: int):
        self.comm, self.owned, self.size = comm, owned, size
        counts = np.array(comm.allgather(owned))
        self.bounds: Ints = np.concatenate([[0], np.cumsum(counts)])
        self.first, self.total = int(self.bounds[comm.rank]), int(self.bounds[-1])
        self.ids: Ints = np.concatenate([np.arange(self.first, self.first + owned), ghosts]).astype(np.int64)
        self.count = len(self.ids)
        self._vector: PETSc.Vec | None = None
        if comm.size > 1:
            self._vector = PETSc.Vec().createGhost(
                ghosts.astype(PETSc.IntType), size=(size * owned, size * self.total), bsize=size, comm=comm
            )

    def spread(self, values: Floats) -> Floats:
        """A field, shape (count, ...), that has these values where they are owned, shape (owned, ...)."""
        if self._vector is None:
            return values
        self._vector.array[:] = values.ravel()
        self._vector.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
        with self._vector.localForm() as field:
            return field.array_r.reshape(-1, *values.shape[1:]).copy()

    def summed(self, parts: Floats) -> Floats:
        """What all processes' parts (count, ...) add up to where it is owned, shape (owned, ...)."""
        if self._vector is None:
            return parts
        with self._vector.localForm() as field:
            field.array[:] = parts.ravel()
        self._vector.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
        return self._vector.array_r.reshape(-1, *parts.shape[1:]).copy()

    def marked(self, mask: np.ndarray) -> np.ndarray:
        """Where any process has marked what it knows, shape (count,)."""
        if self._vector is None:
            return mask
        repeated = np.repeat(mask.astype(np.float64)[:, None], self.size, axis=1)
        return self.spread(self.summed(repeated))[:, 0] > 0.0

    def local_map(self) -> PETSc.LGMap:
        """PETSc's map from the numbers known here to those over all processes."""
        return PETSc.LGMap().create(self.ids.astype(PETSc.IntType), bsize=self.size, comm=self.comm)


def dot(comm: MPI.Intracomm, a: Floats, b: Floats) -> float:
    """The product of two vectors."""
    return comm.allreduce(float(a.ravel() @ b.ravel()))


def norm(comm: MPI.Intracomm, a: Floats) -> float:
    """The norm of a vector."""
    return float(np.sqrt(dot(comm, a, a))) if comm.size > 1 else float(np.linalg.norm(a))


def largest(comm: MPI.Intracomm, a: Floats) -> float:
    """The largest size of a vector's values."""
    return comm.allreduce(float(np.abs(a).max(initial=0.0)), op=MPI.MAX)


def irregular(comm: MPI.Intracomm, X: Floats) -> Floats:
    """Numbers of no regularity at places X (n, 3), a vector (3n,): they depend on these alone, not on who owns them."""
    waves = np.array([[3.1, -17.3, 29.9], [11.7, 23.3, -5.9], [-31.1, 7.7, 19.3]]) / largest(comm, X)
    return np.sin(X @ waves).ravel()


def anywhere(comm: MPI.Intracomm, mask) -> bool:
    """Whether anything is true in any process."""
    return comm.allreduce(bool(np.any(mask)), op=MPI.LOR)


def check_same(comm: MPI.Intracomm, scene: Scene):
    """Raise SceneError, in all processes, unless all of them were given the same scene."""
    if comm.size == 1 or scene.in_parts:
        return
    parts: list[Any] = [scene.vertices, scene.tets]
    for term in scene.terms:
        parts += [term.name, *(getattr(term, key) for key in term.__dataclass_fields__)]
    known = [part for part in parts if isinstance(part, (np.ndarray, str, float, int, tuple))]
    sums = tuple(crc32(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()) for part in known)
    if len(set(comm.allgather(sums))) > 1:
        raise SceneError("the processes of mpirun were given different scenes; each makes the same calls")


def gathered(comm: MPI.Intracomm, rows: np.ndarray) -> np.ndarray:
    """All processes' rows one after the other, in each of them."""
    if comm.size == 1:
        return rows
    counts = np.array(comm.allgather(rows.size))
    result = np.empty((counts.sum() // max(int(np.prod(rows.shape[1:])), 1), *rows.shape[1:]), dtype=rows.dtype)
    comm.Allgatherv(np.ascontiguousarray(rows), (result, counts))
    return result
