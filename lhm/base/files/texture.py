"""The colours of a scan: a picture, and where in it the scan's triangles lie; OBJ and glTF."""

from __future__ import annotations

import io
import os
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from ..errors import InputError
from ..geometry.bvh import TriangleTree
from ..limits import PIXELS
from ..mesh import Floats, Ints
from .gltf import read_gltf_pictures
from .obj import read_obj_pictures
from .painted import CLAMP, MIRROR, REPEAT, Painted
from .surface_file import read_scan
from .text import naming_file

if TYPE_CHECKING:
    from PIL.Image import Image

Look = tuple[Hashable, tuple[str, str], tuple[float, ...]]
"""Name, wraps and factor of `Painted`."""
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF", "MPO")
READERS = {".obj": read_obj_pictures, ".glb": read_gltf_pictures, ".gltf": read_gltf_pictures}


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture, and the triangles (m, 3) that have it: vertices (n, 3) where they lie, places (m, 3, 2) of corners.

    Places, wraps and factor are as `Painted` has them. `others`: how many more pictures the file has.
    """

    picture: Image
    vertices: Floats
    triangles: Ints
    places: Floats
    wraps: tuple[str, str] = (REPEAT, REPEAT)
    factor: tuple[float, ...] = (1.0, 1.0, 1.0)
    others: int = 0

    def find_colours(self, points: Floats) -> tuple[Floats, Floats]:
        """Find the colours (k, 3), 0 to 255, of the closest points of the triangles, and their distances (k,)."""
        triangle, weights, distance = TriangleTree(self.vertices, self.triangles).closest(points)
        places = np.einsum("kc,kcd->kd", weights, self.places[triangle])
        right, up = (_wrap(places[:, axis], self.wraps[axis]) for axis in range(2))
        pixels = np.asarray(self.picture)
        height, width, _ = pixels.shape
        at = np.stack([(1.0 - up) * height - 0.5, right * width - 0.5])
        mode = "grid-wrap" if set(self.wraps) == {REPEAT} else "nearest"
        found = [map_coordinates(pixels[:, :, c], at, np.float64, order=1, mode=mode) for c in range(3)]
        return _tint(np.stack(found, axis=1), self.factor), distance


def _wrap(places: Floats, how: str) -> Floats:
    """Return the places within a picture, 0 to 1, that stand for any."""
    if how == CLAMP:
        return np.clip(places, 0.0, 1.0)
    if how == MIRROR:
        return 1.0 - np.abs(places % 2.0 - 1.0)
    return places % 1.0


def _tint(colours: Floats, factor: tuple[float, ...]) -> Floats:
    """Multiply the linear light of colours (k, 3), 0 to 255, by a factor (IEC 61966-2-1)."""
    if set(factor) == {1.0}:
        return colours
    share = colours / 255.0
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    light = np.clip(light * factor, 0.0, 1.0)
    return 255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def read_texture(path: str | os.PathLike[str], vertices: Floats | None = None) -> Texture | None:
    """Read a scan's texture; None without one, or in another kind of file.

    vertices (n, 3): where those of `read_scan` lie, by default as it has them.

    Of several pictures the one that most triangles have counts. InputError, one line that names the file, for a picture
    that is missing, outside the file's folder, or damaged.
    """
    path = Path(path)
    read = READERS.get(path.suffix.lower())
    if read is None:
        return None
    with naming_file(path):
        by_look: dict[Look, list[Painted]] = {}
        for part in read(path):
            by_look.setdefault((part.name, part.wraps, part.factor), []).append(part)
        if not by_look:
            return None
        parts = max(by_look.values(), key=lambda parts: sum(len(part.triangles) for part in parts))
        one = parts[0]
        if not any(len(part.triangles) for part in parts):
            raise InputError("no triangle has a place in its picture")
        return Texture(
            _decode(one.read()),
            read_scan(path).vertices if vertices is None else vertices,
            np.concatenate([part.triangles for part in parts]),
            np.concatenate([part.places for part in parts]),
            one.wraps,
            one.factor,
            len({name for name, _, _ in by_look}) - 1,
        )


def _decode(content: bytes) -> Image:
    """Decode a picture as 8 bits of red, green and blue."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content), formats=FORMATS) as picture:
            PIXELS.check("its picture", picture.width * picture.height)
            if picture.mode[0] in "IF":  # which Pillow would cut off at 255
                grey = np.asarray(picture)
                if picture.mode == "F" or grey.min() < 0 or grey.max() > 65535:
                    raise InputError("its picture has more than 16 bits; export it with 8 or 16")
                return Image.fromarray((grey // 257).astype(np.uint8)).convert("RGB")
            return picture.convert("RGB")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"its picture is damaged, or none of {', '.join(FORMATS)}") from None
