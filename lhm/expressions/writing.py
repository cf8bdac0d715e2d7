"""Takes to files: a CSV with a row per quantity, as `read_take` reads it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..base.errors import InputError
from ..base.files.atomic import write_whole
from ..base.mesh import Floats
from ..identities.arkit import ARKIT
from .readers import HEAD, TIME
from .takes import Take, rotations


def write_take(path: str | os.PathLike[str], take: Take, more: Mapping[str, Floats] | None = None) -> None:
    """Write a take to a .csv file, whole or not at all, less the expressions that it lacks.

    `more`: further rows by name, shape (frames,), which readers of takes ignore. Raises InputError for a file that
    cannot be written or does not end in .csv.
    """
    if Path(path).suffix != ".csv":
        raise InputError(f"{path}: expected a file that ends in .csv")
    rows = {TIME: take.times}
    rows |= {name: take.weights[:, k] for k, name in enumerate(ARKIT) if name not in take.missing}
    if take.head is not None:
        rows |= dict(zip(HEAD, Rotation.from_matrix(rotations(take.head)).as_quat().T, strict=True))
    rows |= dict(more or {})
    lines = [",".join(["frames", *map(str, range(len(take.times)))])]
    lines += [
        ",".join([name, *(f"{np.round(value, 9) + 0.0:.10g}" for value in values)]) for name, values in rows.items()
    ]
    write_whole(path, ("\n".join(lines) + "\n").encode())
