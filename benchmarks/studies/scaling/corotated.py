"""A time step of FastCorotatedFEM beside an iteration of ours, part by part, on the default head's tets.

Its sources are compiled here, with a program of ours that times them: Kugelstadt, Koschier and Bender 2018, "Fast
Corotated FEM using Operator Splitting", MIT licence, https://github.com/InteractiveComputerGraphics/FastCorotatedFEM.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sysconfig
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ....lhm.base.errors import InputError, MissingDependencyError, SoftdecaError, quote
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import Parameters, Scene, facial_scene, projective, terms
from ....reference.projective import ProjectivePrepared
from ...harness.study import Column, Row, Task, Values
from ..person import OfPerson
from .floor import split_iteration

SOURCE = Path(__file__).with_suffix(".cpp")
FLAGS = ("-std=c++17", "-O3", "-march=native")
REPEATS = 41
EXPRESSION = "jawOpen*0.5+mouthSmileLeft*0.6+mouthSmileRight*0.6"
TOLERANCE = 1e-6
THEIRS, OURS = "FastCorotatedFEM", "ours"
STRETCH, BOTH, WHOLE = "local step, stretch", "local step, stretch and volume", "whole"
STEPS = (1, 5)
"""After how many of its steps from no rotation at all its rotations are compared with exact ones."""


@dataclass(frozen=True)
class OperatorSplitting(OfPerson):
    """One smile: its local steps, its global step, and all of an iteration or a time step."""

    name = "corotated"
    heading = "How fast is an iteration beside open code in C++?"
    question = "What does a tet cost in an iteration of ours, and in a time step of FastCorotatedFEM?"
    columns = (
        Column("what", "what"),
        Column("code", "code"),
        Column("precision", "precision"),
        Column("ms", "processor time [ms]", cost=True),
        Column("ns", "a tet [ns]", cost=True),
    )
    note = (
        "The tets of one head in the pose of an expression, which projective dynamics has solved; its bones are held. "
        "FastCorotatedFEM takes a time step: it finds rotations by one step of Newton's method, eight tets at once in "
        "float32, solves for all three components with a factor made once, and twice passes over all tets' volumes. "
        "Ours is an iteration of L-BFGS in float64: exact rotations and volumes with their energy, membrane and "
        "springs, and the solve. Medians of 41, one thread. Theirs is compiled by "
        f"{' '.join(FLAGS)}; its own build files choose no optimisation."
    )
    timed = True
    alone = True

    sources: str = option("", "folder of FastCorotatedFEM's repository; without it theirs is skipped", name="--sources")

    def tasks(self) -> Sequence[Task]:
        """List both codes; InputError for sources that are not there."""
        self.check()
        if self.sources and not Path(self.sources).is_dir():
            raise InputError(f"sources {quote(self.sources)}: no such folder")
        return [Task("a smile with the jaw half open", code) for code in (OURS, THEIRS)]

    def measure(self, task: Task) -> Values:
        """Measure a row per part."""
        of = self.person()
        prepared = projective.prepare(facial_scene(of.head, Parameters(), of.shape(EXPRESSION)))
        solution = prepared.solve(tolerance=TOLERANCE)
        if task.method == OURS:
            iteration = float(np.median(np.diff(solution.history.time)))
            return {"rows": time_ours(prepared, solution.positions, iteration)}
        return time_theirs(prepared, solution.positions, Path(self.sources) if self.sources else None)

    def words(self, rows: Sequence[Row]) -> str:
        """Say what a tet costs in both codes, and how near their rotations are."""
        at = {(line["code"], line["what"]): line["ns"] for row in rows for line in row.values["rows"]}
        if len({code for code, _ in at}) < 2:
            return ""
        off = next(row.values for row in rows if row.method == THEIRS)
        first, later = off["off_degrees"]
        return (
            f"Rotations and forces take {at[THEIRS, STRETCH]:.0f} ns a tet in FastCorotatedFEM (float32) and "
            f"{at[OURS, STRETCH]:.0f} ns here (float64, with the energy), {at[OURS, BOTH]:.0f} ns with volumes. Its "
            f"whole step takes {at[THEIRS, WHOLE]:.0f} ns, our whole iteration {at[OURS, WHOLE]:.0f} ns. Its rotations "
            f"are off by up to {first:.2g} degrees after one step from none, by {later:.1g} after five."
        )


def time_ours(prepared: ProjectivePrepared, positions: Floats, iteration_seconds: float) -> list[Values]:
    """Time a row per part of an iteration of this many seconds, at positions [mm], shape (n, 3)."""
    scene = prepared.scene
    stretch = Scene(
        scene.vertices,
        scene.tets,
        (terms.Strain(1.0), terms.Fixed(np.flatnonzero(~_free(prepared)))),
    )
    split = split_iteration(prepared, positions, iteration_seconds)
    parts = {
        STRETCH: 1e3 * projective.time_local_step(projective.prepare(stretch), repeats=REPEATS),
        BOTH: 1e3 * projective.time_local_step(prepared, repeats=REPEATS),
        "all energies": split["local"],
        "global step": split["solve"],
        WHOLE: split["iteration"],
    }
    return [_row(what, OURS, "float64", ms, len(scene.tets)) for what, ms in parts.items()]


def time_theirs(prepared: ProjectivePrepared, positions: Floats, folder: Path | None) -> Values:
    """Time FastCorotatedFEM at positions [mm], shape (n, 3): rows, and by how many degrees its rotations are off.

    Raises MissingDependencyError without its sources, SoftdecaError where they do not compile or run.
    """
    if folder is None or not (folder / "FastCorotFEM.cpp").is_file():
        raise MissingDependencyError("FastCorotatedFEM: --sources names no folder with FastCorotFEM.cpp")
    tets = prepared.scene.tets
    is_free = _free(prepared)
    order = np.argsort(is_free, kind="stable")  # it wants held vertices first
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    with tempfile.TemporaryDirectory() as made:
        program, mesh, rotations = (Path(made) / name for name in ("program", "mesh", "rotations"))
        compiler = shlex.split(os.environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++")
        include = [f"-I{folder}", f"-I{folder / 'extern' / 'eigen'}"]
        _run([*compiler, *FLAGS, *include, str(SOURCE), str(folder / "FastCorotFEM.cpp"), "-o", str(program)])
        mesh.write_bytes(
            np.array([len(order), int((~is_free).sum()), len(tets)], dtype=np.int64).tobytes()
            + prepared.scene.vertices[order].tobytes()
            + np.ascontiguousarray(positions[order]).tobytes()
            + number[tets].astype(np.int32).tobytes()
        )
        said = json.loads(_run([str(program), str(mesh), str(rotations), str(REPEATS)]))
        found = np.fromfile(rotations, dtype=np.float32).reshape(len(STEPS), len(tets), 4)
    names = {"local": STRETCH, "global": "global step", "volume": "volumes, two passes", "whole": WHOLE}
    rows = [_row(what, THEIRS, "float32", said[key], len(tets)) for key, what in names.items()]
    exact = _rotations(prepared.scene.vertices, positions, tets)
    off = [float(np.degrees((Rotation.from_quat(each) * exact.inv()).magnitude().max())) for each in found]
    return {"rows": rows, "off_degrees": off, "set_up_ms": said["set_up"], "factor_entries": said["entries"]}


def _free(prepared: ProjectivePrepared) -> np.ndarray:
    is_free = np.zeros(len(prepared.scene.vertices), dtype=bool)
    for _, free in prepared.system.coordinates.groups:
        is_free[free] = True
    return is_free


def _rotations(rest: Floats, positions: Floats, tets: np.ndarray) -> Rotation:
    """Find the rotation nearest to each tet's deformation gradient, by its singular values."""
    edges, moved = ((x[tets[:, 1:]] - x[tets[:, :1]]).transpose(0, 2, 1) for x in (rest, positions))
    U, _, Vt = np.linalg.svd(moved @ np.linalg.inv(edges))
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    return Rotation.from_matrix(U @ Vt)


def _row(what: str, code: str, precision: str, ms: float, tets: int) -> Values:
    return {"what": what, "code": code, "precision": precision, "ms": ms, "ns": 1e6 * ms / tets}


def _run(command: Sequence[str]) -> str:
    """Run a command and give what it says; SoftdecaError with its first complaint where it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        complaint = next((line for line in done.stderr.splitlines() if "error" in line), f"status {done.returncode}")
        raise SoftdecaError(f"FastCorotatedFEM: {Path(command[0]).name}: {complaint}")
    return done.stdout
