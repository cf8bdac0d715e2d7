"""PLY: vertices and polygons, as text or binary of either byte order; other elements are skipped."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from struct import Struct

import numpy as np

from ..checks import indices_below
from ..errors import InputError, quote
from ..limits import VERTICES
from ..mesh import Floats, Ints
from .polygons import cut_polygons
from .text import read_bytes

KINDS = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
KINDS |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
KINDS |= {"double": "f8", "float32": "f4", "float64": "f8"}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LISTS = ("vertex_indices", "vertex_index")
LONGEST_HEADER = 65536
"""Bytes within which the header ends."""
CUT = "the file is cut off: it has not the elements that its header promises"


@dataclass(frozen=True)
class _Property:
    """A number of each element, or a list of numbers, then with the kind of its length."""

    name: str
    kind: str
    length: str | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path) -> tuple[Floats, Ints]:
    """Read vertices (n, 3) in the file's order, and triangles (m, 3), see `cut_polygons`.

    InputError where the header is none, promises more than the file has or less, or names no x, y and z.
    """
    content = read_bytes(path)
    match = re.match(rb"ply\s(.*?)\nend_header[ \t]*\r?\n?", content[:LONGEST_HEADER], re.DOTALL)
    if match is None:
        raise InputError("not a PLY file: its header has no end, or does not begin with 'ply'")
    order, elements = _header(match[1].decode("ascii", errors="replace"))
    body = _Body(content[match.end() :], order)
    vertices, corners, lengths = np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64)
    for element in elements:
        columns = body.read(element)
        if element.name == "vertex":
            VERTICES.check("it has", element.count)
            vertices = _vertices(element, columns)
        elif element.name == "face":
            corners, lengths = _polygons(element, columns)
    if not body.is_at_end():
        raise InputError("it goes on after the elements that its header promises")
    corners = indices_below("triangles", corners, len(vertices))
    return vertices, corners[cut_polygons(vertices[corners], lengths)]


def _header(text: str) -> tuple[str, list[_Element]]:
    """Return the order of bytes, "" for a text, and the elements."""
    order, elements = None, []
    for line in text.splitlines():
        match line.split():
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case ["format", form, _] if form in ORDERS:
                order = ORDERS[form]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= KINDS.keys():
                elements[-1].properties.append(_Property(name, KINDS[kind], KINDS[length]))
            case ["property", kind, name] if elements and kind in KINDS:
                elements[-1].properties.append(_Property(name, KINDS[kind]))
            case _:
                raise InputError(f"its header has a line that no PLY file has: {quote(line, 60)!r}")
    if order is None:
        raise InputError("its header names no format that is read: ascii, binary_little_endian, binary_big_endian")
    return order, elements


Columns = dict[str, tuple[np.ndarray, Ints]]
"""For each property by name: the numbers of all elements, one after another, and how many each has."""


class _Body:
    """A file's bytes after its header, read from their beginning on; a text as the bytes of its numbers."""

    def __init__(self, content: bytes, order: str):
        self.order, self.is_text, self.at = order, not order, 0
        self.content = _numbers_of_text(content).tobytes() if self.is_text else content

    def read(self, element: _Element) -> Columns:
        """Read all elements of a kind, as a table where their lists are as long as the first's."""
        names = [each.name for each in element.properties]
        if not element.count or not names:
            return dict.fromkeys(names, (np.zeros(0), np.zeros(0, np.int64)))
        lengths = self._walk(element, 1)[0][0, :, 1]
        table = self._table(element, lengths)
        if table is not None:
            return {name: (table[f"{k}"].ravel(), np.full(len(table), lengths[k])) for k, name in enumerate(names)}
        places, self.at = self._walk(element, element.count)
        kinds = [each.kind for each in element.properties]
        return {name: (self._gather(kinds[k], *places[:, k].T), places[:, k, 1]) for k, name in enumerate(names)}

    def is_at_end(self) -> bool:
        """Whether nothing but blanks follows."""
        rest = self.content[self.at :]
        return not (rest if self.is_text else rest.strip(b"\0 \t\r\n"))

    def _table(self, element: _Element, lengths: Ints) -> np.ndarray | None:
        """Read elements with lists of these lengths, as a structured array; None if there are others."""
        parts: list[tuple] = []
        for k, (each, length) in enumerate(zip(element.properties, lengths, strict=True)):
            parts += [(f"length {k}", self._kind(each.length))] if each.length else []
            parts += [(f"{k}", self._kind(each.kind), (length,))]
        row = np.dtype(parts)
        if element.count * row.itemsize > len(self.content) - self.at:
            return None
        table = np.frombuffer(self.content, row, element.count, self.at)
        for k, each in enumerate(element.properties):
            if each.length and (table[f"length {k}"] != lengths[k]).any():
                return None
        self.at += table.nbytes
        return table

    def _walk(self, element: _Element, count: int) -> tuple[Ints, int]:
        """Return where each property of each element begins and how many numbers it has, (count, k, 2); and the end."""
        steps = []
        for each in element.properties:
            length = self._kind(each.length) if each.length else None
            read = Struct((self.order or "=") + length.char).unpack_from if length else None
            steps.append((read, length.itemsize if length else 0, self._kind(each.kind).itemsize))
        at, end, places = self.at, len(self.content), []
        for _ in range(count):
            for read, width, size in steps:
                if at + width > end:
                    raise InputError(CUT)
                number = read(self.content, at)[0] if read else 1
                at += width
                if not 0 <= number <= (end - at) // size:
                    raise InputError(CUT)
                places.append((at, int(number)))
                at += int(number) * size
        return np.array(places).reshape(count, -1, 2), at

    def _gather(self, kind: str, begins: Ints, counts: Ints) -> np.ndarray:
        sizes = counts * self._kind(kind).itemsize
        at = np.repeat(begins - np.cumsum(sizes) + sizes, sizes) + np.arange(sizes.sum())
        return np.frombuffer(self.content, np.uint8)[at].view(self._kind(kind))

    def _kind(self, kind: str) -> np.dtype:
        return np.dtype("f8" if self.is_text else self.order + kind)


def _numbers_of_text(body: bytes) -> Floats:
    body = body.rstrip(b"\0\x1a \t\r\n")
    if not body:
        return np.zeros(0)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("error", DeprecationWarning)  # where it would end at what is no number
        try:
            return np.fromstring(body, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            raise InputError("its body has a word that is no number") from None


def _vertices(element: _Element, columns: Columns) -> Floats:
    if any(each.length for each in element.properties) or not set("xyz") <= columns.keys():
        raise InputError("its header names no x, y and z of the vertices, or lists among them")
    with np.errstate(invalid="ignore"):  # NaN is refused where the mesh is made
        return np.stack([columns[axis][0].astype(np.float64) for axis in "xyz"], axis=1)


def _polygons(element: _Element, columns: Columns) -> tuple[Ints, Ints]:
    """Return the corners of all polygons, one after another, and how many each has."""
    lists = [each.name for each in element.properties if each.length]
    if not lists:
        raise InputError("its header names no vertices of the faces")
    corners, lengths = columns[next((name for name in lists if name in LISTS), lists[0])]
    with np.errstate(invalid="ignore"):
        if (corners != np.round(corners)).any():
            raise InputError("triangles: an index is no integer")
        return corners.astype(np.int64), lengths
