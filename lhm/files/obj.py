"""Wavefront OBJ: all groups, objects and materials as one mesh over the file's own vertices."""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from ..bounds import TRIANGLES, VERTICES, shown
from ..errors import InputError, MeshError
from ..mesh import Floats, Ints, as_elements, as_points
from ..validate import read_bytes

_BOM = b"\xef\xbb\xbf"


def read_obj(path: Path) -> tuple[Floats, Ints]:
    """Vertices (n, 3) in the file's order, and its polygons as fans of triangles (m, 3).

    Texture coordinates, normals, materials, lines and points are left out: a vertex that has two texture coordinates
    stays one. Negative indices count back from the last vertex. InputError names a line that is none of OBJ, vertices
    that are not finite and indices out of range.
    """
    coordinates, corners = array("d"), array("q")
    for number, line in enumerate(_lines(path), start=1):
        kind, *fields = line.split() or [b""]
        try:
            if kind == b"v":
                x, y, z = fields[:3]
                coordinates.extend((float(x), float(y), float(z)))
            elif kind == b"f":
                polygon = [_index(field, len(coordinates) // 3) for field in fields]
                if len(polygon) < 3:
                    raise ValueError
                for b, c in zip(polygon[1:-1], polygon[2:], strict=True):
                    corners.extend((polygon[0], b, c))
        except (ValueError, OverflowError):
            said = shown(line.strip().decode("utf-8", "replace"), 60)
            raise InputError(f"line {number} is none of an OBJ file: {said!r}") from None
    vertices = np.frombuffer(coordinates, np.float64).reshape(-1, 3)
    triangles = np.frombuffer(corners, np.int64).reshape(-1, 3)
    VERTICES.check("it has", len(vertices))
    TRIANGLES.check("it has", len(triangles))
    try:
        return as_points("vertices", vertices), as_elements("triangles", triangles, 3, len(vertices))
    except MeshError as error:
        raise InputError(str(error)) from None


def _index(field: bytes, count: int) -> int:
    value = int(field.partition(b"/")[0])
    if value == 0 or value < -count:
        raise ValueError
    return value - 1 if value > 0 else count + value


def _lines(path: Path) -> list[bytes]:
    # Names of materials may be in any encoding.
    content = read_bytes(path).removeprefix(_BOM)
    if b"\0" in content:
        raise InputError("not an OBJ file: it is no text")
    if b"\\" in content:  # at a line's end it continues the line
        content = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    return content.splitlines()
