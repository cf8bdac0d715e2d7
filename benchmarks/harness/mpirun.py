"""Work by several ranks of mpirun, as FEniCSx shares a mesh among them."""

from __future__ import annotations

import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from ...lhm.base.errors import MissingDependencyError, SoftdecaError

START = f"from {__name__} import answer; answer()"
INHERITED = ("OMPI_", "PMIX_", "PMI_", "ORTE_", "PRTE_", "HYDRA_", "HYDI_")
"""Variables of an outer MPI, which would make the ranks believe that they belong to it."""
SETTINGS = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_orte_execute_quiet": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",  # while waiting, leave the processor to who has work
}


def run_by_mpirun(count: int, work: Callable[..., dict], *given: object) -> dict:
    """Call `work`, a function of a module, in so many ranks, and return what it gives on rank 0.

    The system may move them between processors. What is given and returned travels by pickle.

    Raises MissingDependencyError where there is no mpirun, SoftdecaError where its ranks fail.
    """
    if shutil.which("mpirun") is None:
        raise MissingDependencyError("mpirun is not installed; Debian: apt-get install openmpi-bin")
    with tempfile.TemporaryDirectory() as folder:
        question, reply = Path(folder) / "given", Path(folder) / "reply"
        question.write_bytes(pickle.dumps((work, given)))
        python = [sys.executable, "-m", "mpi4py", "-c", START, str(question), str(reply)]
        command = ["mpirun", "--bind-to", "none", "--oversubscribe", "-n", str(count), *python]
        outer = {key: value for key, value in os.environ.items() if not key.startswith(INHERITED)}
        done = subprocess.run(command, env={**outer, **SETTINGS}, capture_output=True, text=True)
        if done.returncode != 0:
            why = strip_notices(done.stderr).strip().splitlines() or [f"exit status {done.returncode}"]
            raise SoftdecaError(f"mpirun -n {count}: {why[-1]}")
        return pickle.loads(reply.read_bytes())


def answer() -> None:
    """Do the work of the file that the command names first; rank 0 writes the answer to the second."""
    question, reply = map(Path, sys.argv[-2:])
    work, given = pickle.loads(question.read_bytes())
    result = work(*given)
    from ...reference.fenicsx.dolfinx_version import ALL

    if ALL.rank == 0:
        reply.write_bytes(pickle.dumps(result))


def strip_notices(errors: str) -> str:
    """Strip mpirun's own notices from what ranks wrote to stderr: between rules, or of processes it ended."""
    text = "".join(re.split(r"^-{70,}\n", errors, flags=re.MULTILINE)[::2])
    return re.sub(r"^\[[^\]\s]+:\d+\] PMIX ERROR: .*\n?", "", text, flags=re.MULTILINE)
