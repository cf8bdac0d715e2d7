"""Tet meshes with tags, written in the formats of other programs (gmsh, VTK, XDMF, Medit) through meshio."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from ..errors import InputError
from ..mesh import Ints, TetMesh
from .atomic import replaced

FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".xdmf": "xdmf", ".mesh": "medit"}
TAG = {".msh": "gmsh:physical", ".vtu": "tag", ".xdmf": "tag", ".mesh": "medit:ref"}


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


def _kind(path: Path) -> str:
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: unknown kind of tet mesh; expected one of {', '.join(FORMATS)}")
    return path.suffix.lower()
