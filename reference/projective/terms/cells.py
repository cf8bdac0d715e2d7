"""Strain and Volume on the tets or prisms of a scene, in blocks: energy, gradient, matrix, Hessian (SoftDECA Eq. 10).

E = Σ w/2 ‖F - p(F)‖² has the exact gradient Σ w (F - p) : ∂F/∂x, since p minimises the distance. The hourglass
energies of prisms are quadratic: one constant matrix is all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, tril

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Cells, Hourglass, Strain, Volume
from ...terms.cells import gradients_in_prisms
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
    PRISM,
    STRAIN,
    STRAIN2,
    TARGET,
    TET,
    VOLUME,
    add_cells,
)
from .part import Part

WIDE = 2.0
"""A Strain whose limit is above that hardly ever acts."""
_STRAIN_ROWS = np.array([[STRAIN, LOW, HIGH], [STRAIN2, LOW2, HIGH2]]) // LANES
"""Weight and bounds of the two Strains that a row of blocks has room for."""


@dataclass(frozen=True, eq=False)
class _Places:
    """Where a Strain or Volume stands: its rows of blocks (k,), of a Strain which of the two, and whose numbers."""

    rows: Ints
    slots: Ints
    term: Strain | Volume | None = None

    def has_numbers_of(self, term: Strain | Volume) -> bool:
        """Whether a term of the same cells has the numbers that were written."""
        mine = self.term
        if isinstance(mine, Strain) and isinstance(term, Strain):
            return _same(mine, term, "stiffness", "limit")
        return isinstance(mine, Volume) and isinstance(term, Volume) and _same(mine, term, "stiffness", "target")

    def write(self, term: Strain | Volume, volumes: Floats, parameters: Floats):
        """Write a term's numbers to the blocks; volumes (k,) [mm³] are those of its cells."""
        if isinstance(term, Volume):
            _spread(term.stiffness * volumes, VOLUME // LANES, self.rows, parameters)
            _spread(term.target, TARGET // LANES, self.rows, parameters)
            return
        strain, low, high = _STRAIN_ROWS[self.slots].T
        _spread(term.stiffness * volumes, strain, self.rows, parameters)
        _spread(1.0 / term.limit, low, self.rows, parameters)
        _spread(term.limit, high, self.rows, parameters)


def _same(one: Strain | Volume, other: Strain | Volume, *names: str) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@dataclass(frozen=True, eq=False)
class CellBlocks(Part):
    """Parameters and corners in the layout of `local_step`, and where each Strain and Volume of the scene stands.

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
    def terms_of(cls, scene: Scene) -> list[Strain | Volume]:
        """Return the terms on cells of this kind."""
        return [term for term in scene.of(Strain) + scene.of(Volume) if term.on_prisms == (cls.edges is PRISM)]

    @classmethod
    def from_scene(cls, scene: Scene) -> Self | None:
        """Build the blocks of a scene, or None if it has no cell of this kind with a stiffness."""
        tets, places = _pair_up(scene, cls.terms_of(scene))
        if not len(tets):
            return None
        cells, every = Cells.from_mesh(scene, tets), np.arange(len(tets))
        blocks = -(-len(tets) // LANES)
        parameters = np.zeros((blocks, GRADIENTS // LANES + 3 * len(cls.edges), LANES))
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
            place.write(term, self.cells.volumes[place.rows], parameters)
        places = tuple(replace(place, term=term) for place, term in zip(self.places, terms, strict=True))
        return replace(self, parameters=parameters, kinds=_kinds_of(parameters), places=places)

    def rebuilt(self, scene: Scene) -> Self:
        """See Part."""
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
        """See Part."""
        parameters, corners = (numbers.reshape(len(numbers), -1) for numbers in (self.parameters, self.corners))
        return total + add_cells(parameters, corners, self.edges, self.kinds, u, gradient)

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of Σ w V G Gᵀ, the cells' part of the PD matrix [mN/mm]: see `Part`."""
        weights = volume_share * self.parameters[:, VOLUME // LANES]
        for strain, _, high in _STRAIN_ROWS:
            weights = weights + _share(self.parameters[:, high], volume_share) * self.parameters[:, strain]
        gradients = self.cells.gradients
        local = np.einsum("e,eai,ebi->eab", weights.ravel()[: len(self.tets)], gradients, gradients)
        return _entries(self.cells.vertices, local)

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


@dataclass(frozen=True, eq=False)
class Hourglasses(Part):
    """The matrix (n, n) [mN/mm] that all Hourglass terms are, of each component of the displacement."""

    matrix: csr_matrix
    terms: tuple[Hourglass, ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Hourglasses | None:
        """See Part: Σ_t w_t D_t D_tᵀ of each prism, with D_t the gradients of F_t - F over its six vertices."""
        terms, n = tuple(scene.of(Hourglass)), len(scene.vertices)
        if not terms:
            return None
        matrix = csr_matrix((n, n))
        for term in terms:
            vertices, gradients = gradients_in_prisms(scene, term.tets)
            volumes = scene.volumes[term.tets]
            mean = np.einsum("kt,ktad->kad", volumes / volumes.sum(axis=1, keepdims=True), gradients)
            away, weights = gradients - mean[:, None], np.reshape(term.stiffness, (-1, 1)) * volumes
            rows, columns, values = _entries(vertices, np.einsum("kt,ktad,ktbd->kab", weights, away, away))
            matrix = matrix + coo_matrix((values, (rows, columns)), shape=(n, n))
        return cls(csr_matrix(matrix), terms)

    def rebuilt(self, scene: Scene) -> Hourglasses | None:
        """See Part."""
        terms = scene.of(Hourglass)
        same = all(np.array_equal(a.stiffness, b.stiffness) for a, b in zip(self.terms, terms, strict=True))
        return self if same else self.from_scene(scene)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        """See Part."""
        pull = self.matrix @ u
        gradient += pull
        return total + 0.5 * float(np.vdot(u, pull))

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """See Part."""
        entries = self.matrix.tocoo()
        return entries.row, entries.col, entries.data

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """See Part."""
        return self.matrix.indptr, self.matrix.indices

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs of vertices (k, 2) of the matrix's lower half."""
        lower = tril(self.matrix, format="coo")
        return np.column_stack([lower.row, lower.col])

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """See Part."""
        blocks[slots] += tril(self.matrix, format="coo").data[:, None, None] * np.eye(3)


def _entries(vertices: Ints, local: Floats) -> tuple[Ints, Ints, Floats]:
    """Return rows, columns and values of a sum of matrices (k, a, a), each over its vertices (k, a)."""
    count = vertices.shape[1]
    return np.repeat(vertices, count, axis=1).ravel(), np.tile(vertices, (1, count)).ravel(), local.ravel()


def _pair_up(scene: Scene, terms: list[Strain | Volume]) -> tuple[Ints, tuple[_Places, ...]]:
    """Make one row per cell, or more where it has many terms: the rows' tets, and where each term stands.

    The first two Strains and the first Volume of a cell share a row, for they share F and its stretches; so do the
    next. All terms are on tets, or all on prisms, which their first tet names.
    """
    keys, slots = [], []
    for kind, room in ((Strain, len(_STRAIN_ROWS)), (Volume, 1)):
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
