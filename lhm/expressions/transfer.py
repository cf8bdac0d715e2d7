"""Expressions from one neutral head to another of the same triangles by deformation transfer.

Each shape's gradient per face, J_f from the source's neutral to its expression, acts on the target's neutral S; the
target's expression minimises Σ_f A_f ‖∇x - J_f ∇S‖² (Sumner & Popović 2004, section 3; Botsch et al. 2006, section 4).
Vertices that no expression moves are held; one factorisation serves all shapes at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arkit import ARKIT
from ..base.checks import check_arguments
from ..base.errors import MeshError
from ..base.geometry.deformation import DeformationTransfer, check_areas, deformation_gradients
from ..base.geometry.topology import connected_parts
from ..base.mesh import Floats, Ints, Surface

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
    def of(cls, deltas: Floats, triangles: Ints) -> Anchors:
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


@check_arguments
def transfer_expressions(source_neutral: Surface, source_deltas, target: Surface) -> Floats:
    """The displacements [mm] of the target's 52 expressions, shape (52, n, 3).

    source_neutral, target: neutral skins [mm] with the same triangles, oriented alike. source_deltas: what each
    expression adds to the source [mm], shape (52, n, 3), in ARKit's order. A part of which every vertex moves (an
    eyeball) keeps the source's mean motion, scaled by the heads' sizes. As in the papers, only what rests in all shapes
    is held: what a single shape leaves at rest may move by a millimetre, in mouth and eye sockets by two.
    Raises MeshError for other triangles, shapes or values that are not finite, and for a triangle without area in
    either neutral, by its number.
    """
    deltas = check_deltas("source_deltas", source_deltas, source_neutral)
    check_same_triangles("target", target, source_neutral)
    check_areas("source_neutral", source_neutral.vertices, source_neutral.triangles)
    check_areas("target", target.vertices, target.triangles)
    anchors = Anchors.of(deltas, target.triangles)
    system = DeformationTransfer(target, anchors.held, weight=HELD)
    gradients = np.empty((len(deltas), len(target.triangles), 9))
    for shape, delta in enumerate(deltas):
        moved = source_neutral.vertices + delta
        jacobians = deformation_gradients(source_neutral.vertices, moved, target.triangles)
        gradients[shape] = (jacobians - np.eye(3)).reshape(-1, 9)
    motion = system.delta(gradients, np.broadcast_to(target.vertices, deltas.shape))
    return anchors.settle(np.ascontiguousarray(motion), deltas * (_size(target) / _size(source_neutral)))


def check_deltas(name: str, deltas, neutral: Surface) -> Floats:
    """Displacements of the 52 expressions as float64; MeshError unless finite and of shape (52, n, 3)."""
    try:
        values = np.asarray(deltas, dtype=np.float64)
    except (TypeError, ValueError):
        raise MeshError(f"{name}: expected numbers of shape ({len(ARKIT)}, n, 3)") from None
    expected = (len(ARKIT), len(neutral.vertices), 3)
    if values.shape != expected:
        raise MeshError(f"{name}: expected shape {expected}, got {values.shape}")
    bad = np.argwhere(~np.isfinite(values).all(axis=2))
    if len(bad):
        raise MeshError(
            f"{name}: {len(bad)} rows are not finite, the first is vertex {bad[0, 1]} of {ARKIT[bad[0, 0]]}"
        )
    return values


def check_same_triangles(name: str, surface: Surface, other: Surface) -> None:
    """Raise MeshError unless two surfaces have the same vertices' number and the same triangles."""
    if len(surface.vertices) != len(other.vertices):
        raise MeshError(f"{name}: {len(surface.vertices)} vertices, expected the source's {len(other.vertices)}")
    if not np.array_equal(surface.triangles, other.triangles):
        raise MeshError(f"{name}: its triangles are not the source's")


def _size(surface: Surface) -> float:
    """Root mean square distance of the vertices from their mean [mm]."""
    return float(np.sqrt(surface.vertices.var(axis=0).sum()))
