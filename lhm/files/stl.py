"""STL: triangles without indices, binary or text; corners at the same place are one vertex."""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from ..bounds import TRIANGLES, shown
from ..errors import InputError
from ..mesh import Floats, Ints
from ..validate import read_bytes

HEADER, ROW = 84, 50
"""Bytes of a binary file's header, whose last four are the count of triangles, and of each triangle."""


def read_stl(path: Path) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and triangles (m, 3); InputError where the file is cut off or no STL."""
    content = read_bytes(path)
    count = int.from_bytes(content[80:84], "little")
    # Binary files may begin with "solid" too, so that their size tells them.
    if len(content) == HEADER + ROW * count:
        TRIANGLES.check("it has", count)
        rows = np.frombuffer(content, np.uint8, offset=HEADER).reshape(count, ROW)[:, 12:48]
        corners = np.ascontiguousarray(rows).view("<f4").reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid":
        corners = _text(content)
    else:
        raise InputError(f"not an STL file, or cut off: its size is not that of the {count:,} triangles it promises")
    with np.errstate(all="ignore"):  # NaN and infinity are refused as such
        return _merged(corners)


def _text(content: bytes) -> np.ndarray:
    """The corners (3 m, 3) of a text, float32."""
    corners, facet = array("d"), 0
    for number, line in enumerate(content.lower().splitlines(), start=1):
        kind, *fields = line.split() or [b""]
        try:
            if kind == b"vertex":
                x, y, z = fields
                corners.extend((float(x), float(y), float(z)))
                facet += 1
            elif kind == b"endfacet":
                if facet != 3:
                    raise ValueError
                facet = 0
            elif kind not in (b"solid", b"facet", b"outer", b"endloop", b"endsolid", b""):
                raise ValueError
        except ValueError:
            said = shown(line.strip().decode("utf-8", "replace"), 60)
            raise InputError(f"line {number} is none of an STL file: {said!r}") from None
    if facet:
        raise InputError("the file is cut off within a triangle")
    TRIANGLES.check("it has", len(corners) // 9)
    with np.errstate(over="ignore"):
        return np.frombuffer(corners, np.float64).reshape(-1, 3).astype(np.float32)


def _merged(corners: np.ndarray) -> tuple[Floats, Ints]:
    """Vertices and triangles of corners (3 m, 3), float32, those of the same three numbers made one."""
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
