"""Pairs of skin and skull: read from a folder, their depths measured along rays inward."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu

from ...base.errors import InputError, SoftdecaError
from ...base.files.surface_file import SUFFIXES, read_surface
from ...base.files.text import list_files
from ...base.geometry.bvh import TriangleTree
from ...base.geometry.distance import SignedDistance
from ...base.geometry.rays import first_hits
from ...base.geometry.topology import graph_laplacian, join_surfaces, neighbours
from ...base.mesh import Floats, Surface
from ...base.progress import OnProgress, silent
from ...head.skin import check_skin
from ...identities.space import LinearSpace
from ..registration import register
from ..template import Template
from ..wraps.landmarks import Mask
from .depths import DepthPairs


@dataclass(frozen=True)
class PairsPolicy:
    """Constants of the measurement of depths, and bounds of pairs of skin and skull."""

    least_depth: float = 1.0  # [mm] of soft tissue over bone, as over the nasal bones
    most_depth: float = 40.0  # [mm]; a heavy cheek has 30
    slipped: float = 2.0  # times as far as bone is near, a ray has slipped through a gap that a skull wrap spans
    smoothing: float = 4.0  # implicit, of the rays' directions, as of the layers' connectors
    least_pairs: int = 3
    skull_extent: tuple[float, float] = (60.0, 300.0)  # [mm]
    outside: float = 3.0  # [mm] that vertices of a skull may lie outside the skin wrap,
    outside_share: float = 0.1  # up to this share of them


POLICY = PairsPolicy()
"""The constants as they were measured."""


@dataclass(frozen=True, eq=False)
class MeasuredDepths:
    """Depths (n,) [mm], and where a ray measured them, (n,); elsewhere the closest point counts."""

    depths: Floats = field(repr=False)
    met: Mask = field(repr=False)

    @property
    def missed(self) -> int:
        """The number of vertices at which no ray measured the depth."""
        return int(np.count_nonzero(~self.met))


def move_wrap(template: Template, skin: Floats) -> Floats:
    """Move the template's skin wrap (n, 3) [mm] with a skin (skin vertices, 3) of its topology."""
    return template.skin_wrap.vertices + template.wrap_from_skin @ (skin - template.skin.vertices)


def inward_normals(skin_wrap: Surface) -> Floats:
    """Unit directions (n, 3) into the head: area-weighted normals, smoothed so that a crease's rays do not cross."""
    n = len(skin_wrap.vertices)
    laplacian = graph_laplacian(neighbours(skin_wrap.triangles, n))
    inward = -splu((identity(n) + POLICY.smoothing * laplacian).tocsc()).solve(skin_wrap.vertex_normals)
    return inward / np.linalg.norm(inward, axis=1, keepdims=True)


def measure_depths(skin_wrap: Floats, inward: Floats, bones: Sequence[Surface]) -> MeasuredDepths:
    """Measure from a skin wrap's vertices (n, 3) [mm] along `inward` (n, 3) to the first bone that a ray meets.

    Where none is met within the plausible range (eye sockets, the nose's tip, the neck), or only one far behind the
    closest (through a hole of thin bone, between the teeth, under the zygomatic arch), the closest point of the bones
    counts instead, limited to that range.
    """
    skull = join_surfaces(bones)
    tree = TriangleTree(skull.vertices, skull.triangles)
    along, closest = first_hits(tree, skin_wrap, inward, POLICY.most_depth)[1], tree.closest(skin_wrap)[2]
    met = along <= np.maximum(POLICY.slipped * closest, POLICY.least_depth)
    return MeasuredDepths(np.clip(np.where(met, along, closest), POLICY.least_depth, POLICY.most_depth), met)


class PairReport(NamedTuple):
    """Quality of a measured pair.

    `missed`: vertices at which no ray met the skull, so that its closest point was taken; `off`: mean distance [mm] of
    the registered face to the skin, 0 for a skin of the space's own topology.
    """

    name: str
    missed: int
    off: float


def read_pairs(
    folder: str | os.PathLike[str],
    template: Template,
    space: LinearSpace,
    *,
    unit: str = "mm",
    progress: OnProgress = silent,
) -> tuple[DepthPairs, tuple[PairReport, ...]]:
    """Read the pairs NAME_skin.* and NAME_skull.* (OBJ, PLY, STL, NPZ) of a folder, and measure their depths.

    Skins of the identity space's topology are taken as they are, others are registered (half a minute each; they look
    along +z with +y up). Raises InputError, naming the pair or file, for a missing partner, fewer than three pairs, a
    mesh that cannot be read or has not a head's size (units off), a skin that cannot be registered, and a skull that
    lies outside its skin.
    """
    files = _files(Path(folder))
    wraps, depths, reports = [], [], []
    for i, (name, (skin_file, skull_file)) in enumerate(files.items()):
        progress("depth regressor: pairs", i / len(files))
        skull = read_skull([skull_file], unit=unit)
        skin, off = read_skin(skin_file, space, unit=unit)
        wrap = template.skin_wrap.with_vertices(move_wrap(template, skin.vertices))
        check_inside(f"pair {name}", template, wrap, skull)
        measured = measure_depths(wrap.vertices, inward_normals(wrap), [skull])
        wraps.append(wrap.vertices)
        depths.append(measured.depths)
        reports.append(PairReport(name, measured.missed, off))
    progress("depth regressor: pairs", 1.0)
    label = f"{len(files)} pairs from {folder}"
    return DepthPairs(label, tuple(files), np.stack(wraps), np.stack(depths)), tuple(reports)


def _files(folder: Path) -> dict[str, tuple[Path, Path]]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    pairs: dict[str, dict[str, Path]] = {}
    for path in list_files(folder):
        name, _, kind = path.stem.rpartition("_")
        if path.suffix.lower() in SUFFIXES and kind in ("skin", "skull") and name:
            if kind in pairs.setdefault(name, {}):
                raise InputError(f"{folder}: pair {name} has two files of its {kind}: {path.name} is the second")
            pairs[name][kind] = path
    for name, pair in pairs.items():
        for kind in ("skin", "skull"):
            if kind not in pair:
                raise InputError(f"{folder}: pair {name} has no {name}_{kind} ({', '.join(SUFFIXES)})")
    if len(pairs) < POLICY.least_pairs:
        raise InputError(
            f"{folder}: {len(pairs)} pairs of files NAME_skin and NAME_skull; a regressor needs {POLICY.least_pairs} "
            "or more"
        )
    return {name: (pair["skin"], pair["skull"]) for name, pair in pairs.items()}


def read_skin(path: str | os.PathLike[str], space: LinearSpace, *, unit: str = "mm") -> tuple[Surface, float]:
    """Read a skin [mm] in the space's topology, and how far off it the registered face is on average [mm].

    0 for a skin of that topology. InputError names the file that cannot be read, registered, or is of another unit.
    """
    skin = read_surface(path, unit=unit)
    try:
        if skin.vertices.shape == space.mean.vertices.shape and np.array_equal(skin.triangles, space.triangles):
            check_skin(skin)
            return skin, 0.0
        registered = register(space.mean, space.parts, skin)
    except SoftdecaError as error:
        raise InputError(f"{path}: {error}") from None
    return registered.surface, registered.residual.mean


def read_skull(paths: Sequence[str | os.PathLike[str]], *, unit: str = "mm") -> Surface:
    """Read a skull [mm], all bones in one surface; InputError names files that are bad or of another unit."""
    skull = join_surfaces([read_surface(path, unit=unit) for path in paths])
    extent = np.ptp(skull.vertices[np.unique(skull.triangles)], axis=0)
    if extent.min() < POLICY.skull_extent[0] or extent.max() > POLICY.skull_extent[1]:
        size = " x ".join(f"{length:.4g}" for length in extent)
        least, most = POLICY.skull_extent
        names = ", ".join(map(str, paths))
        raise InputError(f"{names}: its extent is {size} mm, a skull's lies within {least:g}..{most:g}: units off?")
    return skull


def check_inside(name: str, template: Template, wrap: Surface, skull: Surface) -> None:
    """Raise InputError, naming whose they are, if more than a tenth of a skull lies outside its skin wrap.

    What the wrap's mouth and eye sockets are nearest to does not count: teeth and palate lie in the mouth's pocket.
    """
    some = skull.vertices[:: max(1, len(skull.vertices) // 4000)]
    distance, _, triangle, weights = SignedDistance(wrap)(some)
    nearest = wrap.triangles[triangle, weights.argmax(axis=1)]
    outside = np.where((template.regions["mouth"] | template.regions["eyes"])[nearest], 0.0, distance)
    share = float((outside > POLICY.outside).mean())
    if share > POLICY.outside_share:
        raise InputError(
            f"{name}: {100 * share:.0f} % of the skull lie outside the skin (up to {outside.max():.3g} mm; at "
            f"most {100 * POLICY.outside_share:.0f} % may): are both in one frame and in mm?"
        )
