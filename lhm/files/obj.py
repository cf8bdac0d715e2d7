"""Wavefront OBJ: all groups, objects and materials as one mesh over the file's own vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError
from ..mesh import Floats, Ints


def read_obj(path: Path) -> tuple[Floats, Ints]:
    """Vertices (n, 3) in the file's order, and its polygons as fans of triangles (m, 3).

    Texture coordinates, normals, materials, lines and points are left out: a vertex that has two texture coordinates
    stays one. Negative indices count back from the last vertex. InputError names the line that is none of OBJ.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(_lines(path), start=1):
        kind, *fields = line.split() or [""]
        try:
            if kind == "v":
                vertices.append([float(field) for field in fields[:3]])
                if len(fields) < 3:
                    raise ValueError
            elif kind == "f":
                corners = [_index(field, len(vertices)) for field in fields]
                if len(corners) < 3:
                    raise ValueError
                triangles += [(corners[0], b, c) for b, c in zip(corners[1:-1], corners[2:], strict=True)]
        except ValueError:
            raise InputError(f"line {number} is none of an OBJ file: {line.strip()[:60]!r}") from None
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _index(field: str, count: int) -> int:
    value = int(field.partition("/")[0])
    if value == 0:
        raise ValueError
    return value - 1 if value > 0 else count + value


def _lines(path: Path) -> list[str]:
    # A backslash at its end continues a line; names of materials may be in any encoding.
    text = path.read_bytes().decode("utf-8", errors="replace")
    if "\0" in text:
        raise InputError("not an OBJ file: it is no text")
    return text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines()
