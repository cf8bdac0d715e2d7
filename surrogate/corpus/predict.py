"""The cost of a plan: bytes by counting, core-hours by a person who is simulated here or by people done already."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from threadpoolctl import threadpool_limits

from .face import People
from .folder import CorpusStatus
from .people import people_from_text
from .plan import LENGTH, CorpusPlan
from .sequences import load_velocities
from .shard import FEM_LAWS, TABLES, columns_of
from .simulate import simulate_person

REFERENCE = 130.0
"""Static frames that cost what one of FEniCSx' answers costs, on average over both laws, where none was measured."""
PROBED = {"frames": 4, "references": 0, "run": 16}


@dataclass(frozen=True)
class Spent:
    """Processor seconds by phase of one process, and the `rows` that took them: people, and rows by table.

    busy: seconds that pass for each of them on this machine, where that was measured.
    """

    seconds: Mapping[str, float]
    rows: Mapping[str, int]
    busy: float | None = None

    @classmethod
    def of(cls, status: CorpusStatus) -> Spent | None:
        """Take what a corpus has spent; None where nothing is done, or its seconds are not known."""
        known = status.identities_done and status.seconds
        return cls(status.seconds, status.asked | {"people": status.identities_done}) if known else None

    def each(self, table: str, *phases: str) -> float:
        """Return the seconds of some phases for each row of a table."""
        return sum(self.seconds.get(phase, 0.0) for phase in phases) / max(self.rows[table], 1)


@dataclass(frozen=True)
class Prediction:
    """Counts of a plan, bytes of its shards, core-hours, and hours of one process on this machine as busy as now."""

    people: int
    groups: int
    statics: int
    sequences: int
    responses: int
    references: int
    bytes: int
    core_hours: float
    hours: float | None

    @property
    def bytes_per_frame(self) -> float:
        """Bytes of the shards over all frames, static and of sequences."""
        return self.bytes / max(self.statics + LENGTH * self.sequences, 1)


def probe(plan: CorpusPlan, people: People) -> Spent:
    """Simulate the plan's second person, with few frames; a sphere before it warms caches and does not count."""
    small = replace(plan, **PROBED)  # type: ignore[arg-type]
    with TemporaryDirectory() as folder, threadpool_limits(1):
        simulate_person(replace(small, sequences=0), people_from_text("spheres:1"), 0, None)
        begun = load_velocities(Path(folder), small, people) if plan.sequences else None
        begin = time.monotonic(), time.process_time()
        seconds = simulate_person(small, people, 1, begun).seconds
        busy = (time.monotonic() - begin[0]) / (time.process_time() - begin[1])
    groups, frames = small.groups, LENGTH * small.sequences
    rows = {"people": 1, "groups": groups, "statics": groups * small.frames, "sequences": frames, "references": 0}
    return Spent(seconds, rows, busy)


def predict_cost(plan: CorpusPlan, vertices: int, spent: Spent) -> Prediction:
    """Predict counts, bytes and core-hours of a plan over a skin of so many vertices.

    The long run of the velocities counts by its frames, which cost what those of sequences cost.
    """
    groups, sequences = plan.identities * plan.groups, plan.identities * plan.sequences
    responses, references = round(plan.responses * groups), plan.tested * plan.references
    rows = {
        "persons": plan.identities,
        "groups": groups,
        "statics": plan.static_frames,
        "sequences": sequences,
        "responses": responses,
        "references": len(FEM_LAWS) * references,
    }
    size = sum(count * _row_bytes(TABLES[table], vertices) for table, count in rows.items())
    static = spent.each("statics", "statics")
    reference = spent.each("references", "references") if spent.rows["references"] else REFERENCE * static
    seconds = plan.identities * spent.each("people", "shapes", "fit")
    seconds += groups * spent.each("groups", "settling", "derivatives") + plan.static_frames * static
    seconds += (LENGTH * sequences + (plan.run if sequences else 0)) * spent.each("sequences", "sequences")
    seconds += rows["references"] * reference
    hours = seconds / 3600.0
    return Prediction(
        plan.identities, groups, plan.static_frames, sequences, responses, references, size, hours,
        None if spent.busy is None else hours * spent.busy,
    )  # fmt: skip


def _row_bytes(kind: type, vertices: int) -> int:
    """Count the bytes of a table's row over a skin of so many vertices; a code's few numbers are left out."""
    columns = columns_of(kind).values()
    return sum(column.dtype.itemsize * math.prod(column.lengths(vertices, 0)) for column in columns)
