"""Values by node that ranks share: domain decomposition as DOLFINx and PETSc have it.

A rank integrates over its own cells and needs the values at all their nodes. Each node is owned by one rank, and a
ghost of the others that use it. A *vector* is an array of what a rank owns, and is PETSc's. A *field* is an array of
what it owns and then its ghosts. `spread` makes a field of a vector, `sum_up` a vector of the parts that the ranks'
cells have added to it. Alone a rank owns everything, and both give back what they are given.
"""

from __future__ import annotations

import atexit
import sys
from typing import Any
from zlib import crc32

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ..dolfinx_version import MPI, PETSc


@atexit.register
def _end_others() -> None:
    """End all ranks where an error ends this one: PETSc's own end waits for those that wait for it."""
    if hasattr(sys, "last_value") and PETSc.COMM_WORLD.size > 1:
        MPI.COMM_WORLD.Abort(1)


class IndexMap:
    """Numbers `owned` here and `ghosts`, known by their numbers over all ranks, with `size` values each.

    `ids` are those numbers, shape (count,); `total` is how many there are over all ranks.
    """

    def __init__(self, comm: MPI.Intracomm, owned: int, ghosts: Ints, size: int):
        self.comm, self.owned, self.size = comm, owned, size
        begins = np.concatenate([[0], np.cumsum(comm.allgather(owned))])
        own = np.arange(begins[comm.rank], begins[comm.rank + 1])
        self.total = int(begins[-1])
        self.ids: Ints = np.concatenate([own, ghosts]).astype(np.int64)
        self.count = len(self.ids)
        self._vector: PETSc.Vec | None = None
        if comm.size > 1:
            self._vector = PETSc.Vec().createGhost(
                ghosts.astype(PETSc.IntType), size=(size * owned, size * self.total), bsize=size, comm=comm
            )

    def spread(self, values: Floats) -> Floats:
        """Give the field (count, ...) of a vector (owned, ...): update the ghosts."""
        if self._vector is None:
            return values
        self._vector.array[:] = values.ravel()
        self._vector.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
        with self._vector.localForm() as field:
            return field.array_r.reshape(-1, *values.shape[1:]).copy()

    def sum_up(self, parts: Floats) -> Floats:
        """Give the vector (owned, ...) that all ranks' parts (count, ...) add up to."""
        if self._vector is None:
            return parts
        with self._vector.localForm() as field:
            field.array[:] = parts.ravel()
        self._vector.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
        return self._vector.array_r.reshape(-1, *parts.shape[1:]).copy()

    def spread_mask(self, mask: np.ndarray) -> np.ndarray:
        """Return the logical or of all ranks' masks, shape (count,)."""
        if self._vector is None:
            return mask
        repeated = np.repeat(mask.astype(np.float64)[:, None], self.size, axis=1)
        return self.spread(self.sum_up(repeated))[:, 0] > 0.0

    def local_map(self) -> PETSc.LGMap:
        """Give PETSc's map from the numbers known here to those over all ranks."""
        return PETSc.LGMap().create(self.ids.astype(PETSc.IntType), bsize=self.size, comm=self.comm)


def dot(comm: MPI.Intracomm, a: Floats, b: Floats) -> float:
    """Multiply two vectors."""
    return comm.allreduce(float(a.ravel() @ b.ravel()))


def norm(comm: MPI.Intracomm, a: Floats) -> float:
    """Compute the norm of a vector."""
    return float(np.sqrt(dot(comm, a, a))) if comm.size > 1 else float(np.linalg.norm(a))


def largest_size(comm: MPI.Intracomm, a: Floats) -> float:
    """Find the largest size of a vector's values."""
    return comm.allreduce(float(np.abs(a).max(initial=0.0)), op=MPI.MAX)


def irregular_vector(comm: MPI.Intracomm, X: Floats) -> Floats:
    """Make numbers of no regularity at places X (n, 3), a vector (3n,): of these alone, not of who owns them."""
    waves = np.array([[3.1, -17.3, 29.9], [11.7, 23.3, -5.9], [-31.1, 7.7, 19.3]]) / largest_size(comm, X)
    return np.sin(X @ waves).ravel()


def anywhere(comm: MPI.Intracomm, mask) -> bool:
    """Whether anything is true in any rank."""
    return comm.allreduce(bool(np.any(mask)), op=MPI.LOR)


def gather(comm: MPI.Intracomm, rows: np.ndarray) -> np.ndarray:
    """Give all ranks' rows one after the other, in each of them."""
    if comm.size == 1:
        return rows
    counts = np.array(comm.allgather(rows.size))
    result = np.empty((counts.sum() // max(int(np.prod(rows.shape[1:])), 1), *rows.shape[1:]), dtype=rows.dtype)
    comm.Allgatherv(np.ascontiguousarray(rows), (result, counts))
    return result


def check_same(comm: MPI.Intracomm, scene: Scene):
    """Raise SceneError, in all ranks, unless all of them were given the same scene."""
    if comm.size == 1:
        return
    values: list[Any] = [scene.vertices, scene.tets]
    for term in scene.terms:
        values += [term.name, *(getattr(term, key) for key in term.__dataclass_fields__)]
    sums = tuple(crc32(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()) for value in values)
    if len(set(comm.allgather(sums))) > 1:
        raise SceneError("the ranks of mpirun were given different scenes; each makes the same calls")
