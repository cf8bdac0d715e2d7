"""What all people of a corpus share, in a file of its own: the mean skin, its triangles, and the 52 shapes."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from ...lhm.base.checks import finite
from ...lhm.base.errors import InputError, SoftdecaError, shown
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.mesh import Floats, Surface

FILE = "template.npz"
FARTHEST = 1e4
"""[mm] Of a vertex, and of how far a shape moves one: ten metres."""


@dataclass(frozen=True, eq=False)
class CorpusTemplate:
    """The mean neutral skin [mm]; shapes (52, n, 3) [mm], None where each person has personal ones."""

    mean: Surface
    shapes: Floats | None


def write_template(folder: str | PathLike[str], template: CorpusTemplate) -> None:
    """Write it to a corpus' folder; InputError if it cannot be written."""
    arrays = {"vertices": template.mean.vertices, "triangles": template.mean.triangles}
    write_arrays(Path(folder) / FILE, arrays | ({} if template.shapes is None else {"shapes": template.shapes}))


def read_template(folder: str | PathLike[str]) -> CorpusTemplate:
    """Read it; InputError names the file if it is missing, damaged, or not in millimetres."""
    path = Path(folder) / FILE
    arrays = read_arrays(path, of="a corpus' template")
    try:
        if not {"vertices", "triangles"} <= set(arrays) <= {"vertices", "triangles", "shapes"}:
            raise InputError(f"expected vertices, triangles and shapes, got {shown(', '.join(arrays))}")
        vertices = finite("vertices", arrays["vertices"], (None, 3), most=FARTHEST)
        shapes = arrays.get("shapes")
        if shapes is not None:
            shapes = finite("shapes", shapes, (52, len(vertices), 3), most=FARTHEST)
        return CorpusTemplate(Surface(vertices, arrays["triangles"]), shapes)
    except SoftdecaError as error:
        raise InputError(f"{path}: not a corpus' template, or damaged ({error})") from None
