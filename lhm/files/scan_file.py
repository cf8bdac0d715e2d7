"""Meshes as their files have them: OBJ, PLY, STL, glTF and NPZ, with the morph targets that are there."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, MeshError
from ..mesh import Floats, Ints, Surface, as_elements, as_points
from ..validate import finite
from .gltf_read import read_gltf
from .npz import read_arrays
from .obj import read_obj
from .ply import read_ply
from .stl import read_stl

FARTHEST = 1e12
"""In the file's own unit: a head in picometres."""
MOST_MOVED = 10.0


@dataclass(frozen=True, eq=False)
class Scan:
    """A mesh in its file's own unit and axes: `vertices` (n, 3) in the file's order, `triangles` (m, 3).

    Groups, materials and primitives are one mesh; polygons are triangles. `morphs`: what each named morph target adds,
    shape (n, 3). Raises MeshError for values that are not finite and indices out of range.
    """

    vertices: Floats
    triangles: Ints
    morphs: Mapping[str, Floats] = field(default_factory=dict, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "vertices", as_points("vertices", self.vertices))
        object.__setattr__(self, "triangles", as_elements("triangles", self.triangles, 3, len(self.vertices)))
        for name, delta in self.morphs.items():
            if len(as_points(f"morph target {name!r}", delta)) != len(self.vertices):
                raise MeshError(f"morph target {name!r}: {len(delta)} vertices, the mesh has {len(self.vertices)}")

    @property
    def surface(self) -> Surface:
        """The mesh as a surface, [mm] if the file is; MeshError for a triangle that repeats a vertex."""
        return Surface(self.vertices, self.triangles)


def read_scan(path: str | os.PathLike[str]) -> Scan:
    """The mesh in a file by its suffix; InputError, one line that names the file, if it is missing, damaged or none."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")
    try:
        scan = Scan(*_READERS[path.suffix.lower()](path))
        if not len(scan.triangles):
            raise InputError("no triangles found; is it a mesh?")
        farthest = float(np.abs(scan.vertices).max())
        if farthest > FARTHEST:
            raise InputError(f"a vertex lies at {farthest:.3g}, at most {FARTHEST:g} in any unit; is the file damaged?")
        size = float(np.ptp(scan.vertices, axis=0).max())
        for name, delta in scan.morphs.items():
            if np.abs(delta).max(initial=0.0) > MOST_MOVED * size:
                raise InputError(f"morph target {name!r} moves a vertex more than {MOST_MOVED:g} times the mesh's size")
    except (InputError, MeshError) as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    return scan


def _read_npz(path: Path) -> tuple[np.ndarray, np.ndarray]:
    arrays = read_arrays(path, "vertices", "triangles", of="a surface")
    return finite("vertices", arrays["vertices"], (None, 3)), arrays["triangles"]


_READERS: dict[str, Callable[[Path], tuple[Any, ...]]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".npz": _read_npz,
}
SUFFIXES = tuple(_READERS)
