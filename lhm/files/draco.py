"""Draco's compressed meshes, by the package DracoPy."""

from __future__ import annotations

import numpy as np

from ..errors import InputError, MissingDependencyError
from ..mesh import Floats, Ints


def decode_draco(content: bytes, position: int) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and triangles (m, 3) of a Draco buffer; `position`: its attribute of positions, by unique id.

    MissingDependencyError without DracoPy, InputError for a damaged buffer.
    """
    try:
        import DracoPy
    except ModuleNotFoundError:
        raise MissingDependencyError(
            "this file is compressed by Draco: pip install 'softdeca[draco]', or export it without compression"
        ) from None
    try:
        mesh = DracoPy.decode(content)
        points = np.asarray(mesh.points, dtype=np.float64)
        for attribute in getattr(mesh, "attributes", ()):
            if attribute.get("unique_id") == position and np.shape(attribute.get("data"))[1:] == (3,):
                points = np.asarray(attribute["data"], dtype=np.float64)
        return points, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the C++ library raises whatever the damage makes it raise
        raise InputError(f"its Draco data are damaged ({str(error)[:60]})") from None
