"""One long run of a corpus, from whose velocities its sequences begin (SoftDECA 3.4): a file beside the shards."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.progress import OnProgress, silent
from ...lhm.expressions import conversation
from ...reference import Parameters, Sequence, settled
from ...reference.face import velocities
from ...reference.face.velocities import Velocities
from .person import People, Person
from .plan import RATE, VELOCITIES, CorpusPlan

FILE = "velocities.npz"
TOLERANCE = 5e-4
"""Of the run: what its velocities are good for are starts that nobody has measured."""


def velocities_of(folder: Path, plan: CorpusPlan, people: People, *, on_progress: OnProgress = silent) -> Velocities:
    """The velocities of a run of `plan.run` frames of made-up conversation on the plan's first person, default p.

    Kept in the corpus' folder; made anew where the file is missing, damaged or of another plan.
    """
    path = folder / FILE
    owner = f"{plan.digest}-{people.name}"
    try:
        arrays = read_arrays(path, "local", "owner", "checksum", of="the velocities of a corpus")
        if str(arrays["owner"]) == owner and str(arrays["checksum"]) == _checksum(arrays["local"]):
            return Velocities(arrays["local"].astype(np.float32))
    except InputError:
        pass
    local = _run(plan, people, on_progress).local.astype(np.float16)
    write_arrays(path, {"local": local, "owner": np.array(owner), "checksum": np.array(_checksum(local))})
    return Velocities(local.astype(np.float32))


def _checksum(local: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(local).tobytes()).hexdigest()


def _run(plan: CorpusPlan, people: People, on_progress: OnProgress) -> Velocities:
    person = people.person(plan.rng(VELOCITIES))
    weights = conversation(plan.rng(VELOCITIES, 1), plan.run, rate=RATE)
    running = Sequence.of(
        settled(people.head(person), Parameters()), time_step=1.0 / RATE, dynamic=True, tolerance=TOLERANCE
    )

    def expressions():
        for number, w in enumerate(weights):
            yield _expression(person, w)
            on_progress(f"a long run: frame {number + 1} of {plan.run}", (number + 1) / plan.run)

    return velocities.run(running, expressions())


def _expression(person: Person, weights: np.ndarray) -> np.ndarray:
    return person.skin.vertices + np.tensordot(weights, person.shapes, axes=1)
