"""The colours of a scan: a picture, and where in it the scan's vertices lie; OBJ and glTF, as trimesh reads them."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np

from ..errors import InputError, one_line
from ..geometry.bvh import TriangleTree
from ..limits import PIXELS
from ..mesh import Floats, Ints
from .text import find_beside, naming_file, read_bytes

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF", "MPO")


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture, and the triangles (m, 3) that have it: vertices (n, 3) where they lie, places (n, 2) in the picture.

    Places are right and up from the picture's lower left corner, in its width and height; they repeat beyond 1.
    """

    picture: Image
    vertices: Floats
    triangles: Ints
    places: Floats

    def with_vertices(self, vertices: Floats) -> Texture:
        """Return the texture of the same triangles elsewhere."""
        return replace(self, vertices=vertices)

    def find_colours(self, points: Floats) -> tuple[Floats, Floats]:
        """Find the colours (k, 3), 0 to 255, of the closest points of the triangles, and their distances (k,)."""
        from trimesh.visual.color import uv_to_interpolated_color

        triangle, weights, distance = TriangleTree(self.vertices, self.triangles).closest(points)
        places = np.einsum("kc,kcd->kd", weights, self.places[self.triangles[triangle]])
        return uv_to_interpolated_color(places, self.picture)[:, :3].astype(np.float64), distance


def read_texture(path: str | os.PathLike[str]) -> Texture | None:
    """Read a scan's texture, where `read_scan` has its vertices; None without one, or in another kind of file.

    Of several parts with a picture the largest counts. InputError, one line that names the file, for a picture that is
    missing, outside the file's folder, or damaged.
    """
    path = Path(path)
    if path.suffix.lower() not in (".obj", ".glb", ".gltf"):
        return None
    with naming_file(path):
        scene = _read_scene(path)
        placed = [(scene.geometry[name], matrix) for matrix, name in map(scene.graph.get, scene.graph.nodes_geometry)]
        parts = [(mesh, matrix) for mesh, matrix in placed if _picture_of(mesh) is not None]
        if not parts:
            return None
        mesh, matrix = max(parts, key=lambda part: len(part[0].faces))
        vertices = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        if not np.ptp(vertices, axis=0).any():  # trimesh has zeros in place of what Draco packed
            raise InputError("its texture lies on a mesh packed by Draco, and is not read")
        return Texture(_decode(_picture_of(mesh)), vertices, np.array(mesh.faces), np.array(mesh.visual.uv))


class _Beside(dict):
    """Reads what a file names from its folder, and keeps what is refused: trimesh goes on without."""

    def __init__(self, path: Path):
        super().__init__()
        self.path = path
        self.refused: list[InputError] = []

    def get(self, name: str) -> bytes:  # type: ignore[override]
        try:
            return read_bytes(find_beside(self.path, unquote(name)))
        except InputError as error:
            self.refused.append(error)
            raise

    __getitem__ = get


def _read_scene(path: Path):
    """Return trimesh's scene of a file."""
    from trimesh import load_scene

    beside, content = _Beside(path), io.BytesIO(read_bytes(path))
    try:
        scene = load_scene(content, file_type=path.suffix.lower()[1:], resolver=beside, process=False)
    except Exception as error:  # trimesh raises whatever the damage makes it raise
        raise InputError(f"its texture cannot be read ({one_line(str(error))[:80]})") from None
    if beside.refused:
        raise beside.refused[0]
    return scene


def _picture_of(mesh) -> Any:
    """Return the picture of a part, if it has one from the file, and places in it."""
    material = getattr(mesh.visual, "material", None)
    picture = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    has_places = getattr(mesh.visual, "uv", None) is not None
    return picture if has_places and getattr(picture, "format", None) in FORMATS else None


def _decode(picture: Image) -> Image:
    PIXELS.check("its picture", picture.width * picture.height)
    try:
        return picture.convert("RGB")
    except (OSError, ValueError, SyntaxError):
        raise InputError(f"its picture is damaged, or none of {', '.join(FORMATS)}") from None
