"""Tet meshes with tags, in and out, in the formats of other programs (gmsh, VTK, XDMF, Medit) through meshio."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from ..checks import check_arguments, finite, indices_below, one_of
from ..errors import InputError, SoftdecaError, escape, quote
from ..limits import TAGS, TETS, VERTICES
from ..mesh import Ints, TetMesh
from .atomic import replaced
from .surface_file import FARTHEST, MILLIMETRES
from .text import check_file, naming_file

FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".xdmf": "xdmf", ".mesh": "medit"}
TAG = {".msh": "gmsh:physical", ".vtu": "tag", ".xdmf": "tag", ".mesh": "medit:ref"}
EXTENT = 1.0, 6000.0
"""[mm] Least and greatest extent: ten times a head's either way, beyond which the unit is wrong."""
MOST_TAG = 2**31


@dataclass(frozen=True, eq=False)
class TaggedTets:
    """A tet mesh [mm] and an integer per tet, shape (m,); `names` of tags where the file has them.

    `surfaces`: triangles (k, 3) over the mesh's vertices, by their tag.
    """

    mesh: TetMesh
    tags: Ints
    names: Mapping[int, str] = field(default_factory=dict)
    surfaces: Mapping[int, Ints] = field(default_factory=dict)


def write_tets(path: str | os.PathLike[str], tagged: TaggedTets) -> None:
    """Write a .msh (gmsh 2.2), .vtu, .xdmf or .mesh file [mm], whole or not at all; InputError for another suffix.

    Surfaces are elements beside the tets. Names go with .msh alone: the other formats have numbers only.
    """
    path = Path(path)
    kind = _kind(path)
    blocks = [("tetra", tagged.mesh.tets), *(("triangle", t) for t in tagged.surfaces.values())]
    numbers = [tagged.tags, *(np.full(len(t), tag) for tag, t in tagged.surfaces.items())]
    data = {TAG[kind]: [np.asarray(values, dtype=np.int32) for values in numbers]}
    more = {}
    if kind == ".msh":
        data["gmsh:geometrical"] = data[TAG[kind]]
        flat = {*tagged.surfaces}
        more = {"field_data": {name: np.array([tag, 2 if tag in flat else 3]) for tag, name in tagged.names.items()}}
    mesh = meshio.Mesh(tagged.mesh.vertices, blocks, cell_data=data, **more)
    settings = {".msh": {"file_format": "gmsh22"}, ".xdmf": {"data_format": "XML"}}.get(kind, {})
    with replaced(path) as temporary, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        mesh.write(temporary, **{"file_format": FORMATS[kind], **settings})


@check_arguments
def read_tets(path: str | os.PathLike[str], *, unit: str = "mm") -> TaggedTets:
    """Read the tets of a file in any of the formats, with their tags (0 where it has none) and tagged triangles.

    `unit` is the file's: mm, cm or m. Raises InputError, one line that names the file, if it is missing, damaged, has
    no tets or too many, values that are not finite, inverted tets, or an extent [mm] that shows a wrong unit.
    """
    one_of("unit", unit, MILLIMETRES)
    path = check_file(path)
    kind = _kind(path)
    if kind == ".xdmf":
        with naming_file(path):
            _check_alone(path)
    # meshio prints warnings, and ends the process where it finds no reader for a content.
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = meshio.read(path, file_format=FORMATS[kind])
    except (Exception, SystemExit) as error:  # its readers raise whatever broken text makes them raise
        said = quote(str(error).strip().split("\n")[0], 80)
        raise InputError(f"{path}: not a readable tet mesh ({type(error).__name__}{said and ': ' + said})") from None
    with naming_file(path):
        try:
            return _tagged(mesh, kind, unit)
        except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:  # meshio hands on what it finds
            if isinstance(error, SoftdecaError):
                raise
            raise InputError(f"not a sound tet mesh ({type(error).__name__}: {str(error)[:80]})") from None


def _check_alone(path: Path) -> None:
    """Raise InputError for an XDMF file whose numbers are in other files: meshio opens these wherever they lie."""
    with suppress(ElementTree.ParseError):  # meshio refuses it too
        for _, item in ElementTree.iterparse(path):
            if item.get("Format", "XML") != "XML":
                raise InputError(f"its numbers are of Format {quote(item.get('Format'))!r}; expected 'XML', inside it")
            item.clear()


def _tagged(mesh: meshio.Mesh, kind: str, unit: str) -> TaggedTets:
    tets = np.vstack([np.empty((0, 4), dtype=np.int64), *(b.data for b in mesh.cells if b.type == "tetra")])
    if not len(tets):
        kinds = sorted({block.type for block in mesh.cells}) or ["nothing"]
        raise InputError(f"no tets (four corners each); it has {', '.join(kinds)}")
    TETS.check("it has", len(tets))
    points = finite("points", mesh.points, (None, 3), most=FARTHEST)
    VERTICES.check("it has", len(points))
    tet_mesh = TetMesh(points * MILLIMETRES[unit], indices_below("tets", tets, len(points)))
    extent = float(np.ptp(tet_mesh.vertices[np.unique(tets)], axis=0).max())
    if not EXTENT[0] <= extent <= EXTENT[1]:
        raise InputError(f"its extent is {extent:.4g} mm in unit {unit!r}; is the unit wrong?")
    numbers = _tags_of_blocks(mesh, TAG[kind])
    tags = np.concatenate([n for b, n in zip(mesh.cells, numbers, strict=True) if b.type == "tetra"])
    surfaces: dict[int, list[Ints]] = {}
    for block, values in zip(mesh.cells, numbers, strict=True):
        if block.type == "triangle":
            triangles = indices_below("triangles", block.data, len(points), (None, 3))
            for tag in np.unique(values):
                surfaces.setdefault(int(tag), []).append(triangles[values == tag])
    TAGS.check("it has", len(surfaces))
    names = {int(tag): escape(str(name)) for name, (tag, _) in mesh.field_data.items()} if kind == ".msh" else {}
    return TaggedTets(tet_mesh, tags, names, {tag: np.vstack(parts) for tag, parts in surfaces.items()})


def _tags_of_blocks(mesh: meshio.Mesh, name: str) -> list[Ints]:
    """Return the tags of each block of elements, zeros where the file has none of that name."""
    values = mesh.cell_data.get(name) or [np.zeros(len(block.data)) for block in mesh.cells]
    tags = []
    for given, block in zip(values, mesh.cells, strict=True):
        first = finite(name, np.asarray(given).reshape(len(block.data), -1)[:, 0], most=MOST_TAG)
        if (first != np.round(first)).any():
            raise InputError(f"{name}: a tag is no integer")
        tags.append(first.astype(np.int64))
    return tags


def _kind(path: Path) -> str:
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: unknown kind of tet mesh; expected one of {', '.join(FORMATS)}")
    return path.suffix.lower()
