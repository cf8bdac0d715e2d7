"""Surfaces from files: OBJ, PLY, STL, glTF and NPZ, with the morph targets that are there."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import finite, one_of
from ..errors import InputError, MeshError, quote
from ..limits import TRIANGLES, VERTICES
from ..mesh import Floats, Ints, Surface, as_elements, as_points
from .gltf import read_gltf
from .npz import read_arrays
from .ply import read_ply
from .text import check_file, naming_file, read_bytes

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
FARTHEST = 1e12
"""In the file's own unit: a head in picometres."""
MOST_MOVED = 10.0
"""Of the mesh's size: how far a morph target may move a vertex."""
STL_HEADER, STL_ROW = 84, 50
"""Bytes of a binary STL file's header, whose last four are the count of triangles, and of each triangle."""


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


def read_obj(path: Path) -> tuple[Floats, Ints]:
    """Read the vertices (n, 3) of a Wavefront OBJ in the file's order, and its polygons as fans of triangles (m, 3).

    Texture coordinates, normals, materials, lines and points are left out: a vertex that has two texture coordinates
    stays one. Negative indices count back from the last vertex. InputError names a line that is none of OBJ, vertices
    that are not finite and indices out of range.
    """
    content = read_bytes(path).removeprefix(b"\xef\xbb\xbf")  # names of materials may be in any encoding
    if b"\0" in content:
        raise InputError("not an OBJ file: it is no text")
    if b"\\" in content:  # at a line's end it continues the line
        content = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    coordinates, corners = array("d"), array("q")
    for number, line in enumerate(content.splitlines(), start=1):
        said = line.partition(b"#")[0]
        kind, *fields = said.split() or [b""]
        try:
            if b"_" in said and kind in (b"v", b"f"):  # 1_0 is a number to Python alone
                raise ValueError
            if kind == b"v":
                x, y, z = fields[:3]
                coordinates.extend((float(x), float(y), float(z)))
            elif kind == b"f":
                polygon = [_obj_index(field, len(coordinates) // 3) for field in fields]
                if len(polygon) < 3:
                    raise ValueError
                for b, c in zip(polygon[1:-1], polygon[2:], strict=True):
                    corners.extend((polygon[0], b, c))
        except (ValueError, OverflowError):
            raise _none_of("an OBJ", number, line) from None
    vertices = np.frombuffer(coordinates, np.float64).reshape(-1, 3)
    triangles = np.frombuffer(corners, np.int64).reshape(-1, 3)
    VERTICES.check("it has", len(vertices))
    TRIANGLES.check("it has", len(triangles))
    try:
        return as_points("vertices", vertices), as_elements("triangles", triangles, 3, len(vertices))
    except MeshError as error:
        raise InputError(str(error)) from None


def _obj_index(field: bytes, count: int) -> int:
    value = int(field.partition(b"/")[0])
    if value == 0 or value < -count:
        raise ValueError
    return value - 1 if value > 0 else count + value


def read_stl(path: Path) -> tuple[Floats, Ints]:
    """Read the vertices (n, 3) and triangles (m, 3) of an STL file, binary or text.

    Corners at the same place are one vertex. InputError where the file is cut off or no STL.
    """
    content = read_bytes(path)
    count = int.from_bytes(content[80:84], "little")
    # Binary files may begin with "solid" too, so that their size tells them.
    if len(content) == STL_HEADER + STL_ROW * count:
        TRIANGLES.check("it has", count)
        rows = np.frombuffer(content, np.uint8, offset=STL_HEADER).reshape(count, STL_ROW)[:, 12:48]
        corners = np.ascontiguousarray(rows).view("<f4").reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid":
        corners = _corners_of_text(content)
    else:
        raise InputError(f"not an STL file, or cut off: its size is not that of the {count:,} triangles it promises")
    with np.errstate(all="ignore"):  # NaN and infinity are refused as such
        return _merge_corners(corners)


def _corners_of_text(content: bytes) -> np.ndarray:
    """Return the corners (3 m, 3) of a text STL, float32."""
    corners, facet, ended = array("d"), 0, False
    for number, line in enumerate(content.lower().splitlines(), start=1):
        kind, *fields = line.split() or [b""]
        try:
            if kind == b"vertex":
                if b"_" in line:  # 1_0 is a number to Python alone
                    raise ValueError
                x, y, z = fields
                corners.extend((float(x), float(y), float(z)))
                facet += 1
            elif kind == b"endfacet":
                if facet != 3:
                    raise ValueError
                facet = 0
            elif kind in (b"solid", b"endsolid"):
                ended = kind == b"endsolid"
            elif kind not in (b"facet", b"outer", b"endloop", b""):
                raise ValueError
        except ValueError:
            raise _none_of("an STL", number, line) from None
    if facet:
        raise InputError("the file is cut off within a triangle")
    if not ended:
        raise InputError("the file is cut off: it does not end in 'endsolid'")
    TRIANGLES.check("it has", len(corners) // 9)
    with np.errstate(over="ignore"):
        return np.frombuffer(corners, np.float64).reshape(-1, 3).astype(np.float32)


def _merge_corners(corners: np.ndarray) -> tuple[Floats, Ints]:
    """Return vertices and triangles of corners (3 m, 3), float32; those of the same three numbers become one."""
    bits = (np.ascontiguousarray(corners, dtype="<f4") + np.float32(0)).view("<u4").astype(np.uint64)  # -0 becomes 0
    _, plane = np.unique(bits[:, 0] << np.uint64(32) | bits[:, 1], return_inverse=True)
    _, first, number = np.unique(
        plane.ravel().astype(np.uint64) << np.uint64(32) | bits[:, 2], return_index=True, return_inverse=True
    )
    # In the file's order.
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(first), dtype=np.int64)
    rank[order] = np.arange(len(first))
    return corners[first[order]].astype(np.float64), rank[number.ravel()].reshape(-1, 3)


def _none_of(kind: str, number: int, line: bytes) -> InputError:
    return InputError(f"line {number} is none of {kind} file: {quote(line.strip().decode('utf-8', 'replace'), 60)!r}")


READERS: dict[str, Callable[[Path], tuple[Any, ...]]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".npz": _read_npz,
}
SUFFIXES = tuple(READERS)
