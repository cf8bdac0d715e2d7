"""Protocol of a solver's file: it gets a problem, and a clock that it shows its positions to. numpy alone."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, Protocol, TextIO

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


WARM_BUDGET = 0.5
"""[s] of the uncounted run before."""
STILL, WAIT, LOOKS = 1e-6, 1.25, 8
"""A run ends where nothing has moved by more than that [mm] while its time grew by that factor, in so many looks."""


class RefusalError(Exception):
    """A solver cannot model a problem; the row says why."""


class SpentError(Exception):
    """The budget is spent; a solver's callback raises it where that is the way out of its package."""


@dataclass(frozen=True, eq=False)
class ArenaProblem:
    """A problem as arrays: mm, kPa, mN.

    Rest vertices (n, 3), tets (m, 4), `held` vertices (k,) that go to `places` (k, 3), dead nodal forces (n, 3), Lamé's
    moduli at rest per tet (m,), the vertices `skin` (s,) where errors are measured, and positions (n, 3) to start from.
    Springs of zero length and stiffness (n,) [mN/mm], 0 for most, draw vertices to `drawn_to` (n, 3). A membrane has
    triangles (t, 3) and stiffness (t,) [mN/mm]: stiffness/2 ‖F - R‖² per rest area, R the rotation next to F.
    """

    vertices: Floats
    tets: NDArray[np.int64]
    held: NDArray[np.int64]
    places: Floats
    forces: Floats
    mu: Floats
    lmbda: Floats
    skin: NDArray[np.int64]
    start: Floats
    springs: Floats
    drawn_to: Floats
    membrane: NDArray[np.int64]
    membrane_stiffness: Floats

    @classmethod
    def read(cls, path: Path) -> ArenaProblem:
        """Read a problem of a file that `numpy.savez` wrote."""
        with np.load(path) as file:
            return cls(**{key: file[key] for key in cls.__dataclass_fields__})

    @property
    def free(self) -> NDArray[np.bool_]:
        """Say which vertices are not held, shape (n,)."""
        mask = np.ones(len(self.vertices), dtype=bool)
        mask[self.held] = False
        return mask

    @property
    def starts_at_rest(self) -> bool:
        """Say whether the start is the rest shape."""
        return np.array_equal(self.start, self.vertices)

    @property
    def moves(self) -> Floats:
        """Give how far held vertices go from the start [mm], (k, 3)."""
        return self.places - self.start[self.held]

    def nodal_volumes(self) -> Floats:
        """Give a quarter of the volumes of each vertex' tets [mm³], (n,)."""
        edges = self.vertices[self.tets[:, 1:]] - self.vertices[self.tets[:, :1]]
        quarter = np.abs(np.linalg.det(edges)) / 24.0
        volumes = np.zeros(len(self.vertices))
        np.add.at(volumes, self.tets, quarter[:, None])
        return volumes

    @property
    def is_uniform(self) -> bool:
        """Say whether all tets have the same moduli."""
        return all(np.ptp(each) <= 1e-12 * self.mu[0] for each in (self.mu, self.lmbda))

    def one_material(self) -> tuple[float, float]:
        """Give mu and lmbda [kPa] where all tets have the same; RefusalError where they have not."""
        if not self.is_uniform:
            self.refuse("it takes one material per body")
        return float(self.mu[0]), float(self.lmbda[0])

    def check_taken(self, takes: Sequence[str]) -> None:
        """Raise RefusalError for "springs" or a "membrane" that a solver does not take."""
        has = {"springs": bool(self.springs.any()), "membrane": bool(len(self.membrane))}
        lacks = [name for name, there in has.items() if there and name not in takes]
        if lacks:
            self.refuse(f"it takes no {' and no '.join(lacks)}")

    def refuse(self, why: str) -> NoReturn:
        """Raise the RefusalError that makes the row."""
        raise RefusalError(why)


class Clock:
    """Processor time [s] of a run by phase, and the errors of what it shows.

    Phases end by `end`: "imports", "set-up", "compilation". What comes after is the solve, whose errors are written a
    line each, as they come: mean and largest distance to each answer. A run that is killed leaves what it had.
    Measuring and writing do not count. The first line is the step by which the system's clock advances: where a
    process' time is limited, this is some milliseconds.
    """

    def __init__(self, start: Floats, skin: NDArray[np.int64], answers: Sequence[Floats], budget: float, out: TextIO):
        self._skin, self._answers, self._budget, self._out = skin, answers, budget, out
        self._write({"clock_s": _measure_step()})
        self._begin, self._paused = time.process_time(), 0.0
        self._wall = time.perf_counter()
        self._mark, self._marked_at, self._looks = start, 0.2, 0

    def seconds(self) -> float:
        """Give the processor time [s] of the phase so far."""
        return time.process_time() - self._begin - self._paused

    def end(self, phase: str) -> None:
        """End a phase; the next one begins."""
        self._write({"phase": phase, "cpu_s": self.seconds()})
        self._begin, self._paused = time.process_time(), 0.0
        self._wall = time.perf_counter()

    def see(self, positions: Any, work: int) -> bool:
        """Measure positions (n, 3) [mm] after so much `work` (iterations or steps).

        False once the budget is spent, and where nothing moves any more (STILL).
        """
        seconds, wall, begin = self.seconds(), time.perf_counter() - self._wall, time.process_time()
        x = np.asarray(positions, dtype=np.float64)
        line: dict[str, Any] = {"cpu_s": seconds, "wall_s": wall, "work": int(work)}
        if not np.isfinite(x).all():
            self._write(line | {"error": "positions are not finite"})
            return False
        away = [np.linalg.norm(x - answer, axis=1)[self._skin] for answer in self._answers]
        self._write(line | {"errors": [[float(each.mean()), float(each.max())] for each in away]})
        moves = True
        self._looks += 1
        if seconds > WAIT * self._marked_at and self._looks >= LOOKS:
            moves = bool(np.abs(x - self._mark).max() > STILL)
            self._mark, self._marked_at, self._looks = np.array(x), seconds, 0
        self._paused += time.process_time() - begin
        return moves and seconds < self._budget

    def _write(self, line: Mapping[str, Any]) -> None:
        self._out.write(json.dumps(line) + "\n")


def _measure_step() -> float:
    """Measure the step [s] by which processor time advances."""
    begin = time.process_time()
    while (now := time.process_time()) == begin:
        pass
    return now - begin


class SolverFile(Protocol):
    """The contents of a solver's file.

    TITLE for tables; PACKAGES as pip names them, with the versions that were tested, the first the solver's own; LAW
    as `laws.LAWS` has it, or "" for one that FEniCSx is not given; DTYPE; SETTINGS by name, the first the package's
    defaults; TOLERANCE [mm]: how near to a hanging bar's answer it ends by one of them, infinite where nothing is said.
    A file may also define TAKES, which names what it models beside loads: "springs", "membrane". A problem with one
    that it does not name is refused.
    """

    TITLE: str
    PACKAGES: tuple[str, ...]
    LAW: str
    DTYPE: str
    SETTINGS: Mapping[str, Mapping[str, Any]]
    TOLERANCE: float
    run: Callable[[ArenaProblem, Mapping[str, Any], Clock], None]
