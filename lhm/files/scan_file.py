"""Meshes as their files have them: OBJ, PLY, STL, glTF and NPZ, with the morph targets that are there."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from ..errors import InputError, MeshError
from ..mesh import Floats, Ints, Surface, as_elements, as_points
from .gltf_read import read_gltf
from .npz import read_arrays
from .obj import read_obj
from .ply_strips import read_strips

SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf", ".npz")
LONGEST = 65536
"""Bytes in which a PLY's header ends."""
FARTHEST = 1e12
"""In the file's own unit: a head in picometres."""


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
            as_points(f"morph target {name!r}", delta)

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
    reader = {".obj": _obj, ".glb": _gltf, ".gltf": _gltf, ".npz": _npz, ".ply": _ply}.get(
        path.suffix.lower(), _by_trimesh
    )
    try:
        scan = reader(path)
        if not len(scan.triangles):
            raise InputError("no triangles found; is it a mesh?")
        farthest = float(np.abs(scan.vertices).max())
        if farthest > FARTHEST:
            raise InputError(f"a vertex lies at {farthest:.3g}, at most {FARTHEST:g} in any unit; is the file damaged?")
    except (InputError, MeshError) as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    return scan


def _obj(path: Path) -> Scan:
    return Scan(*read_obj(path))


def _gltf(path: Path) -> Scan:
    return Scan(*read_gltf(path))


def _npz(path: Path) -> Scan:
    arrays = read_arrays(path, "vertices", "triangles", of="a surface")
    return Scan(arrays["vertices"], arrays["triangles"])


def _ply(path: Path) -> Scan:
    content = path.read_bytes()
    header = content[:LONGEST].partition(b"end_header")[0].decode("ascii", errors="replace")
    promised = {name: int(count) for name, count in re.findall(r"^element (\w+) (\d+)\s*$", header, re.MULTILINE)}
    if promised.get("tristrips") and not promised.get("face"):
        return Scan(*read_strips(content))
    scan = _by_trimesh(path)
    # A text that ends early is read as far as it goes.
    for name, found in (("vertex", len(scan.vertices)), ("face", len(scan.triangles))):
        if found < promised.get(name, 0):
            raise InputError(f"the file is cut off: it has {found} of {promised[name]} elements {name!r}")
    return scan


def _by_trimesh(path: Path) -> Scan:
    # An STL file has no indices: its corners have to be merged. Elsewhere the order of vertices is kept.
    merged = path.suffix.lower() == ".stl"
    try:
        mesh = trimesh.load(path, force="mesh", process=merged, maintain_order=not merged)
    except Exception as error:  # trimesh's readers raise whatever the broken file makes them raise
        raise InputError(f"not a readable mesh ({type(error).__name__}: {str(error)[:80]})") from None
    triangles, vertices = (np.asarray(getattr(mesh, name, ())) for name in ("faces", "vertices"))
    if triangles.ndim != 2 or not len(triangles):
        raise InputError("no triangles found; is it a mesh?")
    return Scan(vertices, triangles)
