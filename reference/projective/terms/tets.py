"""Strain and Volume on the tets of a scene, in blocks: their energy, gradient, matrix and Hessian (SoftDECA Eq. 10).

E = Σ w/2 ‖F - p(F)‖² has the exact gradient Σ w (F - p) : ∂F/∂x, since p minimises the distance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Strain, Volume
from .local_step import (
    HAS_BOUNDS,
    HAS_GUARDS,
    HAS_VOLUME,
    HIGH,
    HIGH2,
    LANES,
    LOW,
    LOW2,
    PARAMETERS,
    STRAIN,
    STRAIN2,
    TARGET,
    VOLUME,
    add_tets,
)
from .part import Part
from .tet_tangent import PAIRS, add_tet_tangent

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
        """Whether a term of the same tets has the numbers that were written."""
        mine = self.term
        if isinstance(mine, Strain) and isinstance(term, Strain):
            return _same(mine, term, "stiffness", "limit")
        return isinstance(mine, Volume) and isinstance(term, Volume) and _same(mine, term, "stiffness", "target")

    def write(self, term: Strain | Volume, volumes: Floats, parameters: Floats):
        """Write a term's numbers to the blocks; volumes (k,) [mm³] are those of its tets."""
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
class TetBlocks(Part):
    """Parameters and corners in the layout of `local_step`, and where each Strain and Volume of the scene stands."""

    corners: np.ndarray
    parameters: Floats
    kinds: np.ndarray
    places: tuple[_Places, ...]
    tets: Ints

    @classmethod
    def from_scene(cls, scene: Scene) -> TetBlocks | None:
        """Build the blocks of a scene, or None if it has no tet with a stiffness."""
        tets, places = _pair_up(scene)
        if not len(tets):
            return None
        blocks = -(-len(tets) // LANES)
        parameters = np.zeros((blocks, PARAMETERS, LANES))
        parameters[:, [row // LANES for row in (LOW, HIGH, LOW2, HIGH2, TARGET)]] = 1.0
        corners = np.zeros((blocks, 4, LANES), dtype=np.uint32)
        every = np.arange(len(tets))
        inverse, _ = shape_gradients(scene, tets)
        for row in range(9):
            _spread(inverse[:, row // 3, row % 3], row, every, parameters)
        for corner in range(4):
            _spread(scene.tets[tets, corner], corner, every, corners)
        return cls(corners, parameters, _kinds_of(parameters), places, tets).for_scene(scene)

    def for_scene(self, scene: Scene) -> TetBlocks:
        """Return the same blocks with the numbers, one or one per tet, of another scene of the same terms."""
        terms = scene.of(Strain) + scene.of(Volume)
        if all(place.has_numbers_of(term) for place, term in zip(self.places, terms, strict=True)):
            return self
        parameters = self.parameters.copy()
        for place, term in zip(self.places, terms, strict=True):
            place.write(term, scene.volumes[self.tets[place.rows]], parameters)
        places = tuple(replace(place, term=term) for place, term in zip(self.places, terms, strict=True))
        return replace(self, parameters=parameters, kinds=_kinds_of(parameters), places=places)

    def rebuilt(self, scene: Scene) -> TetBlocks:
        """See Part."""
        return self.for_scene(scene)

    def separate(self) -> TetBlocks:
        """Return the same rows over vertices of their own: 4 r to 4 r + 3 are the corners of row r."""
        corners = np.zeros_like(self.corners)
        every = np.arange(len(self.tets))
        for corner in range(4):
            _spread(4 * every + corner, corner, every, corners)
        return replace(self, corners=corners)

    def untangling(self, volume_share: float) -> TetBlocks:
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
        blocks = (numbers.reshape(len(numbers), -1) for numbers in (self.parameters, self.corners))
        return total + add_tets(*blocks, self.kinds, u, gradient)

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of Σ w V G Gᵀ, the tets' part of the PD matrix [mN/mm]: see `Part`."""
        weights = volume_share * self.parameters[:, VOLUME // LANES]
        for strain, _, high in _STRAIN_ROWS:
            weights = weights + _share(self.parameters[:, high], volume_share) * self.parameters[:, strain]
        _, gradients = shape_gradients(scene, self.tets)
        local = np.einsum("e,eai,ebi->eab", weights.ravel()[: len(self.tets)], gradients, gradients)
        corners = scene.tets[self.tets]
        return np.repeat(corners, 4, axis=1).ravel(), np.tile(corners, (1, 4)).ravel(), local.ravel()

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """Return the corners (k, 4) of all rows."""
        return (scene.tets[self.tets],)

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs of corners (k, 2), ten per row."""
        return scene.tets[self.tets][:, PAIRS].reshape(-1, 2)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian; see `Part`. Of Strain's weight no eigenvalue of dP/dF is below the share `least`."""
        parameters, corners = (a.reshape(len(a), -1) for a in (self.parameters, self.corners))
        slots = slots.reshape(-1, len(PAIRS))
        add_tet_tangent(parameters, corners, self.kinds, len(self.tets), slots, least, u, blocks)


def shape_gradients(scene: Scene, tets: Ints) -> tuple[Floats, Floats]:
    """Return Dm_inv [1/mm] of tets, shape (k, 3, 3), and the gradients G of their shape functions, (k, 4, 3)."""
    corners = scene.vertices[scene.tets[tets]]
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    inverse = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)  # far faster than linalg.inv
    inverse /= np.sum(a * inverse[:, 0], axis=1)[:, None, None]
    return inverse, np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def _pair_up(scene: Scene) -> tuple[Ints, tuple[_Places, ...]]:
    """Make one row per tet, or more where it has many terms: the rows' tets, and where each term stands.

    The first two Strains and the first Volume of a tet share a row, for they share F and its stretches; so do the next.
    """
    keys, slots = [], []
    for kind, room in ((Strain, len(_STRAIN_ROWS)), (Volume, 1)):
        count = np.zeros(len(scene.tets), dtype=np.int64)
        for term in scene.of(kind):
            tets = scene.tets_of(term)
            keys.append(tets + len(scene.tets) * (count[tets] // room))
            slots.append(count[tets] % room)
            count[tets] += 1
    rows = np.unique(np.concatenate(keys)) if keys else np.zeros(0, dtype=np.int64)
    places = (_Places(np.searchsorted(rows, key), slot) for key, slot in zip(keys, slots, strict=True))
    return rows % max(len(scene.tets), 1), tuple(places)


def _spread(values, row: int | Ints, rows: Ints, blocks: np.ndarray):
    """Write one value per row of `_pair_up` to the row, or to one row each, of the blocks."""
    blocks[rows // LANES, row, rows % LANES] = values


def _kinds_of(parameters: Floats) -> np.ndarray:
    """Tell what each block asks for, by its parameters (blocks, PARAMETERS, LANES): see `local_step`."""
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
