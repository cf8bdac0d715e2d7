"""The scene's Strain and Volume terms as blocks of tets for the local step."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from ..terms import Strain, Volume
from .lanes import ACTIVE, HIGH, LANES, LOW, PARAMETERS, STRAIN, TARGET, VOLUME
from .local_step import add_tets

ALWAYS = -1.0
"""Below any largest stretch."""
WIDE = 2.0
"""A Strain whose limit is above that hardly ever acts."""


@cache
def _workers(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)


def shape_gradients(scene: Scene, tets: Ints) -> tuple[Floats, Floats]:
    """Dm_inv [1/mm] of the given tets, shape (k, 3, 3), and the gradients G of their shape functions, (k, 4, 3)."""
    corners = scene.vertices[scene.tets[tets]]
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    inverse = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)  # far faster than linalg.inv
    inverse /= np.sum(a * inverse[:, 0], axis=1)[:, None, None]
    return inverse, np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def _pair_up(scene: Scene) -> tuple[Ints, list[tuple[Strain | Volume, Ints]]]:
    """One row per tet, or as many as it has Strain or Volume terms: the rows' tets, and each term's rows.

    The k-th Strain and the k-th Volume of a tet share a row, for they share F and its decomposition.
    """
    entries: list[tuple[Strain | Volume, Ints]] = []
    for kind in (Strain, Volume):
        count = np.zeros(len(scene.tets), dtype=np.int64)
        for term in scene.of(kind):
            tets = scene.tets_of(term)
            entries.append((term, tets + len(scene.tets) * count[tets]))
            count[tets] += 1
    keys = [key for _, key in entries]
    rows = np.unique(np.concatenate(keys)) if keys else np.zeros(0, dtype=np.int64)
    return rows % max(len(scene.tets), 1), [(term, np.searchsorted(rows, key)) for term, key in entries]


def _spread(values, row: int, rows: Ints, blocks: np.ndarray):
    """Write one value per row of `_pair_up` at the offset `row` of the blocks."""
    blocks[rows // LANES, row // LANES, rows % LANES] = values


def _share(parameters: Floats, volume_share: float) -> Floats:
    """The share of each row's Strain that the matrix has, shape (blocks, LANES): small, or all, where it rarely acts.

    On eight shapes of two heads L-BFGS took 532, 457, 434 and 460 iterations with shares of 0.3, 0.15, 0.08 and 0.04.
    """
    return np.where(parameters[:, HIGH // LANES] > WIDE, volume_share**2, 1.0)


@dataclass(frozen=True, eq=False)
class TetBlocks:
    """Parameters and corners in the layout of `lanes`, and which rows each Strain and Volume of the scene has."""

    corners: np.ndarray
    parameters: Floats
    has_volume: np.ndarray
    rows_of: tuple[Ints, ...]
    tets: Ints
    threads: int = 1

    @classmethod
    def of(cls, scene: Scene, threads: int = 1) -> TetBlocks | None:
        """The blocks of a scene, or None if it has no tet with a stiffness."""
        tets, entries = _pair_up(scene)
        if not len(tets):
            return None
        blocks = -(-len(tets) // LANES)
        parameters = np.zeros((blocks, PARAMETERS, LANES))
        parameters[:, [LOW // LANES, HIGH // LANES, TARGET // LANES]] = 1.0
        parameters[:, ACTIVE // LANES] = ALWAYS
        corners = np.zeros((blocks, 4, LANES), dtype=np.uint32)
        every = np.arange(len(tets))
        inverse, _ = shape_gradients(scene, tets)
        for row in range(9):
            _spread(inverse[:, row // 3, row % 3], LANES * row, every, parameters)
        for corner in range(4):
            _spread(scene.tets[tets, corner], LANES * corner, every, corners)
        none = np.zeros(blocks, dtype=bool)
        return cls(corners, parameters, none, tuple(rows for _, rows in entries), tets, threads).for_scene(scene)

    def for_scene(self, scene: Scene) -> TetBlocks:
        """The same blocks with the numbers, one or one per tet, of another scene of the same terms."""
        parameters = self.parameters.copy()
        for term, rows in zip(scene.of(Strain) + scene.of(Volume), self.rows_of, strict=True):
            stiffness = term.stiffness * scene.volumes[self.tets[rows]]
            _spread(stiffness, STRAIN if isinstance(term, Strain) else VOLUME, rows, parameters)
            if isinstance(term, Strain) and term.rule == "indicator":
                _spread(term.limit, ACTIVE, rows, parameters)
            elif isinstance(term, Strain):
                size = np.cbrt(term.growth)
                _spread(size / term.limit, LOW, rows, parameters)
                _spread(size * term.limit, HIGH, rows, parameters)
            else:
                _spread(term.target, TARGET, rows, parameters)
        has_volume = (parameters[:, VOLUME // LANES] > 0).any(axis=1)
        return replace(self, parameters=parameters, has_volume=has_volume)

    def apart(self) -> TetBlocks:
        """The same rows over vertices of their own: 4 r to 4 r + 3 are the corners of row r."""
        corners = np.zeros_like(self.corners)
        every = np.arange(len(self.tets))
        for corner in range(4):
            _spread(4 * every + corner, LANES * corner, every, corners)
        return replace(self, corners=corners, threads=1)

    def untangling(self, volume_share: float) -> TetBlocks:
        """The same blocks with a share of Volume's weight moved to Strain with limit 1, the rest left out.

        A Strain of wide limit is left with the share that the matrix has of it.
        """
        parameters = self.parameters.copy()
        parameters[:, STRAIN // LANES] *= _share(parameters, volume_share)
        parameters[:, STRAIN // LANES] += volume_share * parameters[:, VOLUME // LANES]
        parameters[:, VOLUME // LANES] = 0.0
        size = np.sqrt(parameters[:, LOW // LANES] * parameters[:, HIGH // LANES])
        parameters[:, LOW // LANES] = parameters[:, HIGH // LANES] = size
        parameters[:, ACTIVE // LANES] = ALWAYS
        return replace(self, parameters=parameters, has_volume=np.zeros_like(self.has_volume))

    def add_to(self, u: Floats, gradient: Floats) -> float:
        """Add the gradient [mN] at displacement u [mm], both (n, 3), in place; return the energy [µJ].

        Threads share the blocks evenly and add up in order: the same bits each time for the same number of threads.
        """
        blocks = self.parameters.reshape(len(self.parameters), -1), self.corners.reshape(len(self.corners), -1)
        if self.threads == 1:
            return add_tets(*blocks, self.has_volume, u, gradient)

        def share(first: int, last: int) -> tuple[float, Floats]:
            own = np.zeros_like(gradient)
            return add_tets(*(part[first:last] for part in blocks), self.has_volume[first:last], u, own), own

        bounds = np.linspace(0, len(self.parameters), self.threads + 1).astype(int)
        total = 0.0
        for energy, own in _workers(self.threads).map(share, bounds[:-1], bounds[1:]):
            total += energy
            gradient += own
        return total

    def stiffness_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Rows, columns and values of Σ w V G Gᵀ, the tets' part of the PD matrix [mN/mm]; see `Energy.matrix`."""
        strain, volume = (self.parameters[:, row // LANES].ravel()[: len(self.tets)] for row in (STRAIN, VOLUME))
        shares = _share(self.parameters, volume_share).ravel()[: len(self.tets)]
        _, gradients = shape_gradients(scene, self.tets)
        local = np.einsum("e,eai,ebi->eab", shares * strain + volume_share * volume, gradients, gradients)
        corners = scene.tets[self.tets]
        return np.repeat(corners, 4, axis=1).ravel(), np.tile(corners, (1, 4)).ravel(), local.ravel()
