"""A layered head on disk: one .npz to load again, VTK files and tagged tets for other programs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import csr_matrix

from ..base import checks
from ..base.errors import InputError, MeshError, escape, one_line, quote
from ..base.files.atomic import replaced
from ..base.files.npz import read_arrays, write_arrays
from ..base.files.tet_file import TaggedTets
from ..base.files.text import parse_json
from ..base.geometry.bvh import TriangleTree
from ..base.limits import NOTE_LETTERS, NOTES, REGIONS, TETS, TRIANGLES, VERTICES
from ..base.mesh import Surface, TetMesh
from ..expressions.rig import Rig
from ..identities.arkit import ARKIT
from ..identities.space import EXTENT
from .detail import Detail
from .head import LayeredHead
from .skin import check_outward

FORMAT = "softdeca layered head 1"
_WRAPS = ("skin_wrap", "muscle_wrap", "skull_wrap")
_INSIDE = ("muscles", "skull")
_WEIGHTS = ("wrap_from_skin", "skin_from_wrap")
UNITS = {"m": 1e3, "cm": 10.0, "km": 1e6, "in": 25.4, "ft": 304.8, "µm": 1e-3, "nm": 1e-6}
LEAST_MOVED = 1.0
"""[mm] What a rig moves most: 36 to 45 in random identities and scans."""
FARTHEST = 10.0
"""Extents of the skin wrap within which a head's other surfaces lie: a whole body's skin is seven heads tall."""
LARGEST = 1e9
"""Of a coordinate, whatever its unit: a head in nm."""
TIED = 0.2
"""Of the wrap's mean edge: what weights tie is at most so much farther away than the surface, for most vertices.

Heads have 0.01 to 0.11, weights in another order 0.3 and more.
"""
LEAST_NEAR = 0.1
"""Of the wrap's vertices that lie within its mean edge of the skin: an open scan of a face alone has a third."""
ROW_TOLERANCE = 1e-5
"""Of weights, which are 0 to 1, and of their sums, which are one."""


def save_head(path: str | os.PathLike[str], head: LayeredHead) -> None:
    """Write a head to a .npz file, whole or not at all; InputError for one that `load_head` would refuse."""
    arrays = {"format": np.array(FORMAT), "bone": head.bone, "triangles": head.skin_wrap.triangles}
    arrays |= {"skin_vertices": head.skin.vertices, "skin_triangles": head.skin.triangles}
    arrays |= {name: getattr(head, name).vertices for name in _WRAPS}
    for name in _WEIGHTS:
        arrays |= weights_to_arrays(name, getattr(head, name))
    arrays |= {f"region_{name}": mask for name, mask in head.regions.items()}
    for name in _INSIDE:
        arrays |= surface_to_arrays(name, getattr(head, name))
    if head.volume is not None:
        arrays |= {"volume_vertices": head.vertices[3 * len(head.bone) :]}
        arrays |= {"volume_soft": head.soft.tets, "volume_muscle": head.muscle.tets}
    arrays |= _rig_to_arrays(head.rig)
    if head.detail is not None:
        arrays |= {"detail_heights": head.detail.heights}
        for name in ("colours", "place"):
            values = getattr(head.detail, name)
            arrays |= {} if values is None else {f"detail_{name}": values}
    arrays |= {"notes": np.array(json.dumps(head.notes))}
    with refusing_to_write(path):
        _head_from_arrays(arrays)
    write_arrays(path, arrays)


@contextmanager
def refusing_to_write(path: str | os.PathLike[str]) -> Iterator[None]:
    """Make every error an InputError that says that the file is not written."""
    try:
        yield
    except ValueError as error:  # a SoftdecaError too
        raise InputError(f"{path}: not written, since it could not be read: {error}") from None


def _rig_to_arrays(rig: Rig | None) -> dict[str, np.ndarray]:
    """Return a rig as arrays: displacements of the vertices that it moves."""
    if rig is None:
        return {}
    vertices = np.flatnonzero(rig.deltas.any(axis=(0, 2)))
    about = {"source": rig.source, "missing": rig.missing}
    shape = np.array(rig.deltas.shape[1])
    arrays = {"rig_vertices": shape, "rig_moved": vertices, "rig_deltas": rig.deltas[:, vertices]}
    return arrays | {"rig_about": np.array(json.dumps(about))}


def surface_to_arrays(name: str, surface: Surface | None) -> dict[str, np.ndarray]:
    """Return a surface as two named arrays; none for None."""
    if surface is None:
        return {}
    return {f"{name}_vertices": surface.vertices, f"{name}_triangles": surface.triangles}


def weights_to_arrays(name: str, weights: csr_matrix) -> dict[str, np.ndarray]:
    """Return sparse weights as three named arrays."""
    return {f"{name}_{part}": getattr(weights, part) for part in ("data", "indices", "indptr")}


def read_surface_arrays(arrays: Mapping[str, np.ndarray], name: str) -> Surface | None:
    """Return the surface of that name, or None; KeyError for half of one, InputError for a bad one."""
    if not {f"{name}_vertices", f"{name}_triangles"} & arrays.keys():
        return None
    return surface_from_arrays(name, arrays[f"{name}_vertices"], arrays[f"{name}_triangles"])


def surface_from_arrays(name: str, vertices: np.ndarray, triangles: np.ndarray) -> Surface:
    """Return the surface of two arrays; InputError names what is wrong with them."""
    points = checks.real(f"{name} vertices", vertices, (None, 3), most=LARGEST)
    VERTICES.check(name, len(points))
    TRIANGLES.check(name, len(triangles) if np.ndim(triangles) else 0)
    try:
        return Surface(points, triangles)
    except MeshError as error:
        raise InputError(f"{name} {error}") from None


def read_masks(arrays: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """Return the arrays named region_*, masks (count,), by the rest of their names; InputError for others."""
    names = [name for name in arrays if name.startswith("region_")]
    REGIONS.check("it has", len(names))
    masks = {name.removeprefix("region_"): checks.mask(name, arrays[name], (count,)) for name in names}
    return masks


def read_weights(arrays: Mapping[str, np.ndarray], name: str, rows: int, columns: int) -> csr_matrix:
    """Return the sparse weights of that name, (rows, columns), that interpolate: 0 to 1, each row of sum one."""
    data, indices, indptr = (arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr"))
    weights = checks.sparse_rows(name, data, indices, indptr, rows, columns)
    checks.in_range(f"{name}_data", weights.data, -ROW_TOLERANCE, 1.0 + ROW_TOLERANCE)
    sums = np.asarray(weights.sum(axis=1)).ravel()
    off = np.flatnonzero(np.abs(sums - 1.0) > ROW_TOLERANCE)
    if len(off):
        raise InputError(f"{name}: {len(off)} rows do not sum to one, the first is {off[0]} ({sums[off[0]]:.4g})")
    return weights


def read_ties(arrays: Mapping[str, np.ndarray], skin: Surface, wrap: Surface) -> tuple[csr_matrix, csr_matrix]:
    """Return `wrap_from_skin` and `skin_from_wrap`; InputError where they are damaged or those of another head.

    Vertices far from the other surface, as a bust's shoulders, may be tied to any place of it.
    """
    if not len(skin.triangles):
        raise InputError("skin: it has no triangles")
    check_outward(skin)
    n, skin_n = len(wrap.vertices), len(skin.vertices)
    ties = read_weights(arrays, "wrap_from_skin", n, skin_n), read_weights(arrays, "skin_from_wrap", skin_n, n)
    edge = float(np.linalg.norm(np.diff(wrap.vertices[wrap.triangles], axis=1), axis=2).mean())
    for name, weights, there, here in zip(_WEIGHTS, ties, (skin, wrap), (wrap, skin), strict=True):
        gap = TriangleTree(there.vertices, there.triangles).closest(here.vertices)[2]
        near = gap < edge
        if here is wrap and near.mean() < LEAST_NEAR:
            raise InputError(f"skin_wrap: it lies {np.median(gap):.3g} mm from the skin; is one of another head?")
        off = np.linalg.norm(weights @ there.vertices - here.vertices, axis=1) - gap
        if near.any() and np.quantile(off[near], 0.75) > TIED * edge:
            raise InputError(
                f"{name}: it ties vertices {off[near].mean():.3g} mm farther away than the surface, on average; "
                f"is it of another head?"
            )
    return ties


def load_head(path: str | os.PathLike[str]) -> LayeredHead:
    """Read a head; InputError names a file that is missing, damaged or something else."""
    with naming_damage(path, "a layered head"):
        arrays = read_arrays(path, kind="a layered head")
        if arrays.get("format", np.array("")).tolist() != FORMAT:
            raise InputError(f"{path}: not a layered head of this version (expected {FORMAT!r})")
        if "registered_vertices" in arrays:
            raise InputError(
                f"{path}: a scan in its own triangles, as earlier versions made it; fit the scan again by "
                f"`softdeca head fit --skin`, in the template's triangles"
            )
        return _head_from_arrays(arrays)


@contextmanager
def naming_damage(path: str | os.PathLike[str], kind: str) -> Iterator[None]:
    """Make every error an InputError that names the file, once; `kind` is what the file should be."""
    try:
        yield
    except KeyError as error:
        raise InputError(f"{path}: not {kind}, array {error.args[0]!r} is missing") from None
    except ValueError as error:  # a SoftdecaError too
        said = str(error)
        raise InputError(said if said.startswith(one_line(f"{path}:")) else f"{path}: damaged, {said}") from None


def _head_from_arrays(arrays: Mapping[str, np.ndarray]) -> LayeredHead:
    """Return the head of such arrays; MeshError where tets are inverted, InputError for what is in no head."""
    skin = surface_from_arrays("skin", arrays["skin_vertices"], arrays["skin_triangles"])
    skin_wrap, muscle_wrap, skull_wrap = (
        surface_from_arrays(name, arrays[name], arrays["triangles"]) for name in _WRAPS
    )
    wraps = (skin_wrap, muscle_wrap, skull_wrap)
    n, skin_n = len(skin_wrap.vertices), len(skin.vertices)
    for name, wrap in zip(_WRAPS, wraps, strict=True):
        checks.shape(name, wrap.vertices, (n, 3))
    if not len(skin_wrap.triangles):
        raise InputError("triangles: there are none")
    surfaces = {"skin": skin, **dict(zip(_WRAPS, wraps, strict=True))}
    more = {name: read_surface_arrays(arrays, name) for name in _INSIDE}
    extent = check_extent(surfaces | {name: surface for name, surface in more.items() if surface is not None})
    head = LayeredHead(
        skin,
        *wraps,
        checks.integers("bone", arrays["bone"], 0, 2, (n,)),
        *read_ties(arrays, skin, skin_wrap),
        read_masks(arrays, n),
        volume=_read_volume(arrays, wraps, extent),
        rig=_read_rig(arrays, skin_n, extent),
        detail=_read_detail(arrays, extent),
        notes=read_notes(arrays),
        muscles=more["muscles"],
        skull=more["skull"],
    )
    return head


def check_extent(surfaces: Mapping[str, Surface]) -> float:
    """Return the skin wrap's largest extent [mm]; InputError unless it is a head's and all surfaces are near it.

    A head in another unit is refused here, in a line that names the unit: measures of it take no end.
    """
    wrap = surfaces["skin_wrap"].vertices
    low, high = wrap.min(axis=0), wrap.max(axis=0)
    extent = float((high - low).max())
    if not EXTENT[0] <= extent <= EXTENT[1]:
        units = [unit for unit, mm in UNITS.items() if EXTENT[0] <= extent * mm <= EXTENT[1]]
        guess = f"; is it in {units[0]}? Heads are in mm" if units else ""
        raise InputError(f"skin_wrap is {extent:.4g} mm across, a head {EXTENT[0]:g} to {EXTENT[1]:g} mm{guess}")
    for name, surface in surfaces.items():
        x, centre = surface.vertices, 0.5 * (low + high)
        if len(x) and max((x.max(axis=0) - centre).max(), (centre - x.min(axis=0)).max()) > FARTHEST * extent:
            off = np.abs(x - centre).max(axis=1)
            raise InputError(
                f"{name}: vertex {off.argmax()} lies {off.max():.3g} mm from the head's centre; "
                f"expected at most {FARTHEST * extent:.4g}"
            )
    return extent


def _read_volume(
    arrays: Mapping[str, np.ndarray], wraps: tuple[Surface, ...], extent: float
) -> tuple[TetMesh, TetMesh] | None:
    if not any(name.startswith("volume_") for name in arrays):
        return None
    inner = checks.finite("volume_vertices", arrays["volume_vertices"], (None, 3))
    middle = 0.5 * (wraps[0].vertices.min(axis=0) + wraps[0].vertices.max(axis=0))
    if len(inner) and np.abs(inner - middle).max() > extent:
        raise InputError("volume_vertices: some lie outside the head")
    VERTICES.check("volume", len(inner))
    vertices = np.vstack([*(wrap.vertices for wrap in wraps), inner])
    tissues = []
    for name in ("volume_soft", "volume_muscle"):
        tets = checks.indices_below(name, arrays[name], len(vertices), (None, 4))
        TETS.check(name, len(tets))
        tissues.append(TetMesh(vertices, tets))
    soft, muscle = tissues
    return soft, muscle


def _read_rig(arrays: Mapping[str, np.ndarray], skin_n: int, extent: float) -> Rig | None:
    if not any(name.startswith("rig_") for name in arrays):
        return None
    count = checks.integers("rig_vertices", arrays["rig_vertices"], 0, VERTICES.most, ())
    if int(count) != skin_n:
        raise InputError(f"rig_vertices: {int(count)}, the skin has {skin_n}")
    vertices = checks.indices_below("rig_moved", arrays["rig_moved"], skin_n, (None,))
    if (np.diff(vertices) <= 0).any():
        raise InputError("rig_moved: expected vertices in rising order, each once")
    given = checks.real("rig_deltas", arrays["rig_deltas"], (len(ARKIT), len(vertices), 3), most=extent)
    farthest = float(np.abs(given).max(initial=0.0))
    if 0.0 < farthest < LEAST_MOVED:
        raise InputError(
            f"rig_deltas: they move no vertex farther than {farthest:.3g} mm, expected {LEAST_MOVED:g} or more; "
            f"are they in m?"
        )
    about = parse_json(checks.text("rig_about", arrays["rig_about"]))
    deltas = np.zeros((len(ARKIT), skin_n, 3), dtype=np.float32)
    deltas[:, vertices] = given
    if not isinstance(about, dict):
        raise InputError("rig_about: expected source and missing")
    missing = checks.texts("rig_about: missing", about.get("missing"))
    (source,) = checks.texts("rig_about", [about.get("source")])
    for name in missing:
        if name not in ARKIT:
            raise InputError(f"rig_about: {quote(name)} is none of ARKit's expressions")
    NOTE_LETTERS.check("rig_about", len(source))
    return Rig(deltas, escape(source), missing)


def _read_detail(arrays: Mapping[str, np.ndarray], extent: float) -> Detail | None:
    if "detail_heights" not in arrays:
        return None
    heights = checks.real("detail_heights", arrays["detail_heights"], (None,), most=extent)
    colours = arrays.get("detail_colours")
    if colours is not None:
        colours = checks.integers("detail_colours", colours, 0, 255, (None, 3)).astype(np.uint8)
    place = arrays.get("detail_place")
    if place is not None:
        place = checks.real("detail_place", place, (3, 4), most=LARGEST)
    return Detail(heights.astype(np.float32), colours, place)


def read_notes(arrays: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Return the notes of a file, control characters escaped; InputError for what is no list of texts.

    They are written last. A file whose list of arrays lost its end has none, and may lack its rig: KeyError.
    """
    notes = checks.texts("notes", parse_json(checks.text("notes", arrays["notes"])))
    NOTES.check("notes", len(notes))
    for note in notes:
        NOTE_LETTERS.check("notes", len(note))
    return tuple(escape(note) for note in notes)


def export_vtk(folder: str | os.PathLike[str], head: LayeredHead) -> list[Path]:
    """Write skin, wraps, and the tets with their layer (0 soft, 1 muscle) as .vtu files [mm]; return their paths."""
    folder = Path(folder)
    files = []
    for name in ("skin", *_WRAPS, *_INSIDE):
        surface = getattr(head, name)
        if surface is None:
            continue
        data = {"bone": head.bone.astype(np.int32)} if name == "skull_wrap" else {}
        mesh = meshio.Mesh(surface.vertices, [("triangle", surface.triangles)], point_data=data)
        files.append(_write(folder / f"{name}.vtu", mesh))
    layer = np.repeat([0, 1], [len(head.soft.tets), len(head.muscle.tets)]).astype(np.int32)
    tets = meshio.Mesh(head.vertices, [("tetra", head.tets)], cell_data={"layer": [layer]})
    files.append(_write(folder / "tissue.vtu", tets))
    return files


def _write(path: Path, mesh: meshio.Mesh) -> Path:
    with replaced(path) as temporary:
        mesh.write(temporary, file_format="vtu")
    return path


SOFT, MUSCLE = 1, 2
NAMES = {"soft_tissue": (SOFT, 3), "muscle": (MUSCLE, 3), "skin": (11, 2), "muscle_wrap": (12, 2), "skull": (13, 2)}
"""Name, and tag and dimension, of what a head's file holds."""


def tets_from_head(head: LayeredHead, layers: tuple[int, int] = (1, 1)) -> TaggedTets:
    """Return a head's tets, in so many layers of soft tissue and muscle or its own volume mesh, and its three wraps.

    Raises MeshError for layers of a head whose tets are a volume mesh, InputError for counts below one.
    """
    if head.volume is not None and tuple(layers) != (1, 1):
        raise MeshError(f"layers {tuple(layers)}: the head's tets are a volume mesh, not layers of prisms")
    soft, muscle = (head.soft, head.muscle) if tuple(layers) == (1, 1) else head.sub_layers(*layers)
    triangles, n = head.skin_wrap.triangles, len(head.bone)
    firsts = (0, n, 2 * n) if head.volume is not None else (0, layers[0] * n, sum(layers) * n)
    tags = [tag for tag, dimension in NAMES.values() if dimension == 2]
    return TaggedTets(
        TetMesh(soft.vertices, np.vstack([soft.tets, muscle.tets])),
        np.repeat([SOFT, MUSCLE], [len(soft.tets), len(muscle.tets)]),
        {tag: name for name, (tag, _) in NAMES.items()},
        {tag: triangles + first for tag, first in zip(tags, firsts, strict=True)},
    )
