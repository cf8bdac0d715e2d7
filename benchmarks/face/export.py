"""From the study's rows to the archive: what is missing is solved, the rest is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.checks import finite
from ...lhm.base.errors import InputError
from ...lhm.base.files.npz import read_npy
from ...lhm.base.mesh import Floats
from ...lhm.base.progress import OnProgress, silent
from ..harness import run
from ..harness.study import Results
from ..studies.mesh.face import CONVERGED, LEAST_BAND, LINEAR, QUADRATIC, SAFETY, FaceBenchmark, extrapolate
from .archive import write_archive
from .problems import MESHES, PROBLEMS, Body
from .score import rms


def export(
    path: Path, study: FaceBenchmark, folder: Path, *, small: bool = False, progress: OnProgress = silent
) -> tuple[Results, int]:
    """Solve what the study's folder lacks, or has as failed, and write the archive; return the results and its bytes.

    A small archive leaves out the fine mesh, and the answers on it. Raises InputError where a problem could
    not be solved by every method; the folder keeps what was.
    """
    results = run(study, folder, progress=progress)
    limits: dict[str, dict[str, Any]] = {row.case: dict(row.values) for row in results.rows if row.method == CONVERGED}
    if len(limits) < len(PROBLEMS):
        failed = next((f"{row.case}, {row.method}: {row.reason}" for row in results.rows if not row.done), "")
        raise InputError(f"{folder}: some answers are missing, so nothing was written ({failed})")
    bodies = study.bodies()
    by_mesh = dict(zip(MESHES, bodies, strict=True))
    kept = bodies[:-1] if small else bodies
    moved = {
        (row.case, row.method): _read(folder / row.values["displacement"], by_mesh[row.method.rpartition(", ")[2]])
        for row in results.rows
        if row.method != CONVERGED
    }
    answers: dict[str, Floats] = {}
    for problem, limit in limits.items():
        coarse, medium, fine = (moved[problem, method][: len(bodies[0].vertices)] for method in QUADRATIC)
        converged, _ = extrapolate(coarse, medium, fine)
        answers[f"{problem}.converged"] = converged
        for name, size in (("band_mm", rms), ("largest_mm", lambda each: float(np.linalg.norm(each, axis=1).max()))):
            limit[name] = max(SAFETY * size(converged - fine), LEAST_BAND * size(converged))
        for element, methods in (("linear", LINEAR), ("quadratic", QUADRATIC)):
            for mesh, method in zip(MESHES[: len(kept)], methods, strict=False):
                # 1e-6 mm are enough, in half the bytes.
                answers[f"{problem}.{element}.{mesh}"] = moved[problem, method].astype(np.float32)
    return results, write_archive(path, kept, limits, answers, ", ".join(results.commits))


def _read(file: Path, body: Body) -> Floats:
    """Read the displacements (n, 3) of a body's vertices that a row has left."""
    try:
        return finite("displacements", read_npy(file), body.vertices.shape)
    except InputError as error:
        raise InputError(f"{file}: missing, damaged or of an earlier version ({error}); use an empty folder") from None
