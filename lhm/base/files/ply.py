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

from ..errors import InputError, quote
from ..limits import TRIANGLES, VERTICES
from ..mesh import Floats, Ints
from .text import parse_number, read_bytes

KINDS = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
KINDS |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
KINDS |= {"double": "f8", "float32": "f4", "float64": "f8"}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 65536
"""Bytes within which the header ends."""
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


def read_ply(path: Path) -> tuple[Floats, Ints]:
    """Read vertices (n, 3) in the file's order, and triangles (m, 3); polygons become fans.

    InputError where the header is none, promises more than the file has or less, or names no x, y and z.
    """
    content = read_bytes(path)
    match = re.match(rb"ply\s(.*?)\nend_header[ \t]*\r?\n?", content[:LONGEST_HEADER], re.DOTALL)
    if match is None:
        raise InputError("not a PLY file: its header has no end, or does not begin with 'ply'")
    is_text, elements = _header(match[1].decode("ascii", errors="replace").splitlines())
    names = [element.name for element in elements]
    if "vertex" not in names or len(set(names)) < len(names):
        raise InputError("its header names no vertices, or an element twice")
    size = len(content) - match.end()
    for element in elements:
        least = sum(2 if is_text else (p.length or p.kind).itemsize for p in element.properties)
        if element.count * least > size + 1:
            raise InputError(f"{ENDED} ({element.count} times {quote(element.name)!r})")
    body = _numbers_of_text(content[match.end() :]) if is_text else np.frombuffer(content, np.uint8, size, match.end())
    place, vertices, triangles = 0, np.zeros((0, 3)), [np.zeros((0, 3), dtype=np.int64)]
    for element in elements:
        if element.name == "vertex":
            VERTICES.check("it has", element.count)
            vertices, place = _vertices(body, place, element)
        else:
            wanted = _list_of_vertices(element) if element.name in ("face", "tristrips") else -1
            values, lengths, place = _lists(body, place, element, wanted)
            if wanted >= 0:
                triangles.append((_fans if element.name == "face" else _strips)(_as_indices(values), lengths))
    if bytes(body[place:]).strip(b"\0 \t\r\n"):
        raise InputError("it goes on after the elements that its header promises")
    joined = np.vstack(triangles)
    TRIANGLES.check("it has", len(joined))
    return vertices, joined


def _header(lines: list[str]) -> tuple[bool, list[_Element]]:
    """Return whether the body is text, and the elements; a text's numbers are all float64."""
    order, elements = None, []
    for line in lines:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in FORMATS and order is None:
            order = FORMATS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal() and len(words[2]) <= 15:
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and order is not None:
            element = elements.pop()
            elements.append(_Element(element.name, element.count, (*element.properties, _property(words, order))))
        else:
            raise InputError(f"its header has a line that no PLY file has: {quote(line, 60)!r}")
    if order is None:
        raise InputError("its header names no format that is read: ascii, binary_little_endian, binary_big_endian")
    return not order, elements


def _property(words: list[str], order: str) -> _Property:
    kinds, name = words[1:-1], words[-1]
    is_list = kinds[:1] == ["list"]
    kinds = kinds[1:] if is_list else kinds
    if len(kinds) != 1 + is_list or not set(kinds) <= set(KINDS):
        raise InputError(f"its header names a kind of number that no PLY file has: {quote(' '.join(words), 60)!r}")
    dtypes = [np.dtype((order or "<") + KINDS[kind]) for kind in kinds]
    if is_list and dtypes[0].kind == "f":
        raise InputError("its header has a list whose length is no integer")
    return _Property(name, dtypes[-1], dtypes[0] if is_list else None)


def _numbers_of_text(body: bytes) -> Floats:
    body = body.rstrip(b"\0\x1a \t\r\n")
    if not body:
        return np.zeros(0)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("error", DeprecationWarning)  # where it would end at what is no number
        try:
            return np.fromstring(body, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            raise InputError(f"its body has {_find_no_number(body)!r}, which is no number") from None


def _find_no_number(body: bytes) -> str:
    """Return the first word that is no number, in part."""
    for match in re.finditer(rb"\S+", body):
        word = match[0].decode("ascii", errors="replace")
        try:
            parse_number(word)
        except ValueError:
            return quote(word, 40)
    return "a word"


def _vertices(body: np.ndarray, place: int, element: _Element) -> tuple[Floats, int]:
    """Return the vertices (n, 3), and the place behind them."""
    names = [p.name for p in element.properties]
    if any(p.length for p in element.properties) or any(names.count(axis) != 1 for axis in "xyz"):
        raise InputError("its header names no x, y and z of the vertices, or lists among them")
    columns = [names.index(axis) for axis in "xyz"]
    row = np.dtype([(str(k), p.kind) for k, p in enumerate(element.properties)])
    width = len(names) if body.dtype == np.float64 else row.itemsize
    end = place + element.count * width
    if end > len(body):
        raise InputError(ENDED)
    with np.errstate(invalid="ignore"):  # NaN is refused where the mesh is made
        if body.dtype == np.float64:
            return body[place:end].reshape(-1, width)[:, columns], end
        table = body[place:end].view(row)
        return np.stack([table[str(k)].astype(np.float64) for k in columns], axis=1), end


def _list_of_vertices(element: _Element) -> int:
    """Return the number of the property that lists an element's vertices."""
    lists = [k for k, p in enumerate(element.properties) if p.length]
    named = [k for k in lists if element.properties[k].name in ("vertex_indices", "vertex_index")]
    if not lists or element.properties[(named or lists)[0]].kind.kind == "f":
        raise InputError(f"its header names no vertices of the elements {quote(element.name)!r}")
    return (named or lists)[0]


def _lists(body: np.ndarray, place: int, element: _Element, wanted: int) -> tuple[np.ndarray, Ints, int]:
    """Return the numbers of the list `wanted` (-1: none) of all elements, the lists' lengths, and the place behind."""
    is_text = body.dtype == np.float64
    sizes, widths = np.ones((2, len(element.properties)), np.int64)
    dtypes = [p.length for p in element.properties]
    if not is_text:
        sizes[:] = [p.kind.itemsize for p in element.properties]
        widths[:] = [d.itemsize if d else 0 for d in dtypes]
    else:
        widths[:] = [d is not None for d in dtypes]
    signed = np.array([d is not None and d.kind == "i" for d in dtypes], dtype=np.bool_)
    big = np.array([d is not None and d.byteorder == ">" for d in dtypes], dtype=np.bool_)
    count = element.count if element.properties else 0
    starts, lengths, end = _walk(body, is_text, place, count, sizes, widths, signed, big, wanted)
    if end < 0:
        raise InputError(ENDED)
    if wanted < 0:
        return np.zeros(0), lengths, end
    values = _gather(body, starts, lengths * sizes[wanted])
    return values if is_text else values.view(element.properties[wanted].kind), lengths, end


def _as_indices(values: np.ndarray) -> Ints:
    if values.dtype.kind == "f":  # of text
        if len(values) and not (np.abs(values) < 2**53).all():
            raise InputError("triangles: indices are not finite, or far outside the vertices")
        if (values != np.round(values)).any():
            raise InputError("triangles: an index is no integer")
    return values.astype(np.int64)


def _fans(corners: Ints, lengths: Ints) -> Ints:
    """Return the triangles of polygons, each from its first corner; those of less than three corners have none."""
    ends = np.cumsum(lengths)
    counts = np.maximum(lengths - 2, 0)
    first = np.repeat(ends - lengths, counts)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([corners[first], corners[first + within + 1], corners[first + within + 2]], axis=1)


def _strips(corners: Ints, lengths: Ints) -> Ints:
    """Return the triangles of strips, each ended by -1; every other one is turned, and a repeated corner has none."""
    triangles = [np.zeros((0, 3), dtype=np.int64)]
    ends = np.union1d(np.flatnonzero(corners < 0), np.cumsum(lengths)[:-1])
    for strip in np.split(corners, ends):
        ids = strip[strip >= 0]
        if len(ids) > 2:
            turned = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1)
            turned[1::2] = turned[1::2, ::-1]
            triangles.append(turned[(turned != np.roll(turned, 1, axis=1)).all(axis=1)])
    return np.vstack(triangles)


@njit(cache=True)
def _walk(body, is_text, at, count, sizes, widths, signed, big, wanted):
    """Return place and length of the wanted list of each element, and the place behind the last; -1 at the body's end.

    `body` holds bytes, or the numbers of a text, of which each has size and width 1.
    """
    n = count if wanted >= 0 else 0
    starts, counts = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for row in range(count):
        for k in range(len(sizes)):
            items = np.int64(1)
            if widths[k] > 0:
                width = widths[k]
                if at + width > len(body):
                    return starts, counts, -1
                if is_text:
                    if not 0.0 <= body[at] <= len(body):
                        return starts, counts, -1
                    items = np.int64(body[at])
                    if items != body[at]:
                        return starts, counts, -1
                else:
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
def _gather(body, starts, counts):
    """Return the entries of all lists, one after another."""
    out = np.empty(counts.sum(), body.dtype)
    to = 0
    for row in range(len(starts)):
        for b in range(counts[row]):
            out[to] = body[starts[row] + b]
            to += 1
    return out
