"""Wavefront OBJ, and the pictures of its materials (MTL)."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..checks import indices_below
from ..errors import InputError, MeshError, quote
from ..limits import VERTICES
from ..mesh import Floats, Ints, as_points
from .painted import CLAMP, REPEAT, Painted
from .polygons import cut_polygons
from .text import find_beside, read_bytes

MARK = b"\xef\xbb\xbf"
"""Begins a text in UTF-8 that Windows wrote."""
CONTINUED = {b"v", b"vt", b"vn", b"f", b"l", b"p"}
"""Lines that may go on after a backslash; in a name or a comment it is part of a path."""
NO_PLACE = 0
"""A corner's number of a texture coordinate where it has none; they count from 1, or back from -1."""


def read_obj(path: Path) -> tuple[Floats, Ints]:
    """Read the vertices (n, 3) of a Wavefront OBJ in the file's order, and its polygons as triangles (m, 3).

    Texture coordinates, normals, materials, lines and points are left out: a vertex that has two texture coordinates
    stays one. Negative indices count back from the last vertex. InputError names a line that is none of OBJ, vertices
    that are not finite and indices out of range.
    """
    found = _parse(path)
    return found.vertices(), found.triangles()


def read_obj_pictures(path: Path) -> list[Painted]:
    """Read which triangles of an OBJ have a picture, by `map_Kd` of their material, and where in it they lie.

    InputError as `read_obj`, and for a library of materials that is needed and cannot be read.
    """
    found = _parse(path)
    cut = found.cut()
    triangles = np.frombuffer(found.corners, np.int64)[cut]
    material = np.repeat(found.materials, np.maximum(np.array(found.lengths) - 2, 0))
    if not any(found.names):
        return []
    maps = _read_libraries(path, found.libraries, set(found.names))
    places = np.frombuffer(found.places, np.float64).reshape(-1, 2)
    of_corner = np.frombuffer(found.place_ids, np.int64)[cut]
    has_place = (of_corner >= 0).all(axis=1)
    indices_below("texture coordinates", of_corner[has_place], len(places))
    painted = []
    for number, name in enumerate(found.names):
        chosen = has_place & (material == number)
        if name in maps and chosen.any():
            map_ = maps[name]
            there = places[of_corner[chosen]] * map_.scale + map_.offset
            painted.append(Painted(map_.file, map_.read, triangles[chosen], there, map_.wraps))
    return painted


@dataclass
class _Parsed:
    """Numbers of an OBJ's lines: coordinates, polygons' corners and lengths; of texture, where it is asked for."""

    coordinates: array = field(default_factory=lambda: array("d"))
    corners: array = field(default_factory=lambda: array("q"))
    lengths: array = field(default_factory=lambda: array("q"))
    places: array = field(default_factory=lambda: array("d"))
    place_ids: array = field(default_factory=lambda: array("q"))
    materials: array = field(default_factory=lambda: array("q"))
    names: list[bytes] = field(default_factory=lambda: [b""])
    libraries: list[bytes] = field(default_factory=list)

    def vertices(self) -> Floats:
        try:
            return as_points("vertices", np.frombuffer(self.coordinates, np.float64).reshape(-1, 3))
        except MeshError as error:
            raise InputError(str(error)) from None

    def cut(self) -> Ints:
        """Return numbers of corners (m, 3), in the order of the file's polygons."""
        vertices = self.vertices()
        corners = indices_below("triangles", np.frombuffer(self.corners, np.int64), len(vertices))
        return cut_polygons(vertices[corners], np.frombuffer(self.lengths, np.int64))

    def triangles(self) -> Ints:
        return np.frombuffer(self.corners, np.int64)[self.cut()]


def _parse(path: Path) -> _Parsed:
    content = read_bytes(path).removeprefix(MARK)  # names of materials may be in any encoding
    if b"\0" in content:
        raise InputError("not an OBJ file: it is no text")
    found, numbers, current = _Parsed(), {b"": 0}, 0
    for number, line, said in _lines(content):
        kind, *fields = said.split() or [b""]
        try:
            if b"_" in said and kind in (b"v", b"vt", b"f"):  # 1_0 is a number to Python alone
                raise ValueError
            if kind == b"v":
                x, y, z = fields[:3]
                found.coordinates.extend((float(x), float(y), float(z)))
            elif kind == b"vt":
                found.places.extend((float(fields[0]), float(fields[1]) if len(fields) > 1 else 0.0))
            elif kind == b"f":
                if len(fields) < 3:
                    raise ValueError
                for corner in fields:
                    vertex, *others = corner.split(b"/")
                    found.corners.append(_index(vertex, len(found.coordinates) // 3))
                    place = others[0] if others else b""
                    found.place_ids.append(_index(place, len(found.places) // 2) if place else -1)
                found.lengths.append(len(fields))
                found.materials.append(current)
            elif kind == b"usemtl":
                name = _rest(line)
                current = numbers.setdefault(name, len(numbers))
                if current == len(found.names):
                    found.names.append(name)
            elif kind == b"mtllib":
                found.libraries.append(_rest(line))
        except (ValueError, OverflowError, IndexError):
            shown = quote(line.strip().decode("utf-8", "replace"), 60)
            raise InputError(f"line {number} is none of an OBJ file: {shown!r}") from None
    VERTICES.check("it has", len(found.coordinates) // 3)
    return found


def _lines(content: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield number and text of each line, and the text without comment, joined to lines that it goes on in."""
    held = b""
    for number, line in enumerate(content.splitlines(), start=1):
        said = held + line.partition(b"#")[0]
        held = b""
        if said.endswith(b"\\") and (said.split(None, 1) or [b""])[0] in CONTINUED:
            held = said[:-1] + b" "
        else:
            yield number, line, said
    if held:
        yield number, line, held


def _rest(line: bytes) -> bytes:
    """Return what follows a line's first word."""
    return (line.split(None, 1) + [b""])[1].strip()


def _index(text: bytes, count: int) -> int:
    value = int(text)
    if value == 0 or value < -count:
        raise ValueError
    return value - 1 if value > 0 else count + value


class _Map(NamedTuple):
    """A picture of a material: its file, and how places in it are scaled, shifted and go on beyond it."""

    library: Path
    file: str
    scale: tuple[float, float]
    offset: tuple[float, float]
    wraps: tuple[str, str]

    def read(self) -> bytes:
        """Return the bytes of the picture."""
        return read_bytes(_find(self.library, self.file))


OPTIONS = {b"-s": 3, b"-o": 3, b"-t": 3, b"-mm": 2}
"""Options of a map that have so many numbers, or fewer; any other has one word."""


def _read_libraries(path: Path, listed: list[bytes], needed: set[bytes]) -> dict[bytes, _Map]:
    """Return the pictures by material; InputError for a library that cannot be read while a material is missing."""
    maps: dict[bytes, _Map] = {}
    known: set[bytes] = set()
    refused: list[InputError] = []
    for line in listed:
        for library in _split_names(path, line):
            try:
                content = read_bytes(_find(path, library)).removeprefix(MARK)
            except InputError as error:
                refused.append(error)
                continue
            material = b""
            for text in content.splitlines():
                kind, *words = text.split() or [b""]
                if kind == b"newmtl":
                    material = _rest(text)
                    known.add(material)
                elif kind.lower() == b"map_kd" and words:
                    maps.setdefault(material, _read_map(path, text))
    if refused and needed - known - {b""}:
        raise refused[0]
    return maps


def _read_map(path: Path, line: bytes) -> _Map:
    rest = _rest(line)
    options: dict[bytes, list[bytes]] = {}
    while rest.startswith(b"-") and len(rest.split(None, 1)) == 2:
        option, rest = rest.split(None, 1)
        values = options.setdefault(option, [])
        while len(values) < OPTIONS.get(option, 1) and len(rest.split(None, 1)) == 2:
            word, after = rest.split(None, 1)
            if option in OPTIONS and not _is_number(word):
                break
            values.append(word)
            rest = after

    def pair(option: bytes, usual: float) -> tuple[float, float]:
        numbers = [*map(float, options.get(option, ())), usual, usual]
        return numbers[0], numbers[1]

    wrap = CLAMP if options.get(b"-clamp") == [b"on"] else REPEAT
    return _Map(path, _without_comment(path, os.fsdecode(rest)), pair(b"-s", 1.0), pair(b"-o", 0.0), (wrap, wrap))


def _is_number(word: bytes) -> bool:
    try:
        return np.isfinite(float(word)).item()
    except ValueError:
        return False


def _split_names(path: Path, line: bytes) -> list[str]:
    """Return the files that a line names: one whose name has spaces, or several."""
    text = _without_comment(path, os.fsdecode(line))
    return [text] if _is_there(path, text) else text.split()


def _without_comment(path: Path, text: str) -> str:
    """Return a name as it is, or without what follows a # where only that is a file."""
    short = text.split(" #")[0].strip()
    return short if short != text and not _is_there(path, text) else text


def _is_there(path: Path, name: str) -> bool:
    try:
        _find(path, name)
    except InputError:
        return False
    return True


def _find(path: Path, name: str) -> Path:
    """Find a file beside `path`, also by a name as Windows writes it; InputError as `find_beside`."""
    return find_beside(path, name.replace("\\", "/"))
