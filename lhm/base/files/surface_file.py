"""Surfaces from files: OBJ, PLY, STL, glTF and NPZ, with the morph targets that are there."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import finite, one_of
from ..errors import InputError, MeshError, one_line
from ..mesh import Floats, Ints, Surface, as_elements, as_points
from .gltf import read_gltf
from .npz import read_arrays
from .obj import read_obj
from .ply import read_ply
from .text import check_file, naming_file, read_bytes

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
FARTHEST = 1e12
"""Largest coordinate, in the file's own unit: a head in picometres."""
MOST_MOVED = 10.0
"""Farthest that a morph target may move a vertex, over the mesh's size."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A mesh in its file's own unit and axes: `vertices` (n, 3) in the file's order, `triangles` (m, 3).

    Groups, materials and primitives are one mesh; polygons are triangles. `morphs`: what each named morph target adds,
    shape (n, 3); `shown`: what of them the file's own weights have added to `vertices`, by the target's name. `notes`
    tell what was left out. Raises MeshError for values that are not finite and indices out of range.
    """

    vertices: Floats
    triangles: Ints
    morphs: Mapping[str, Floats] = field(default_factory=dict, repr=False)
    shown: Mapping[str, Floats] = field(default_factory=dict, repr=False)
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "vertices", as_points("vertices", self.vertices))
        object.__setattr__(self, "triangles", as_elements("triangles", self.triangles, 3, len(self.vertices)))
        for name, delta in self.morphs.items():
            if len(as_points(f"morph target {name!r}", delta)) != len(self.vertices):
                raise MeshError(f"morph target {name!r}: {len(delta)} vertices, the mesh has {len(self.vertices)}")

    @property
    def sound(self) -> np.ndarray:
        """Whether the corners of each triangle are three vertices, shape (m,)."""
        a, b, c = self.triangles.T
        return (a != b) & (b != c) & (c != a)

    @property
    def surface(self) -> Surface:
        """The mesh as a surface, [mm] if the file is; MeshError for a triangle that repeats a vertex."""
        return Surface(self.vertices, self.triangles)


def read_surface(path: str | os.PathLike[str], *, unit: str = "mm") -> Surface:
    """Read a triangle mesh from OBJ, PLY, STL, glTF, or NPZ with `vertices` and `triangles`; vertices keep their order.

    `unit` is the file's: mm, cm or m. Raises InputError, one line that names the file, if it is missing, empty,
    damaged, no mesh, or holds values that are not finite.
    """
    factor = MILLIMETRES[one_of("unit", unit, MILLIMETRES)]
    scan = read_scan(path)
    with naming_file(path):
        return Surface(scan.vertices * factor, scan.triangles)


def read_scan(path: str | os.PathLike[str]) -> Scan:
    """Read the mesh in a file by its suffix; InputError, one line that names the file, if it is missing or damaged."""
    path = Path(path)
    read = READERS.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(SUFFIXES)}")
    if check_file(path).stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")
    with naming_file(path):
        scan = Scan(*read(path))
        if not len(scan.triangles):
            raise InputError("no triangles found; is it a mesh?")
        farthest = float(np.abs(scan.vertices).max())
        if farthest > FARTHEST:
            raise InputError(f"a vertex lies at {farthest:.3g}, at most {FARTHEST:g} in any unit; is the file damaged?")
        size = float(np.ptp(scan.vertices, axis=0).max())
        for name, delta in scan.morphs.items():
            if np.abs(delta).max(initial=0.0) > MOST_MOVED * size:
                raise InputError(f"morph target {name!r} moves a vertex more than {MOST_MOVED:g} times the mesh's size")
    return scan


def _read_npz(path: Path) -> tuple[np.ndarray, np.ndarray]:
    arrays = read_arrays(path, "vertices", "triangles", kind="a surface")
    return finite("vertices", arrays["vertices"], (None, 3)), arrays["triangles"]


def read_stl(path: Path) -> tuple[Floats, Ints]:
    """Read the vertices (n, 3) and triangles (m, 3) of an STL file, binary or text.

    Corners at the same place are one vertex. InputError where the file is cut off or no STL.
    """
    from trimesh import load_mesh

    content = io.BytesIO(read_bytes(path))
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):  # NaN is refused where the mesh is made
            warnings.filterwarnings("error", "string or file could not be read")  # numpy's, of a word that is no number
            mesh = load_mesh(content, file_type="stl", process=False)
            mesh.merge_vertices()  # corners at the same place
    except Exception as error:  # trimesh raises whatever the damage makes it raise
        raise InputError(f"not an STL file, or cut off ({one_line(str(error))[:80]})") from None
    if not len(mesh.faces):
        raise InputError("not an STL file, or cut off: no triangle is whole")
    return np.array(mesh.vertices), np.array(mesh.faces)


READERS: dict[str, Callable[[Path], tuple[Any, ...]]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".npz": _read_npz,
}
SUFFIXES = tuple(READERS)
