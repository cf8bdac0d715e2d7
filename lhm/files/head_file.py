"""A layered head on disk: one .npz to load again, and VTK files for other programs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import csr_matrix

from ..arkit import ARKIT
from ..check import HeadReport, check_layers
from ..checked import checked
from ..errors import InputError, MeshError
from ..head import LayeredHead
from ..mesh import Surface, TetMesh
from ..rig import Rig
from .atomic import replaced
from .npz import read_arrays, write_arrays

FORMAT = "softdeca layered head 1"
_WRAPS = ("skin_wrap", "muscle_wrap", "skull_wrap")
_INSIDE = ("muscles", "skull")
_WEIGHTS = ("wrap_from_skin", "skin_from_wrap")


@checked
def save_head(path: str | os.PathLike[str], head: LayeredHead) -> None:
    """Write a head to a .npz file, whole or not at all."""
    arrays = {"format": np.array(FORMAT), "bone": head.bone, "triangles": head.skin_wrap.triangles}
    arrays |= {"skin_vertices": head.skin.vertices, "skin_triangles": head.skin.triangles}
    arrays |= {name: getattr(head, name).vertices for name in _WRAPS}
    for name in _WEIGHTS:
        weights = getattr(head, name)
        arrays |= {f"{name}_{part}": getattr(weights, part) for part in ("data", "indices", "indptr")}
    arrays |= {f"region_{name}": mask for name, mask in head.regions.items()}
    for name in _INSIDE:
        arrays |= arrays_of_surface(name, getattr(head, name))
    if head.volume is not None:
        arrays |= {"volume_vertices": head.vertices[3 * len(head.bone) :]}
        arrays |= {"volume_soft": head.soft.tets, "volume_muscle": head.muscle.tets}
    arrays |= _arrays_of_rig(head.rig)
    arrays |= arrays_of_surface("registered", head.registered)
    write_arrays(path, arrays | {"notes": np.array(json.dumps(head.notes))})


def _arrays_of_rig(rig: Rig | None) -> dict[str, np.ndarray]:
    """A rig as arrays: displacements of the vertices that it moves."""
    if rig is None:
        return {}
    moved = np.flatnonzero(rig.deltas.any(axis=(0, 2)))
    about = {"source": rig.source, "missing": rig.missing, "doubtful": dict(rig.doubtful)}
    shape = np.array(rig.deltas.shape[1])
    arrays = {"rig_vertices": shape, "rig_moved": moved, "rig_deltas": rig.deltas[:, moved]}
    return arrays | {"rig_about": np.array(json.dumps(about))}


def _rig_in(arrays: Mapping[str, np.ndarray]) -> Rig | None:
    if "rig_deltas" not in arrays:
        return None
    about = json.loads(str(arrays["rig_about"]))
    deltas = np.zeros((len(ARKIT), int(arrays["rig_vertices"]), 3), dtype=np.float32)
    deltas[:, arrays["rig_moved"]] = arrays["rig_deltas"]
    return Rig(deltas, about["source"], tuple(about["missing"]), about["doubtful"])


def arrays_of_surface(name: str, surface: Surface | None) -> dict[str, np.ndarray]:
    """A surface as two named arrays; none for None."""
    if surface is None:
        return {}
    return {f"{name}_vertices": surface.vertices, f"{name}_triangles": surface.triangles}


def surface_in(arrays: Mapping[str, np.ndarray], name: str) -> Surface | None:
    """The surface of that name, or None where there is none; KeyError for half of one."""
    if f"{name}_vertices" not in arrays:
        return None
    return Surface(arrays[f"{name}_vertices"], arrays[f"{name}_triangles"])


@checked
def load_head(path: str | os.PathLike[str]) -> LayeredHead:
    """Read a head; InputError names a file that is missing, damaged or something else."""
    with _named(path):
        arrays = _arrays(path)
        skin, wraps, bone, regions = _layers(arrays)
        shape = (len(bone), len(skin.vertices))
        wrap_from_skin, skin_from_wrap = (
            _weights_in(arrays, name, s) for name, s in zip(_WEIGHTS, (shape, shape[::-1]), strict=True)
        )
        inside = {name: surface_in(arrays, name) for name in _INSIDE}
        skin_wrap, muscle_wrap, skull_wrap = wraps
        return LayeredHead(
            skin,
            skin_wrap,
            muscle_wrap,
            skull_wrap,
            bone,
            wrap_from_skin,
            skin_from_wrap,
            regions,
            volume=_volume(arrays, wraps),
            rig=_rig_in(arrays),
            registered=surface_in(arrays, "registered"),
            notes=_notes_in(arrays),
            **inside,
        )


def _weights_in(arrays: Mapping[str, np.ndarray], name: str, shape: tuple[int, int]) -> csr_matrix:
    return csr_matrix(tuple(arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr")), shape=shape)


def _notes_in(arrays: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    return tuple(json.loads(str(arrays["notes"]))) if "notes" in arrays else ()


def _volume(arrays: Mapping[str, np.ndarray], wraps: Sequence[Surface]) -> tuple[TetMesh, TetMesh] | None:
    if "volume_vertices" not in arrays:
        return None
    vertices = np.vstack([*(wrap.vertices for wrap in wraps), arrays["volume_vertices"]])
    return TetMesh(vertices, arrays["volume_soft"]), TetMesh(vertices, arrays["volume_muscle"])


def check_file(path: str | os.PathLike[str]) -> HeadReport:
    """The gates of the head in a file, also where its wraps cross and tets are inverted, so that no head can be made.

    InputError names a file that is missing, damaged or something else.
    """
    with _named(path):
        arrays = _arrays(path)
        skin, wraps, bone, regions = _layers(arrays)
        rig = _rig_in(arrays)
        shape = (len(skin.vertices), len(bone))
        rigged = None if rig is None else (rig, _weights_in(arrays, "skin_from_wrap", shape))
        return check_layers(skin, wraps, bone, regions, rigged=rigged)


def said_of(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """What was found on the way to the head in a file, and the expressions that will not look right, with reasons."""
    with _named(path):
        arrays = _arrays(path)
        rig = _rig_in(arrays)
        return _notes_in(arrays), {} if rig is None else rig.doubtful


def _arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    arrays = read_arrays(path, of="a layered head")
    if str(arrays.get("format")) != FORMAT:
        raise InputError(f"{path}: not a layered head of this version (expected {FORMAT!r})")
    return arrays


@contextmanager
def _named(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except KeyError as error:
        raise InputError(f"{path}: not a layered head, array {error.args[0]!r} is missing") from None
    except InputError:
        raise
    except (MeshError, ValueError, TypeError, IndexError) as error:
        raise InputError(f"{path}: damaged, {error}") from None


def _layers(arrays: Mapping[str, np.ndarray]) -> tuple[Surface, list[Surface], np.ndarray, dict[str, np.ndarray]]:
    skin = Surface(arrays["skin_vertices"], arrays["skin_triangles"])
    wraps = [Surface(arrays[name], arrays["triangles"]) for name in _WRAPS]
    regions = {name.removeprefix("region_"): arrays[name] for name in arrays if name.startswith("region_")}
    return skin, wraps, arrays["bone"], regions


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
