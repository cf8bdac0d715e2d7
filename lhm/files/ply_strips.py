"""PLY files whose triangles are strips, as the Stanford scans and Igea are: vertices, then lists ended by -1."""

from __future__ import annotations

import re

import numpy as np

from ..errors import InputError
from ..mesh import Floats, Ints

KINDS = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
KINDS |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
KINDS |= {"double": "f8", "float32": "f4", "float64": "f8"}
ENDED = "the file is cut off: it has not the elements that its header promises"


def read_strips(content: bytes) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and triangles (m, 3) of such a file; InputError where it is cut off or of another order."""
    header, _, body = content.partition(b"end_header")
    text = header.decode("ascii", errors="replace")
    body = body[body.index(b"\n") + 1 :] if b"\n" in body else b""
    elements = re.findall(r"^element (\w+) (\d+)\s*$((?:\s*^property .*$)*)", text, re.MULTILINE)
    if [name for name, _, _ in elements] != ["vertex", "tristrips"]:
        raise InputError("its triangles are strips beside other elements, which are not read; save it with plain faces")
    properties = re.findall(r"^property (\w+) (\w+)\s*$", elements[0][2], re.MULTILINE)
    lists = re.findall(r"^property list (\w+) (\w+) (\w+)\s*$", elements[1][2], re.MULTILINE)
    names = [name for _, name in properties]
    kinds = {kind for kind, _ in properties} | {kind for entry in lists for kind in entry[:2]}
    if not {"x", "y", "z"} <= set(names) or not kinds <= set(KINDS) or len(lists) != 1:
        raise InputError("its header names no x, y and z, or kinds of numbers that no PLY file has")
    count, strips = int(elements[0][1]), int(elements[1][1])
    if "format ascii" in text:
        numbers = np.array(body.split(), dtype=np.float64)
        x, rest = _some(numbers, count * len(names)).reshape(count, -1), numbers[count * len(names) :].astype(np.int64)
        runs = []
        for _ in range(strips):
            length = int(_some(rest, 1)[0])
            runs.append(_some(rest[1:], length))
            rest = rest[1 + length :]
        return x[:, [names.index(axis) for axis in "xyz"]], _triangles(runs)
    order = "<" if "binary_little_endian" in text else ">"
    row = np.dtype([(name, order + KINDS[kind]) for kind, name in properties])
    rows = _frombuffer(body, row, count)
    size, kind = (np.dtype(order + KINDS[name]) for name in lists[0][:2])
    runs, at = [], count * row.itemsize
    for _ in range(strips):
        length = int(_frombuffer(body[at : at + size.itemsize], size, 1)[0])
        at += size.itemsize
        runs.append(_frombuffer(body[at : at + length * kind.itemsize], kind, length).astype(np.int64))
        at += length * kind.itemsize
    return np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1), _triangles(runs)


def _some(numbers: np.ndarray, count: int) -> np.ndarray:
    if not 0 <= count <= len(numbers):
        raise InputError(ENDED)
    return numbers[:count]


def _frombuffer(content: bytes, kind: np.dtype, count: int) -> np.ndarray:
    if not 0 <= count * kind.itemsize <= len(content):
        raise InputError(ENDED)
    return np.frombuffer(content, dtype=kind, count=count)


def _triangles(runs: list[np.ndarray]) -> Ints:
    """The triangles of lists of strips, each ended by -1; every other one is turned, and a repeated corner has none."""
    found = [np.zeros((0, 3), dtype=np.int64)]
    for run in runs:
        for strip in np.split(run, np.flatnonzero(run < 0)):
            ids = strip[strip >= 0]
            if len(ids) > 2:
                triangles = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1)
                triangles[1::2] = triangles[1::2, ::-1]
                found.append(triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)])
    return np.vstack(found)
