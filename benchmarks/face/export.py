"""From the study's rows to the archive: what is missing is solved, the rest is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats
from ...lhm.base.progress import OnProgress, silent
from ..harness import run
from ..harness.study import Results
from ..studies.measures import rms
from ..studies.mesh.face import CONVERGED, LEAST_BAND, LINEAR, QUADRATIC, SAFETY, FaceBenchmark, extrapolate
from .archive import write_archive
from .problems import MESHES, PROBLEMS


def export(
    path: Path, study: FaceBenchmark, folder: Path, *, workers: int | None = None, progress: OnProgress = silent
) -> tuple[Results, int]:
    """Solve what the study's folder lacks, and write the archive; return the results and the archive's bytes.

    Raises InputError where a problem could not be solved by every method; the folder keeps what was.
    """
    results = run(study, folder, workers=workers, progress=progress)
    limits: dict[str, dict[str, Any]] = {row.case: dict(row.values) for row in results.rows if row.method == CONVERGED}
    if len(limits) < len(PROBLEMS):
        failed = next((f"{row.case}, {row.method}: {row.reason}" for row in results.rows if not row.done), "")
        raise InputError(f"{folder}: some answers are missing, so nothing was written ({failed})")
    moved = {
        (row.case, row.method): _read(folder / row.values["displacement"])
        for row in results.rows
        if row.method != CONVERGED
    }
    answers: dict[str, Floats] = {}
    for problem, limit in limits.items():
        coarse, medium = (moved[problem, method.name] for method in QUADRATIC)
        converged = extrapolate(coarse, medium)
        answers[f"{problem}.converged"] = converged
        limit["band_mm"] = max(SAFETY * rms(converged - medium), LEAST_BAND * rms(converged))
        for method in LINEAR:
            answers[f"{problem}.linear.{MESHES[method.mesh]}"] = moved[problem, method.name]
    return results, write_archive(path, study.bodies(), limits, answers, ", ".join(results.commits))


def _read(file: Path) -> Floats:
    try:
        return np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{file}: missing or damaged ({error}); run again with an empty folder") from None
