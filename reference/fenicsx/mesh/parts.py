"""A scene that ranks read from an XDMF file together: each has its part of the mesh, and none the whole.

DOLFINx reads and divides the mesh. What acts on it is named by a function that every rank calls with its own part:
by place, by the tags of cells and facets, or both. All else is as of any scene: a part is a Scene of its own, which
says what the others have where a number is about the whole.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree

import numpy as np

from ....lhm.base.checks import check_arguments
from ....lhm.base.errors import InputError, SceneError
from ....lhm.base.files.atomic import check_replaceable
from ....lhm.base.mesh import FACES, Floats, Ints, tet_volumes
from ...scene import Scene
from ...solution import Solution
from ...terms import Term
from .. import dolfinx_version as seam
from ..dolfinx_version import ALL, MPI
from .parallel import IndexMap, gather


@dataclass(frozen=True, eq=False)
class Part:
    """What a rank has of a mesh; indices are its own.

    vertices [mm] (n, 3), those that it shares with others among them, tets (m, 4) that it alone has, and their `tags`
    (m,); `boundary` (k, 3) are the triangles of the whole mesh's surface that are faces of these tets, seen
    counter-clockwise from outside, and `boundary_tags` (k,) theirs. A tag is 0 where the file has none. `numbers` (n,)
    are the vertices' in the file. For the solver: DOLFINx' mesh, its cells (m, 4), and how vertices are shared.
    """

    vertices: Floats
    tets: Ints
    tags: Ints
    boundary: Ints
    boundary_tags: Ints
    numbers: Ints
    domain: object = field(repr=False)
    cells: Ints = field(repr=False)
    shared: IndexMap = field(repr=False)

    @property
    def comm(self) -> MPI.Intracomm:
        """The ranks that have the mesh together."""
        return self.shared.comm

    def corners(self, triangles: Ints) -> Ints:
        """The vertices of triangles (k, 3), here and in all other ranks, that this one has; all of them ask."""
        marked = np.zeros(len(self.vertices), dtype=bool)
        marked[triangles] = True
        return np.flatnonzero(self.shared.spread_mask(marked))


@dataclass(frozen=True, eq=False)
class PartScene(Scene):
    """A scene of which this rank has a part; see Scene, whose arrays are this part's, and `read_scene`."""

    part: Part
    in_parts: ClassVar[bool] = True

    def _unit_force(self) -> tuple[float, int]:
        mine = super()._unit_force()[0], self.part.shared.owned
        total, count = self.together(np.array([mine])).sum(axis=0)
        return float(total), int(count)

    def together(self, rows: np.ndarray) -> np.ndarray:
        """See Scene."""
        return gather(self.part.comm, rows)

    def whole(self, values: Floats) -> Floats:
        """Values per vertex (n, ...) of all ranks, by the file's vertices and in each rank; NaN in no tet."""
        owned = self.part.shared.owned
        numbers, known = self.together(self.part.numbers[:owned]), self.together(values[:owned])
        result = np.full((numbers.max() + 1, *values.shape[1:]), np.nan)
        result[numbers] = known
        return result

    def write(self, path: str | os.PathLike[str], solution: Solution):
        """Write an .xdmf file, and .h5 beside it, by all ranks together: `displacement` [mm] and `J`, det F.

        Raises InputError for another suffix or a folder that is not there.
        """
        path = Path(path)
        if path.suffix != ".xdmf":
            raise InputError(f"{path}: unknown kind of file; expected .xdmf")
        if not path.parent.is_dir():
            raise InputError(f"{path}: no such folder")
        check_replaceable(path)
        check_replaceable(path.with_suffix(".h5"))
        displacement = {"displacement": solution.positions - self.vertices}
        seam.write_xdmf(path, self.part.domain, displacement, {"J": solution.volume_ratio})


@check_arguments
def read_scene(
    path: str | os.PathLike[str],
    terms: Callable[[Part], Sequence[Term]],
    *,
    facets: str | os.PathLike[str] | None = None,
) -> PartScene:
    """The scene of tets [mm] in an XDMF file with HDF5, read in parts by all ranks that mpirun has started.

    `terms` gives what acts on a rank's part: the same kinds of terms in the same order everywhere, with no elements
    where the part has none. The tets' tags are the first grid of tets with values per cell, their surface's the first
    of triangles in `facets`, default the same file. The body counts as one part where it is looked whether it is held.
    Raises InputError for a file that is missing, is no XDMF or has no tets, SceneError for a part that has none, for
    terms that differ between ranks, and as Scene does.
    """
    path, facets = Path(path), Path(path if facets is None else facets)
    grids = _grids(path)
    solids = [name for name, corners, _ in grids if corners == 4]
    if not solids:
        raise InputError(f"{path}: no grid of tets")
    tagged = next((name for name, corners, has_tags in grids if corners == 4 and has_tags), None)
    surface = next((name for name, corners, has_tags in _grids(facets) if corners == 3 and has_tags), None)
    try:
        domain, tags = seam.read_tets(path, solids[0], tagged, ALL)
        found = None if surface is None else seam.read_facet_tags(facets, surface, domain)
    except RuntimeError as error:
        raise InputError(f"{path}: {str(error).strip().splitlines()[0]}") from None
    part = _part(domain, tags, found)
    if min(ALL.allgather(len(part.tets))) == 0:
        raise SceneError(f"{path}: too few tets for {ALL.size} ranks: one of them would have none")
    made = tuple(terms(part))
    kinds = ALL.allgather([type(term).__name__ for term in made])
    if any(other != kinds[0] for other in kinds):
        raise SceneError(f"{path}: terms: {', '.join(kinds[0])} on rank 0, another list on some other")
    return PartScene(part.vertices, part.tets, made, part)


def _grids(path: Path) -> list[tuple[str, int, bool]]:
    """Name, corners of an element and whether there are values per cell, of each grid of tets or triangles."""
    found, name, corners, tagged = [], "", 0, False
    try:
        for event, element in ElementTree.iterparse(path, events=("start", "end")):
            if element.tag == "Grid" and event == "start":
                name, corners, tagged = element.get("Name", ""), 0, False
            elif element.tag == "Topology":
                kind = element.get("TopologyType") or element.get("Type") or ""
                corners = {"Tetrahedron": 4, "Triangle": 3}.get(kind, 0)
            elif element.tag == "Attribute":
                tagged = tagged or element.get("Center") == "Cell"
            elif element.tag == "Grid" and corners:
                found.append((name, corners, tagged))
                corners = 0
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: no XDMF file ({error})") from None
    return found


def _part(domain, tags: Ints, facet_tags: tuple[Ints, Ints] | None) -> Part:
    """A rank's part of DOLFINx' mesh, with its tets turned to positive volumes, which DOLFINx does not ask for."""
    vertices, cells, numbers, owned, ghosts = seam.geometry(domain)
    tets = cells.copy()
    turned = tet_volumes(vertices, tets) < 0.0
    tets[turned, 2:] = tets[turned, :1:-1]
    facets, beside, local = seam.boundary(domain)
    boundary = cells[beside[:, None], FACES[local]]
    boundary[turned[beside]] = boundary[turned[beside]][:, [0, 2, 1]]
    boundary_tags = np.zeros(len(facets), dtype=np.int64)
    if facet_tags is not None:
        at = np.searchsorted(facet_tags[0], facets)
        known = np.flatnonzero(np.isin(facets, facet_tags[0]))
        boundary_tags[known] = facet_tags[1][at[known]]
    shared = IndexMap(domain.comm, owned, ghosts, 1)
    return Part(vertices, tets, tags, boundary, boundary_tags, numbers, domain, cells, shared)
