"""The cost of a plan: bytes by counting, core-hours by a rate measured on a person or on people done already."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from threadpoolctl import threadpool_limits

from .folder import CorpusStatus
from .people import People
from .plan import LENGTH, CorpusPlan
from .sequences import load_velocities
from .shard import FEM_LAWS, TABLES, columns_of
from .simulate import simulate_person

VARIED = 9
"""Parameters of a set, about, in the mean over kinds."""
REFERENCE = 10.0
"""Static frames that cost what one of FEniCSx' answers costs, where none was measured."""
PROBED = {"frames": 4, "references": 0, "run": 16}


@dataclass(frozen=True)
class Rates:
    """Processor seconds of one process: per person (shapes and fit), group, static frame, sequence frame, reference.

    busy: seconds that pass for each of them on this machine, where that was measured.
    """

    person: float
    group: float
    static: float
    sequence: float
    reference: float | None
    busy: float | None = None

    @classmethod
    def of(cls, status: CorpusStatus) -> Rates | None:
        """Divide the seconds that a corpus has spent; None where nothing is done, or they are not known."""
        spent, asked = status.seconds, status.asked
        if not status.identities_done or not asked["groups"] or not spent:
            return None

        def each(table: str) -> float:
            return spent.get(table, 0.0) / max(asked[table], 1)

        return cls(
            (spent.get("shapes", 0.0) + spent.get("fit", 0.0)) / status.identities_done,
            (spent.get("settling", 0.0) + spent.get("derivatives", 0.0)) / asked["groups"],
            each("statics"),
            each("sequences"),
            each("references") if asked["references"] else None,
        )


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


def measure_rates(plan: CorpusPlan, people: People) -> Rates:
    """Measure rates on the plan's second person; the first warms caches and does not count."""
    small = replace(plan, **PROBED)  # type: ignore[arg-type]
    with TemporaryDirectory() as folder, threadpool_limits(1):
        begun = load_velocities(Path(folder), small, people) if plan.sequences else None
        simulate_person(small, people, 0, begun)
        begin = time.monotonic(), time.process_time()
        seconds = simulate_person(small, people, 1, begun).seconds
        busy = (time.monotonic() - begin[0]) / (time.process_time() - begin[1])
    return Rates(
        seconds["shapes"] + seconds["fit"],
        (seconds["settling"] + seconds["derivatives"]) / small.groups,
        seconds["statics"] / (small.groups * small.frames),
        seconds.get("sequences", 0.0) / max(LENGTH * small.sequences, 1),  # a plan may have none
        None,
        busy,
    )


def predict_cost(plan: CorpusPlan, vertices: int, rates: Rates) -> Prediction:
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
        "parameter_responses": VARIED * round(plan.parameter_responses * responses),
        "references": len(FEM_LAWS) * references,
    }
    size = sum(count * _row_bytes(TABLES[table], vertices) for table, count in rows.items())
    seconds = plan.identities * rates.person + groups * rates.group + plan.static_frames * rates.static
    seconds += (LENGTH * sequences + (plan.run if sequences else 0)) * rates.sequence
    seconds += rows["references"] * (REFERENCE * rates.static if rates.reference is None else rates.reference)
    hours = seconds / 3600.0
    return Prediction(
        plan.identities, groups, plan.static_frames, sequences, responses, references, size, hours,
        None if rates.busy is None else hours * rates.busy,
    )  # fmt: skip


def _row_bytes(kind: type, vertices: int) -> int:
    """Count the bytes of a table's row over a skin of so many vertices; a code's few numbers are left out."""
    columns = columns_of(kind).values()
    return sum(column.dtype.itemsize * math.prod(column.lengths(vertices, 0)) for column in columns)
