"""Strain, Volume and Hourglass on tets or prisms, in blocks: energy, gradient, matrix, Hessian (SoftDECA Eq. 10).

E = Σ w/2 ‖F - p(F)‖² has the exact gradient Σ w (F - p) : ∂F/∂x, since p minimises the distance. Hourglass holds the
two modes of a prism that F does not see, in the same pass over its edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Cells, Hourglass, Strain, Volume
from .cell_tangent import add_cell_tangent, corner_pairs
from .local_step import (
    GRADIENTS,
    HAS_BOUNDS,
    HAS_GUARDS,
    HAS_VOLUME,
    HIGH,
    HIGH2,
    LANES,
    LOW,
    LOW2,
    MODES,
    PRISM,
    STRAIN,
    STRAIN2,
    TARGET,
    TET,
    VOLUME,
    WEIGHTS,
    add_cells,
)
from .part import Part

WIDE = 2.0
"""A Strain whose limit is above that hardly ever acts."""
_STRAIN_ROWS = np.array([[STRAIN, LOW, HIGH], [STRAIN2, LOW2, HIGH2]]) // LANES
"""Weight and bounds of the two Strains that a row of blocks has room for."""


OnCells = Strain | Volume | Hourglass


@dataclass(frozen=True, eq=False)
class _Places:
    """Where a term stands: its rows of blocks (k,), of a Strain which of the two, and whose numbers."""

    rows: Ints
    slots: Ints
    term: OnCells | None = None

    def has_numbers_of(self, term: OnCells) -> bool:
        """Whether a term of the same cells has the numbers that were written."""
        mine = self.term
        if isinstance(mine, Strain) and isinstance(term, Strain):
            return _same(mine, term, "stiffness", "limit")
        if isinstance(mine, Hourglass) and isinstance(term, Hourglass):
            return _same(mine, term, "stiffness")
        return isinstance(mine, Volume) and isinstance(term, Volume) and _same(mine, term, "stiffness", "target")

    def write(self, term: OnCells, cells: Cells, parameters: Floats):
        """Write a term's numbers to the blocks of cells."""
        if isinstance(term, Hourglass):
            held = np.sqrt(np.reshape(term.stiffness, (-1, 1, 1))) * cells.modes[self.rows, :, 1:]
            for row, share in enumerate(held.transpose(2, 1, 0).reshape(-1, len(self.rows)), MODES // LANES):
                _spread(share, row, self.rows, parameters)
            return
        weight = term.stiffness * cells.volumes[self.rows]
        if isinstance(term, Volume):
            _spread(weight, VOLUME // LANES, self.rows, parameters)
            _spread(term.target, TARGET // LANES, self.rows, parameters)
            return
        strain, low, high = _STRAIN_ROWS[self.slots].T
        _spread(weight, strain, self.rows, parameters)
        _spread(1.0 / term.limit, low, self.rows, parameters)
        _spread(term.limit, high, self.rows, parameters)


def _same(one: OnCells, other: OnCells, *names: str) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@dataclass(frozen=True, eq=False)
class CellBlocks(Part):
    """Parameters and corners in the layout of `local_step`, and where each term of the scene stands.

    A row of blocks is a cell; cells that many terms share have several rows. tets: of each row, see `Solid`.
    """

    edges: ClassVar[tuple[int, ...]]

    corners: np.ndarray
    parameters: Floats
    kinds: np.ndarray
    places: tuple[_Places, ...]
    tets: Ints
    cells: Cells

    @classmethod
    def terms_of(cls, scene: Scene) -> list[OnCells]:
        """Return the terms on cells of this kind."""
        terms = scene.of(Strain) + scene.of(Volume) + scene.of(Hourglass)
        return [term for term in terms if term.on_prisms == (cls.edges is PRISM)]

    @classmethod
    def from_scene(cls, scene: Scene) -> Self | None:
        """Build the blocks of a scene, or None if it has no cell of this kind with a stiffness."""
        tets, places = _pair_up(scene, cls.terms_of(scene))
        if not len(tets):
            return None
        all_prisms = np.array_equal(tets, scene.prisms)
        cells, every = scene.prism_cells if all_prisms else Cells.from_mesh(scene, tets), np.arange(len(tets))
        blocks = -(-len(tets) // LANES)
        parameters = np.zeros((blocks, WEIGHTS + len(cls.edges) ** 2, LANES))
        parameters[:, [row // LANES for row in (LOW, HIGH, LOW2, HIGH2, TARGET)]] = 1.0
        corners = np.zeros((blocks, 1 + len(cls.edges), LANES), dtype=np.uint32)
        for row, gradient in enumerate(cells.gradients[:, 1:].reshape(len(tets), -1).T, GRADIENTS // LANES):
            _spread(gradient, row, every, parameters)
        for corner, vertices in enumerate(cells.vertices.T):
            _spread(vertices, corner, every, corners)
        return cls(corners, parameters, _kinds_of(parameters), places, tets, cells).for_scene(scene)

    def for_scene(self, scene: Scene) -> Self:
        """Return the same blocks with the numbers, one or one per cell, of another scene of the same terms."""
        terms = self.terms_of(scene)
        if all(place.has_numbers_of(term) for place, term in zip(self.places, terms, strict=True)):
            return self
        parameters = self.parameters.copy()
        for place, term in zip(self.places, terms, strict=True):
            place.write(term, self.cells, parameters)
        places = tuple(replace(place, term=term) for place, term in zip(self.places, terms, strict=True))
        return replace(self, parameters=parameters, kinds=_kinds_of(parameters), places=places)

    def rebuilt(self, scene: Scene) -> Self:
        return self.for_scene(scene)

    def separate(self) -> Self:
        """Return the same rows over vertices of their own: those of row r follow those of row r - 1."""
        corners = np.zeros_like(self.corners)
        every = np.arange(len(self.tets))
        for corner in range(corners.shape[1]):
            _spread(corners.shape[1] * every + corner, corner, every, corners)
        return replace(self, corners=corners)

    def untangling(self, volume_share: float) -> Self:
        """Move a share of Volume's weight to Strain with limit 1, and leave the rest out.

        A Strain of wide limit is left with the share that the matrix has of it.
        """
        parameters = self.parameters.copy()
        for strain, low, high in _STRAIN_ROWS:
            parameters[:, strain] *= _share(parameters[:, high], volume_share)
            parameters[:, low] = parameters[:, high] = 1.0
        parameters[:, STRAIN // LANES] += volume_share * parameters[:, VOLUME // LANES]
        parameters[:, VOLUME // LANES] = 0.0
        none = tuple(replace(place, term=None) for place in self.places)
        return replace(self, parameters=parameters, kinds=_kinds_of(parameters), places=none)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        parameters, corners = (numbers.reshape(len(numbers), -1) for numbers in (self.parameters, self.corners))
        return total + add_cells(parameters, corners, self.edges, self.kinds, u, gradient)

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of Σ w V G Gᵀ, the cells' part of the PD matrix [mN/mm]: see `Part`."""
        weights = volume_share * self.parameters[:, VOLUME // LANES]
        for strain, _, high in _STRAIN_ROWS:
            weights = weights + _share(self.parameters[:, high], volume_share) * self.parameters[:, strain]
        gradients = self.cells.gradients
        local = np.einsum("e,eai,ebi->eab", weights.ravel()[: len(self.tets)], gradients, gradients)
        if self.edges is PRISM:
            held = self.parameters[:, MODES // LANES :].transpose(0, 2, 1).reshape(-1, 5, 2)[: len(self.tets)]
            held = np.concatenate([-held.sum(axis=1, keepdims=True), held], axis=1)
            local += held @ held.transpose(0, 2, 1)
        vertices, count = self.cells.vertices, 1 + len(self.edges)
        return np.repeat(vertices, count, axis=1).ravel(), np.tile(vertices, (1, count)).ravel(), local.ravel()

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """Return the vertices (k, a) of all rows."""
        return (self.cells.vertices,)

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs of vertices (k, 2), ten per tet and 21 per prism."""
        return self.cells.vertices[:, corner_pairs(1 + len(self.edges))].reshape(-1, 2)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian; see `Part`. Of Strain's weight no eigenvalue of dP/dF is below the share `least`."""
        parameters, corners = (a.reshape(len(a), -1) for a in (self.parameters, self.corners))
        slots = slots.reshape(len(self.tets), -1)
        add_cell_tangent(parameters, corners, self.edges, self.kinds, slots, least, u, blocks)


class TetBlocks(CellBlocks):
    """Those of single tets."""

    edges = TET


class PrismBlocks(CellBlocks):
    """Those of prisms."""

    edges = PRISM


def _pair_up(scene: Scene, terms: list[OnCells]) -> tuple[Ints, tuple[_Places, ...]]:
    """Make one row per cell, or more where it has many terms: the rows' tets, and where each term stands.

    The first two Strains, the first Volume and the first Hourglass of a cell share a row, for they share F and its
    stretches; so do the next. All terms are on tets, or all on prisms, which their first tet names.
    """
    keys, slots = [], []
    for kind, room in ((Strain, len(_STRAIN_ROWS)), (Volume, 1), (Hourglass, 1)):
        count = np.zeros(len(scene.tets), dtype=np.int64)
        for term in (term for term in terms if isinstance(term, kind)):
            first = scene.tets_of(term)[:, 0] if term.on_prisms else scene.tets_of(term)
            keys.append(first + len(scene.tets) * (count[first] // room))
            slots.append(count[first] % room)
            count[first] += 1
    rows = np.unique(np.concatenate(keys)) if keys else np.zeros(0, dtype=np.int64)
    places = tuple(_Places(np.searchsorted(rows, key), slot) for key, slot in zip(keys, slots, strict=True))
    tets = rows % max(len(scene.tets), 1)
    if terms and terms[0].on_prisms:
        tets = scene.prisms[np.searchsorted(scene.prisms[:, 0], tets)]
    return tets, places


def _spread(values, row: int | Ints, rows: Ints, blocks: np.ndarray):
    """Write one value per row of `_pair_up` to the row, or to one row each, of the blocks."""
    blocks[rows // LANES, row, rows % LANES] = values


def _kinds_of(parameters: Floats) -> np.ndarray:
    """Tell what each block asks for, by its parameters (blocks, rows, LANES): see `local_step`."""
    strain, low, high = (parameters[:, row // LANES] for row in (STRAIN, LOW, HIGH))
    volume, guard = (parameters[:, row // LANES] for row in (VOLUME, STRAIN2))
    bounded = (strain > 0.0) & (low != high)
    asked = ((HAS_VOLUME, volume > 0.0), (HAS_BOUNDS, bounded), (HAS_GUARDS, guard > 0.0))
    return np.sum([flag * lanes.any(axis=1) for flag, lanes in asked], axis=0, dtype=np.uint8)


def _share(high: Floats, volume_share: float) -> Floats:
    """Return the share of Strains that the matrix has, by their upper bounds: all, or little where one rarely acts.

    On eight shapes of two heads L-BFGS took 532, 457, 434 and 460 iterations with shares of 0.3, 0.15, 0.08 and 0.04.
    """
    return np.where(high > WIDE, volume_share**2, 1.0)
