"""Expressions from one neutral head to another of the same triangles by deformation transfer.

Each shape's gradient per face, J_f from the source's neutral to its expression, acts on the target's neutral S; the
target's expression minimises Σ_f A_f ‖∇x - J_f ∇S‖² (Sumner & Popović 2004, section 3; Botsch et al. 2006, section 4).
Vertices that no expression moves are held; one factorisation serves all shapes at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.checks import finite
from ..base.errors import MeshError
from ..base.geometry.deformation import DeformationTransfer, check_areas, deformation_gradients
from ..base.geometry.topology import connected_parts
from ..base.mesh import Floats, Ints, Surface
from .arkit import ARKIT

STILL = 1e-6
"""Up to here [mm] a vertex counts as not moved."""
HELD = 1e6
"""The anchors' weight: they stay within 1e-6 of what the faces would have moved them."""


@dataclass(frozen=True, eq=False)
class Anchors:
    """The vertices held, and the parts that float: those of which every vertex moves, each held by one vertex."""

    held: Ints
    floating: tuple[Ints, ...]

    @classmethod
    def from_shapes(cls, deltas: Floats, triangles: Ints) -> Anchors:
        """Hold what no shape of deltas [mm], shape (shapes, n, 3), moves; of a floating part its calmest vertex."""
        motion = np.sqrt((deltas**2).sum(axis=2).max(axis=0))
        count, part = connected_parts(triangles, len(motion))
        moving = np.setdiff1d(np.arange(count), part[motion <= STILL])
        floating = tuple(np.flatnonzero(part == number) for number in moving)
        calmest = [members[np.argmin(motion[members])] for members in floating]
        return cls(np.union1d(np.flatnonzero(motion <= STILL), np.array(calmest, dtype=np.int64)), floating)

    def settle(self, motion: Floats, means_of: Floats) -> Floats:
        """Shift the floating parts of a motion, shape (shapes, n, 3), to the mean motion [mm] that `means_of` has."""
        for members in self.floating:
            shift = (means_of[:, members] - motion[:, members]).mean(axis=1, keepdims=True)
            motion[:, members] += shift
        return motion


class ExpressionTransfer:
    """A source's 52 expressions, ready for any neutral head of its triangles; one factorisation serves each head.

    neutral: the source's skin [mm]; deltas: what each expression adds to it [mm], shape (52, n, 3), in ARKit's order.
    A part of which every vertex moves (an eyeball) keeps the source's mean motion, scaled by the heads' sizes. As in
    the papers, only what rests in all shapes is held: what a single shape leaves at rest may move by a millimetre, in
    mouth and eye sockets by two. Raises MeshError for other shapes, values that are not finite, and a triangle without
    area.
    """

    def __init__(self, neutral: Surface, deltas):
        self.neutral, self.deltas = neutral, check_deltas("source_deltas", deltas, neutral)
        check_areas("source_neutral", neutral.vertices, neutral.triangles)
        self.anchors = Anchors.from_shapes(self.deltas, neutral.triangles)
        self._gradients = np.empty((len(self.deltas), len(neutral.triangles), 9))
        for shape, delta in enumerate(self.deltas):
            jacobians = deformation_gradients(neutral.vertices, neutral.vertices + delta, neutral.triangles)
            self._gradients[shape] = (jacobians - np.eye(3)).reshape(-1, 9)

    def transfer(self, target: Surface) -> Floats:
        """Find the displacements [mm] of a target's 52 expressions, shape (52, n, 3).

        Raises MeshError for other triangles and for a triangle without area, by its number.
        """
        check_same_triangles("target", target, self.neutral)
        check_areas("target", target.vertices, target.triangles)
        system = DeformationTransfer(target, self.anchors.held, weight=HELD)
        motion = system.delta(self._gradients, np.broadcast_to(target.vertices, self.deltas.shape))
        return self.anchors.settle(np.ascontiguousarray(motion), self.deltas * self.scale(target))

    def scale(self, target: Surface) -> float:
        """Divide the size of a target by the source's."""
        return _size(target) / _size(self.neutral)


def transfer_expressions(source_neutral: Surface, source_deltas, target: Surface) -> Floats:
    """Transfer a source's expressions once; see `ExpressionTransfer` for arguments, limits and errors."""
    check_same_triangles("target", target, source_neutral)
    return ExpressionTransfer(source_neutral, source_deltas).transfer(target)


def check_deltas(name: str, deltas, neutral: Surface) -> Floats:
    """Check displacements of the 52 expressions, as float64; MeshError unless finite, of shape (52, n, 3)."""
    return finite(name, deltas, (len(ARKIT), *neutral.vertices.shape), error=MeshError)


def check_same_triangles(name: str, surface: Surface, other: Surface) -> None:
    """Raise MeshError unless two surfaces have the same vertices' number and the same triangles."""
    if len(surface.vertices) != len(other.vertices):
        raise MeshError(f"{name}: {len(surface.vertices)} vertices, expected the source's {len(other.vertices)}")
    if not np.array_equal(surface.triangles, other.triangles):
        raise MeshError(f"{name}: its triangles are not the source's")


def _size(surface: Surface) -> float:
    """Root mean square distance of the vertices from their mean [mm]."""
    return float(np.sqrt(surface.vertices.var(axis=0).sum()))
