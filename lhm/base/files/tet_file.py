"""Tet meshes with tags for other programs: gmsh, VTK and Medit by meshio, XDMF as FEniCSx reads it, and USD."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np

from ..errors import InputError
from ..mesh import Ints, TetMesh
from .atomic import check_replaceable, replaced, write_whole
from .usd import write_usd_tets

FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".mesh": "medit"}
TAG = {".msh": "gmsh:physical", ".vtu": "tag", ".mesh": "medit:ref"}
XDMF = ".xdmf"
USD = (".usd", ".usdc", ".usda")
SUFFIXES = (*FORMATS, XDMF, *USD)


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
    """Write a .msh (gmsh 2.2), .vtu, .xdmf, .mesh [mm] or USD file, whole or not at all; InputError for another suffix.

    Surfaces are elements beside the tets. Names go with .msh and USD: the other formats have numbers only. USD, in
    metres, has the boundary in place of the surfaces, and needs usd-core. XDMF has its
    numbers in an .h5 file of its name, tets and their tags in the grid `mesh`, triangles and theirs in `surfaces`, as
    `XDMFFile.read_mesh` and `read_meshtags` of DOLFINx take them.
    """
    import meshio

    path = Path(path)
    kind = _kind(path)
    if kind == XDMF:
        _write_xdmf(path, tagged)
        return
    if kind in USD:
        tissues = {name: np.flatnonzero(tagged.tags == tag) for tag, name in tagged.names.items()}
        write_usd_tets(path, tagged.mesh, {name: tets for name, tets in tissues.items() if len(tets)})
        return
    blocks = [("tetra", tagged.mesh.tets), *(("triangle", t) for t in tagged.surfaces.values())]
    numbers = [tagged.tags, *(np.full(len(t), tag) for tag, t in tagged.surfaces.items())]
    data = {TAG[kind]: [np.asarray(values, dtype=np.int32) for values in numbers]}
    more = {}
    if kind == ".msh":
        data["gmsh:geometrical"] = data[TAG[kind]]
        flat = {*tagged.surfaces}
        more = {"field_data": {name: np.array([tag, 2 if tag in flat else 3]) for tag, name in tagged.names.items()}}
    mesh = meshio.Mesh(tagged.mesh.vertices, blocks, cell_data=data, **more)
    settings = {".msh": {"file_format": "gmsh22"}}.get(kind, {})
    with replaced(path) as temporary, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        mesh.write(temporary, **{"file_format": FORMATS[kind], **settings})


def _write_xdmf(path: Path, tagged: TaggedTets) -> None:
    """Write the numbers as HDF5 and, after it, the XML that names them: one grid for each kind of cell."""
    beside, buffer = path.with_suffix(".h5"), io.BytesIO()
    triangles = [np.asarray(each) for each in tagged.surfaces.values()]
    tags = [np.full(len(each), tag) for tag, each in tagged.surfaces.items()]
    grids = [("mesh", "Tetrahedron", tagged.mesh.tets, tagged.tags)]
    if triangles:
        grids.append(("surfaces", "Triangle", np.concatenate(triangles), np.concatenate(tags)))
    root = ElementTree.Element("Xdmf", Version="3.0")
    domain = ElementTree.SubElement(root, "Domain")
    with h5py.File(buffer, "w") as file:

        def add(parent: ElementTree.Element, name: str, values: np.ndarray) -> None:
            file[name] = values
            kind = {"f": "Float", "i": "Int"}[values.dtype.kind]
            size = " ".join(map(str, values.shape))
            words = {"Dimensions": size, "NumberType": kind, "Precision": str(values.itemsize), "Format": "HDF"}
            ElementTree.SubElement(parent, "DataItem", words).text = f"{beside.name}:/{name}"

        for name, cell, corners, numbers in grids:
            grid = ElementTree.SubElement(domain, "Grid", Name=name, GridType="Uniform")
            count, width = corners.shape
            words = {"TopologyType": cell, "NumberOfElements": str(count), "NodesPerElement": str(width)}
            add(ElementTree.SubElement(grid, "Topology", words), f"{name}/topology", corners.astype(np.int64))
            geometry = ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ")
            add(geometry, f"{name}/geometry", tagged.mesh.vertices)
            words = {"Name": "tag", "AttributeType": "Scalar", "Center": "Cell"}
            add(ElementTree.SubElement(grid, "Attribute", words), f"{name}/tag", numbers.astype(np.int32)[:, None])
    check_replaceable(path)
    write_whole(beside, buffer.getvalue())
    write_whole(path, ElementTree.tostring(root, xml_declaration=True))


def _kind(path: Path) -> str:
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: unknown kind of tet mesh; expected one of {', '.join(SUFFIXES)}")
    return path.suffix.lower()
