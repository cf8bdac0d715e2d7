"""The triangles of a mesh file that have a picture, as its readers find them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import NamedTuple

from ..mesh import Floats, Ints


class Painted(NamedTuple):
    """Triangles (m, 3) over the file's vertices, and the places (m, 3, 2) of their corners in a picture.

    Places are right and up from the picture's lower left corner, in its width and height; `wraps` says how they go on
    beyond, by axis: REPEAT, CLAMP or MIRROR. `read` gives the picture's bytes, `name` tells pictures apart. Linear
    light is multiplied by `factor`, red, green and blue.
    """

    name: Hashable
    read: Callable[[], bytes]
    triangles: Ints
    places: Floats
    wraps: tuple[str, str] = ("repeat", "repeat")
    factor: tuple[float, ...] = (1.0, 1.0, 1.0)


REPEAT, CLAMP, MIRROR = "repeat", "clamp", "mirror"
