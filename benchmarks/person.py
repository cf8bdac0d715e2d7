"""A real person from files: a skin in an identity space's topology, and the skull that lies in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..lhm import Surface, Template
from ..lhm.errors import InputError, SoftdecaError
from ..lhm.files.surface_file import check_skin, read_surface
from ..lhm.geometry.distance import SignedDistance
from ..lhm.identities.space import LinearSpace
from ..lhm.progress import OnProgress
from ..lhm.registration import register
from ..lhm.regressor.files import OUTSIDE, OUTSIDE_SHARE, SKULL_EXTENT


def read_skin(path: Path, space: LinearSpace, unit: str, progress: OnProgress) -> tuple[Surface, float]:
    """A skin [mm] in the space's topology, registered if of another, and the face's mean distance from the file's [mm].

    Raises InputError, naming the file, if it cannot be read or registered, or has not a head's size.
    """
    skin = read_surface(path, unit=unit)
    try:
        if skin.vertices.shape == space.mean.vertices.shape and np.array_equal(skin.triangles, space.triangles):
            check_skin(skin)
            return skin, 0.0
        registered = register(space.mean, space.parts, skin, progress=progress)
    except SoftdecaError as error:
        raise InputError(f"{path}: {error}") from None
    return registered.surface, registered.residual.mean


def read_skull(paths: Sequence[Path], unit: str) -> Surface:
    """All bones of a skull [mm] in one surface; InputError names files that cannot be read or have not its size."""
    bones = [read_surface(path, unit=unit) for path in paths]
    starts = np.cumsum([0, *(len(bone.vertices) for bone in bones)])
    triangles = np.vstack([bone.triangles + start for bone, start in zip(bones, starts[:-1], strict=True)])
    skull = Surface(np.vstack([bone.vertices for bone in bones]), triangles)
    extent = np.ptp(skull.vertices[np.unique(skull.triangles)], axis=0)
    least, most = SKULL_EXTENT
    if extent.min() < least or extent.max() > most:
        size = " x ".join(f"{length:.4g}" for length in extent)
        names = ", ".join(map(str, paths))
        raise InputError(f"{names}: its extent is {size} mm, a skull's lies within {least:g}..{most:g}: units off?")
    return skull


def check_inside(template: Template, wrap: Surface, skull: Surface) -> None:
    """Raise InputError if more than a tenth of a skull lies outside its skin wrap.

    What the wrap's mouth and eye sockets are nearest to does not count: teeth and palate lie in the mouth's pocket.
    """
    some = skull.vertices[:: max(1, len(skull.vertices) // 4000)]
    distance, _, triangle, weights = SignedDistance(wrap)(some)
    nearest = wrap.triangles[triangle, weights.argmax(axis=1)]
    outside = np.where((template.regions["mouth"] | template.regions["eyes"])[nearest], 0.0, distance)
    share = float((outside > OUTSIDE).mean())
    if share > OUTSIDE_SHARE:
        raise InputError(
            f"skull: {100 * share:.0f} % of it lie outside the skin (up to {outside.max():.3g} mm; at most "
            f"{100 * OUTSIDE_SHARE:.0f} % may); are both in one frame and in one unit?"
        )
