"""The colours of a scan: a picture, and where in it the corners of the scan's triangles lie; OBJ and glTF."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..limits import PIXELS
from ..mesh import Floats, Ints
from .gltf import read_gltf_picture
from .text import find_beside, naming_file, read_bytes

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture (h, w, 3), 0 to 255, and places (m, 3, 2) in it of the corners of a scan's triangles.

    Places are right and down from the picture's upper left corner, in its width and height. They repeat beyond 1, and
    are NaN where a triangle has none.
    """

    picture: NDArray[np.uint8]
    corners: Floats

    def find_colours(self, triangles: Ints, weights: Floats) -> Floats:
        """Find the colours (k, 3), 0 to 255, of points in triangles (k,), with barycentric weights (k, 3).

        Bilinear; NaN for a point in a triangle that has no place in the picture.
        """
        height, width = self.picture.shape[:2]
        place = np.einsum("kc,kcd->kd", weights, self.corners[triangles])
        known = np.isfinite(place).all(axis=1)
        x, y = ((place[known] % 1.0) * (width, height) - 0.5).T
        left, upper = np.floor(x).astype(int), np.floor(y).astype(int)
        found = np.full((len(place), 3), np.nan)
        found[known] = 0.0
        for across, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
            share = np.abs(1 - across - (x - left)) * np.abs(1 - down - (y - upper))
            found[known] += share[:, None] * self.picture[(upper + down) % height, (left + across) % width]
        return found


def read_texture(path: str | os.PathLike[str]) -> Texture | None:
    """Read a scan's texture, for its triangles as `read_scan` has them; None without one, or in another kind of file.

    Of several pictures the one counts that most triangles have. InputError, one line that names the file, for a picture
    that is missing or damaged.
    """
    path = Path(path)
    read = {".obj": _read_obj, ".glb": read_gltf_picture, ".gltf": read_gltf_picture}.get(path.suffix.lower())
    with naming_file(path):
        found = None if read is None else read(path)
        return None if found is None else Texture(_decode(found[0]), found[1])


def _decode(content: bytes) -> NDArray[np.uint8]:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(content), formats=FORMATS) as image:
            PIXELS.check("its picture", image.width * image.height)
            return np.asarray(image.convert("RGB"))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"its picture is damaged, or none of {', '.join(FORMATS)}") from None


def _read_obj(path: Path) -> tuple[bytes, Floats] | None:
    """Read the picture's bytes and the corners' places (m, 3, 2) of an OBJ that `read_obj` has found sound."""
    content = read_bytes(path)
    if b"vt " not in content or b"mtllib" not in content:
        return None
    content = content.removeprefix(b"\xef\xbb\xbf").replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    places: list[tuple[float, float]] = []
    corners: list[tuple[int, int, int]] = []
    material, of_triangle, library = b"", [], ""
    for line in content.splitlines():
        kind, *words = line.partition(b"#")[0].split() or [b""]
        if kind == b"vt":
            u, v = (float(word) for word in words[:2])
            places.append((u, 1.0 - v))
        elif kind == b"f":
            ids = [_place_of(word, len(places)) for word in words]
            corners += [(ids[0], b, c) for b, c in zip(ids[1:-1], ids[2:], strict=True)]
            of_triangle += [material] * (len(ids) - 2)
        elif kind == b"usemtl":
            material = b" ".join(words)
        elif kind == b"mtllib":
            library = b" ".join(words).decode("utf-8", "replace")
    if not places or not library:
        return None
    pictures = _read_materials(find_beside(path, library))
    names = [name for name in of_triangle if name in pictures]
    if not names:
        return None
    chosen = pictures[max(dict.fromkeys(names), key=names.count)]
    table = np.vstack([np.array(places), np.full((1, 2), np.nan)])  # the last, -1, is no place
    is_drawn = np.array([pictures.get(name) == chosen for name in of_triangle])
    found = np.where(is_drawn[:, None, None], table[np.array(corners)], np.nan)
    return read_bytes(find_beside(path, chosen)), found


def _place_of(word: bytes, count: int) -> int:
    """Return the number of a corner's place, -1 where it has none."""
    _, slash, rest = word.partition(b"/")
    number = rest.partition(b"/")[0]
    if not slash or not number:
        return -1
    k = int(number)
    k = k - 1 if k > 0 else count + k
    if not 0 <= k < count:
        raise InputError(f"a corner has the texture coordinate {int(number)} of {count}")
    return k


def _read_materials(path: Path) -> Mapping[bytes, str]:
    """Read the file names of materials' pictures."""
    pictures: dict[bytes, str] = {}
    material = b""
    for line in read_bytes(path).splitlines():
        kind, *words = line.split() or [b""]
        if kind == b"newmtl":
            material = b" ".join(words)
        elif kind == b"map_Kd" and words:
            pictures[material] = b" ".join(words).decode("utf-8", "replace")
    return pictures
