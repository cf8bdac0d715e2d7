"""PLY: vertices, and faces or strips of triangles, as text or binary of either byte order; other elements are skipped.

Strips are what the Stanford scans and Igea have: lists of vertices, each strip ended by -1.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit

from ..errors import InputError, escape
from ..limits import TRIANGLES, VERTICES
from ..mesh import Floats, Ints
from .text import read_bytes

KINDS = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
KINDS |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
KINDS |= {"double": "f8", "float32": "f4", "float64": "f8"}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST = 65536
"""Bytes within which the header ends."""
MOST_DIGITS = 15
"""Of a count."""
ENDED = "the file is cut off: it has not the elements that its header promises"


@dataclass(frozen=True)
class _Property:
    """A number of each element, or a list of numbers, then with the type of its length."""

    name: str
    kind: np.dtype
    length: np.dtype | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def least_bytes(self) -> int:
        """Bytes of each, its lists empty."""
        return sum((p.length or p.kind).itemsize for p in self.properties)


def read_ply(path: Path) -> tuple[Floats, Ints]:
    """Vertices (n, 3) in the file's order, and triangles (m, 3); polygons become fans.

    InputError where the header is none, promises more than the file has, or names no x, y and z.
    """
    content = read_bytes(path)
    match = re.match(rb"ply\s(.*?)\nend_header[ \t]*\r?\n?", content[:LONGEST], re.DOTALL)
    if match is None:
        raise InputError("not a PLY file: its header has no end, or does not begin with 'ply'")
    order, elements = _header(match[1].decode("ascii", errors="replace").splitlines())
    names = [element.name for element in elements]
    if "vertex" not in names or len(set(names)) < len(names):
        raise InputError("its header names no vertices, or an element twice")
    body = content[match.end() :]
    for element in elements:
        least = 2 * len(element.properties) if not order else element.least_bytes
        if element.count * least > len(body) + 1:
            raise InputError(f"{ENDED} ({element.count} times {escape(element.name)!r})")
    read = _Text(body) if not order else _Binary(body)
    vertices, triangles = np.zeros((0, 3)), []
    for element in elements:
        if element.name == "vertex":
            VERTICES.check("it has", element.count)
            vertices = _vertices(read, element)
        elif element.name in ("face", "tristrips"):
            flat, lengths = _lists(read, element)
            triangles.append(_fans(flat, lengths) if element.name == "face" else _strips(flat, lengths))
        else:
            read.rows(element, None)
    joined = np.vstack([np.zeros((0, 3), dtype=np.int64), *triangles])
    TRIANGLES.check("it has", len(joined))
    return vertices, joined


def _header(lines: list[str]) -> tuple[str, list[_Element]]:
    """The byte order, "" for text, and the elements."""
    order, elements = None, []
    for line in lines:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in FORMATS and order is None:
            order = FORMATS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal() and len(words[2]) <= MOST_DIGITS:
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and order is not None:
            element = elements.pop()
            elements.append(_Element(element.name, element.count, (*element.properties, _property(words, order))))
        else:
            raise InputError(f"its header has a line that no PLY file has: {escape(line)[:60]!r}")
    if order is None:
        raise InputError("its header names no format that is read: ascii, binary_little_endian, binary_big_endian")
    return order, elements


def _property(words: list[str], order: str) -> _Property:
    kinds, name = words[1:-1], words[-1]
    listed = kinds[:1] == ["list"]
    kinds = kinds[1:] if listed else kinds
    if len(kinds) != 1 + listed or not set(kinds) <= set(KINDS):
        raise InputError(f"its header names a kind of number that no PLY file has: {escape(' '.join(words))[:60]!r}")
    dtypes = [np.dtype((order or "<") + KINDS[kind]) for kind in kinds]
    if listed and dtypes[0].kind == "f":
        raise InputError("its header has a list whose length is no integer")
    return _Property(name, dtypes[-1], dtypes[0] if listed else None)


class _Binary:
    """Elements of a binary body, one after another."""

    def __init__(self, body: bytes):
        self._body, self._at = np.frombuffer(body, np.uint8), 0

    def table(self, element: _Element) -> np.ndarray | dict[str, np.ndarray]:
        """Elements without lists, by the names of their properties."""
        names = [f"{number}" for number in range(len(element.properties))]
        row = np.dtype([(name, p.kind) for name, p in zip(names, element.properties, strict=True)])
        end = self._at + element.count * row.itemsize
        if end > len(self._body):
            raise InputError(ENDED)
        rows = self._body[self._at : end].view(row) if row.itemsize else np.zeros(element.count, row)
        self._at = end
        return {p.name: rows[name] for name, p in zip(names, element.properties, strict=True)}

    def rows(self, element: _Element, wanted: int | None) -> tuple[np.ndarray, Ints]:
        """The numbers of the list of that number, one list after another, and the lists' lengths."""
        sizes = np.array([p.kind.itemsize for p in element.properties], dtype=np.int64)
        lengths = np.array([p.length.itemsize if p.length else 0 for p in element.properties], dtype=np.int64)
        kinds = [p.length for p in element.properties]
        signed = np.array([k is not None and k.kind == "i" for k in kinds], dtype=np.bool_)
        big = np.array([k is not None and k.byteorder == ">" for k in kinds], dtype=np.bool_)
        count = element.count if element.properties else 0
        starts, counts, end = _walk(
            self._body, self._at, count, sizes, lengths, signed, big, -1 if wanted is None else wanted
        )
        if end < 0:
            raise InputError(ENDED)
        self._at = end
        if wanted is None:
            return np.zeros(0), counts
        kind = element.properties[wanted].kind
        return _gathered(self._body, starts, counts, kind.itemsize).view(kind), counts


class _Text:
    """Elements of a body of text, one after another."""

    def __init__(self, body: bytes):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", DeprecationWarning)  # for text that ends in no number; it is cut off there
            try:
                self._numbers = np.fromstring(body, dtype=np.float64, sep=" ")
            except ValueError:
                raise InputError("its body has words that are no numbers") from None
        self._at = 0

    def table(self, element: _Element) -> dict[str, np.ndarray]:
        """Elements without lists, by the names of their properties."""
        width = len(element.properties)
        end = self._at + element.count * width
        if end > len(self._numbers):
            raise InputError(ENDED)
        rows = self._numbers[self._at : end].reshape(element.count, width)
        self._at = end
        return {p.name: rows[:, k] for k, p in enumerate(element.properties)}

    def rows(self, element: _Element, wanted: int | None) -> tuple[np.ndarray, Ints]:
        """The numbers of the list of that number, one list after another, and the lists' lengths."""
        listed = np.array([p.length is not None for p in element.properties], dtype=np.bool_)
        count = element.count if element.properties else 0
        starts, counts, end = _walk_text(self._numbers, self._at, count, listed, -1 if wanted is None else wanted)
        if end < 0:
            raise InputError(ENDED)
        self._at = end
        if wanted is None:
            return np.zeros(0), counts
        items = self._numbers.view(np.uint8)
        return _gathered(items, 8 * starts, counts, 8).view(np.float64), counts


def _vertices(read: _Binary | _Text, element: _Element) -> Floats:
    names = [p.name for p in element.properties]
    if any(p.length for p in element.properties) or any(names.count(axis) != 1 for axis in "xyz"):
        raise InputError("its header names no x, y and z of the vertices, or lists among them")
    table = read.table(element)
    with np.errstate(invalid="ignore"):  # NaN is refused where the mesh is made
        return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)


def _lists(read: _Binary | _Text, element: _Element) -> tuple[Ints, Ints]:
    """The vertices of all faces or strips, one after another, and how many each has."""
    lists = [k for k, p in enumerate(element.properties) if p.length]
    named = [k for k in lists if element.properties[k].name in ("vertex_indices", "vertex_index")]
    if not lists or element.properties[(named or lists)[0]].kind.kind == "f":
        raise InputError(f"its header names no vertices of the elements {escape(element.name)!r}")
    flat, lengths = read.rows(element, (named or lists)[0])
    if flat.dtype.kind == "f":  # of text
        if len(flat) and not (np.abs(flat) < 2**53).all():
            raise InputError("triangles: indices are not finite, or far outside the vertices")
        if (flat != np.round(flat)).any():
            raise InputError("triangles: an index is no integer")
    return flat.astype(np.int64), lengths


def _fans(flat: Ints, lengths: Ints) -> Ints:
    """Triangles of polygons, each from its first corner; those of less than three corners have none."""
    ends = np.cumsum(lengths)
    counts = np.maximum(lengths - 2, 0)
    first = np.repeat(ends - lengths, counts)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([flat[first], flat[first + within + 1], flat[first + within + 2]], axis=1)


def _strips(flat: Ints, lengths: Ints) -> Ints:
    """The triangles of strips, each ended by -1; every other one is turned, and a repeated corner has none."""
    found = [np.zeros((0, 3), dtype=np.int64)]
    ends = np.union1d(np.flatnonzero(flat < 0), np.cumsum(lengths)[:-1])
    for strip in np.split(flat, ends):
        ids = strip[strip >= 0]
        if len(ids) > 2:
            triangles = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1)
            triangles[1::2] = triangles[1::2, ::-1]
            found.append(triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)])
    return np.vstack(found)


@njit(cache=True)
def _walk(body, at, count, sizes, lengths, signed, big, wanted):
    """Place and length of the wanted list of each element, and the place behind the last; -1 where the body ends."""
    n = count if wanted >= 0 else 0
    starts, counts = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for row in range(count):
        for k in range(len(sizes)):
            items = np.int64(1)
            if lengths[k] > 0:
                width = lengths[k]
                if at + width > len(body):
                    return starts, counts, -1
                items = np.int64(0)
                for b in range(width):
                    place = at + b if big[k] else at + width - 1 - b
                    items = items * 256 + np.int64(body[place])
                if signed[k] and items >= np.int64(1) << (8 * width - 1):
                    return starts, counts, -1
                at += width
                if k == wanted:
                    starts[row], counts[row] = at, items
            at += items * sizes[k]
            if at > len(body):
                return starts, counts, -1
    return starts, counts, at


@njit(cache=True)
def _walk_text(numbers, at, count, listed, wanted):
    """As `_walk`, over numbers."""
    n = count if wanted >= 0 else 0
    starts, counts = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for row in range(count):
        for k in range(len(listed)):
            items = np.int64(1)
            if listed[k]:
                if at >= len(numbers) or not 0.0 <= numbers[at] <= len(numbers):
                    return starts, counts, -1
                items = np.int64(numbers[at])
                if items != numbers[at]:
                    return starts, counts, -1
                at += 1
                if k == wanted:
                    starts[row], counts[row] = at, items
            at += items
            if at > len(numbers):
                return starts, counts, -1
    return starts, counts, at


@njit(cache=True)
def _gathered(body, starts, counts, size):
    """The bytes of all lists, one after another."""
    out = np.empty(counts.sum() * size, np.uint8)
    to = 0
    for row in range(len(starts)):
        for b in range(counts[row] * size):
            out[to] = body[starts[row] + b]
            to += 1
    return out
