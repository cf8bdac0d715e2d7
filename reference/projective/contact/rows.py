"""Pairs that are near one another: their gaps, forces and energy.

A gap d below its offset o has the energy ½ stiffness (o - d)² o / d: at first a spring, and more than any load as d
falls to 0. Two edges that are all but parallel have no one pair of nearest points: of theirs a share is taken, which is
none for parallel ones (Li et al. 2020, "Incremental Potential Contact", Eq. 24).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ....lhm.base.mesh import Floats, Ints

TINY = 1e-12
"""[mm] A distance of 0 counts as this."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Pairs near one another, r of them.

    ids (r, 4) of the contact vertices and between_edges (r,): the pairs, as of `terms.Gaps`; weights (r, 4) and
    normals (r, 3) of their gaps, see `terms.gaps.measure_pair`; distance and offset (r,) [mm]; stiffness (r,) [mN/mm];
    share (r,), and its derivative by the corners, turns (r, 4, 3) [1/mm], see `terms.gaps.find_shares`.
    """

    ids: Ints
    between_edges: np.ndarray
    weights: Floats
    normals: Floats
    distance: Floats
    offset: Floats
    stiffness: Floats
    share: Floats
    turns: Floats

    @cached_property
    def depth(self) -> Floats:
        """The offset less the distance [mm], shape (r,)."""
        return self.offset - self.distance

    @classmethod
    def concatenate(cls, parts: Sequence[Rows]) -> Rows:
        """Concatenate the rows of several surfaces."""
        return cls(*(np.concatenate([getattr(rows, field.name) for rows in parts]) for field in fields(cls)))

    def select(self, which: Ints) -> Rows:
        """Select some rows."""
        return Rows(*(getattr(self, field.name)[which] for field in fields(self)))

    @cached_property
    def _distance_below(self) -> Floats:
        return np.clip(self.distance, TINY, self.offset)

    @property
    def energy(self) -> float:
        """The energy [µJ]."""
        return float(self.share @ self._full_energies)

    @cached_property
    def _full_energies(self) -> Floats:
        depth = np.maximum(self.depth, 0.0)
        return 0.5 * self.stiffness * depth**2 * self.offset / self._distance_below

    @cached_property
    def forces(self) -> Floats:
        """The forces [mN], shape (r,), that push each pair apart."""
        ratio = self.offset / self._distance_below
        return 0.5 * self.share * self.stiffness * self.offset * (ratio**2 - 1.0)

    def give_way(self, forces: Floats) -> tuple[Floats, Floats]:
        """Return the depths [mm] at which pairs push by forces (r,) [mN], and their derivatives [mm/mN]."""
        stiffness = self.share * self.stiffness
        ratio = 1.0 + 2.0 * forces / (stiffness * self.offset)
        return self.offset * (1.0 - ratio**-0.5), ratio**-1.5 / stiffness

    def push(self, count: int) -> Floats:
        """Return all forces [mN] of the energy on the contact vertices, shape (count, 3)."""
        return self.spread(self.forces, count) + self.turn(count)

    def turn(self, count: int) -> Floats:
        """Return the forces [mN], shape (count, 3), by which edges that are all but parallel turn from one another."""
        return self._sum(-self._full_energies[:, None, None] * self.turns, count)

    def spread(self, forces: Floats, count: int) -> Floats:
        """Spread forces (r,) along the gaps over the contact vertices, shape (count, 3)."""
        return self._sum((forces[:, None] * self.weights)[:, :, None] * self.normals[:, None, :], count)

    def _sum(self, forces: Floats, count: int) -> Floats:
        ids = self.ids.ravel()
        return np.stack([np.bincount(ids, forces[..., c].ravel(), count) for c in range(3)], axis=1)

    def widen(self, motion: Floats) -> Floats:
        """Tell by how much a motion (k, 3) [mm] widens each gap, shape (r,)."""
        return np.einsum("rj,rjc,rc->r", self.weights, motion[self.ids], self.normals)
