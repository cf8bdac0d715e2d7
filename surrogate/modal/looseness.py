"""Where the flesh of a space's people is loose, and what their heads turn about: linear in the code.

Both follow from a fitted head's depths of bone, which a bind in milliseconds has not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import FitError
from ...lhm.base.mesh import Floats
from ...lhm.base.progress import OnProgress, silent
from ...reference.face.dynamics import find_pivot, measure_looseness
from ..corpus.people import People

PEOPLE = 96
SEED = 41
RIDGE = 8.0
"""Of each coefficient of a code, whose numbers are of size one, in people."""
NOTHING = 0.02
"""A share below which a vertex does not swing: at p's lowest frequency it would be at rest within one frame."""


@dataclass(frozen=True, eq=False)
class Looseness:
    """shares (1 + c, n) of each vertex that swings, pivots (1 + c, 3) [mm]: of the mean, then by number of the code."""

    shares: Floats
    pivots: Floats

    @classmethod
    def of(cls, people: People, *, count: int = PEOPLE, on_progress: OnProgress = silent) -> Looseness:
        """By ridge regression over random people whose heads are fitted, a second or so each."""
        rng = np.random.default_rng(SEED)
        codes, shares, pivots = [], [], []
        for number in range(count):
            person = people.person(rng)
            on_progress(f"where faces are loose: head {number + 1} of {count}", (number + 1) / count)
            try:
                head = people.head(person)
            except FitError:
                continue
            codes.append(np.append(1.0, person.code))
            shares.append(head.skin_from_wrap @ measure_looseness(head))
            pivots.append(find_pivot(head))
        rows = np.array(codes)
        penalty = RIDGE * np.eye(rows.shape[1])
        penalty[0, 0] = 0.0
        inverse: Floats = np.linalg.solve(rows.T @ rows + penalty, rows.T)
        return cls(inverse @ np.array(shares), inverse @ np.array(pivots))

    def at(self, code: Floats) -> tuple[Floats, Floats]:
        """Shares (n,), in [0, 1], and pivot (3,) [mm] of a person."""
        row = np.append(1.0, code)
        found = row @ self.shares
        return np.where(found > NOTHING, np.clip(found, 0.0, 1.0), 0.0), row @ self.pivots
