"""A solution on its scene's tets, as a file for ParaView and other viewers."""

from __future__ import annotations

import io
import os
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import meshio
import numpy as np

from ..lhm.base.checks import check_arguments
from ..lhm.base.errors import InputError
from ..lhm.base.files.atomic import replaced
from .scene import Scene
from .solution import Solution

SUFFIXES = (".vtu", ".vtk")


@check_arguments
def write_solution(path: str | os.PathLike[str], scene: Scene, solution: Solution) -> None:
    """Write a .vtu or .vtk file [mm, kPa, mN] of the scene at rest with what the solution found, whole or not at all.

    Per vertex `displacement` and `reaction`, per tet `J`, `von_mises`, `cauchy` and `first_piola` (nine components,
    row by row). Raises InputError for another suffix, a solution of another scene, and a place that cannot be written.
    """
    path = Path(path)
    if scene.in_parts:
        raise InputError(f"{path}: ranks have this scene in parts; its own method write writes them together")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(SUFFIXES)}")
    if solution.positions.shape != scene.vertices.shape or len(solution.volume_ratio) != len(scene.tets):
        raise InputError(
            f"solution: of {len(solution.positions)} vertices and {len(solution.volume_ratio)} tets, the scene has "
            f"{len(scene.vertices)} and {len(scene.tets)}"
        )
    tensors = {"cauchy": solution.cauchy, "first_piola": solution.first_piola}
    numbers = {"J": solution.volume_ratio, "von_mises": solution.von_mises}
    mesh = meshio.Mesh(
        scene.vertices,
        [("tetra", scene.tets)],
        point_data={"displacement": solution.positions - scene.vertices, "reaction": solution.reactions},
        cell_data={name: [np.nan_to_num(values)] for name, values in numbers.items()}
        | {name: [np.nan_to_num(values.reshape(-1, 9))] for name, values in tensors.items()},
    )
    with replaced(path) as temporary, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        mesh.write(temporary, file_format=path.suffix.lower()[1:])
