"""What all people of a corpus share, in a file of its own: the mean skin, its triangles, and the 52 shapes."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from ...lhm.errors import InputError
from ...lhm.files.npz import read_arrays, write_arrays
from ...lhm.mesh import Floats, Surface

FILE = "template.npz"


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
    """Read it; InputError if it is missing or damaged."""
    path = Path(folder) / FILE
    arrays = read_arrays(path, of="a corpus' template")
    if not {"vertices", "triangles"} <= set(arrays):
        raise InputError(f"{path}: not a corpus' template")
    return CorpusTemplate(Surface(arrays["vertices"], arrays["triangles"]), arrays.get("shapes"))
