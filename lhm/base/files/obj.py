"""Wavefront OBJ, and the pictures of its materials (MTL)."""

from __future__ import annotations

import os
from array import array
from collections.abc import Collection, Iterator
from contextlib import suppress
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


def read_obj(path: Path) -> tuple[Floats, Ints]:
    """Read the vertices (n, 3) of a Wavefront OBJ in the file's order, and its polygons as triangles (m, 3).

    Texture coordinates, normals, materials, lines and points are left out: a vertex that has two texture coordinates
    stays one. Negative indices count back from the last vertex. InputError names a line that is none of OBJ, vertices
    that are not finite and indices out of range.
    """
    found = _parse(path, textured=False)
    return found.vertices(), np.frombuffer(found.corners, np.int64)[found.cut()]


def read_obj_pictures(path: Path) -> list[Painted]:
    """Read which triangles of an OBJ have a picture, by `map_Kd` of their material, and where in it they lie.

    A picture that no triangle has is there with none. InputError as `read_obj`, for texture coordinates alike, and for
    a library of materials that is needed and cannot be read.
    """
    found = _parse(path, textured=True)
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
    names = [_material(name, maps) for name in found.names]
    painted = []
    for name, image in maps.items():
        chosen = has_place & np.isin(material, [k for k, each in enumerate(names) if each == name])
        there = places[of_corner[chosen]] * image.scale + image.offset
        painted.append(Painted(image.file, image.read, triangles[chosen], there, image.wraps))
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


def _parse(path: Path, *, textured: bool) -> _Parsed:
    content = read_bytes(path).removeprefix(MARK)  # names of materials may be in any encoding
    if b"\0" in content:
        raise InputError("not an OBJ file: it is no text")
    found, numbers, current = _Parsed(), {b"": 0}, 0
    for number, line, said in _lines(content):
        kind, *fields = said.split() or [b""]
        try:
            if b"_" in said and kind in (b"v", b"f"):  # 1_0 is a number to Python alone
                raise ValueError
            if kind == b"v":
                x, y, z = fields[:3]
                found.coordinates.extend((float(x), float(y), float(z)))
            elif kind == b"vt" and textured:
                found.places.extend((float(fields[0]), float(fields[1]) if len(fields) > 1 else 0.0))
            elif kind == b"f":
                if len(fields) < 3:
                    raise ValueError
                for corner in fields:
                    vertex, *others = corner.split(b"/")
                    found.corners.append(_index(vertex, len(found.coordinates) // 3))
                    if textured:
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
    """A picture of a material: its file, and how places in it are scaled, shifted and go on beyond it.

    The file lies beside one of `besides`: its library, or the OBJ.
    """

    besides: tuple[Path, Path]
    file: str
    scale: tuple[float, float]
    offset: tuple[float, float]
    wraps: tuple[str, str]

    def read(self) -> bytes:
        """Return the bytes of the picture."""
        library, path = self.besides
        return read_bytes(_find(library if _is_there(self.file, library) else path, self.file))


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
                place = _find(path, library)
                content = read_bytes(place).removeprefix(MARK)
            except InputError as error:
                refused.append(error)
                continue
            material = b""
            for text in content.splitlines():
                kind, *words = text.lower().split() or [b""]
                if kind == b"newmtl":
                    material = _rest(text)
                    known.add(material)
                elif kind == b"map_kd" and words:
                    maps.setdefault(material, _read_map(place, path, text))
    if refused and {_material(name, known) for name in needed} - known - {b""}:
        raise refused[0]
    return maps


def _material(name: bytes, known: Collection[bytes]) -> bytes:
    """Return a material's name as it is, or without a comment where only that is known."""
    return name if name in known else name.split(b" #")[0].strip()


def _read_map(library: Path, path: Path, line: bytes) -> _Map:
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
    file = _without_comment(os.fsdecode(rest), library, path)
    return _Map((library, path), file, pair(b"-s", 1.0), pair(b"-o", 0.0), (wrap, wrap))


def _is_number(word: bytes) -> bool:
    try:
        return np.isfinite(float(word)).item()
    except ValueError:
        return False


def _split_names(path: Path, line: bytes) -> list[str]:
    """Return the files that a line names: one whose name has spaces, or several."""
    text = _without_comment(os.fsdecode(line), path)
    return [text] if _is_there(text, path) else text.split()


def _without_comment(text: str, *besides: Path) -> str:
    """Return a name as it is where that is a file beside one of these, or else without what follows a #."""
    return text if _is_there(text, *besides) else text.split(" #")[0].strip()


def _is_there(name: str, *besides: Path) -> bool:
    for path in besides:
        with suppress(InputError):
            return _find(path, name).is_file()
    return False


def _find(path: Path, name: str) -> Path:
    """Find a file beside `path`, by a name that may be as Windows writes it, or quoted; InputError as `find_beside`."""
    return find_beside(path, name.strip('"').replace("\\", "/"))
