"""Example-based facial rigging: the 52 shapes of one person from a few scanned expressions (Li, Weise & Pauly 2010).

In turns: the weights of each scan by bounded least squares, then the shapes. These are optimised per face on edges,
minimising over D_i, the edges that shape i adds (their Eq. 5 to 7),

    Σ_k ‖Σ_i w_ki D_i - (E_k - E_0)‖² + β Σ_i r_i ‖D_i - D_i*‖²,    r_i = ((1 + m_i) / (0.1 + m_i))²,

with D_i* the generic shape's and m_i = ‖J_i - I‖ in per cent how much it deforms that face: where a shape leaves the
generic face as it is, it is held a hundred times harder than where it strains it much. One factorisation turns edges
into vertices for all shapes and rounds. Unlike the paper's, m_i is a strain, so nothing depends on the mesh's unit or
resolution, and weights are drawn to their start in proportion to what each shape moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from ..base.checks import finite
from ..base.errors import InputError, MeshError
from ..base.geometry.deformation import DeformationTransfer, check_areas, deformation_gradients
from ..base.mesh import Floats, Ints, Surface
from ..identities.arkit import ARKIT, check_weights
from ..identities.transfer import HELD, Anchors, check_deltas


@dataclass(frozen=True)
class RiggingPolicy:
    """Rounds, and what holds shapes and weights in the first of them and the last; it falls by equal ratios between."""

    rounds: int = 10
    shape_trust: tuple[float, float] = (0.5, 0.1)  # β
    weight_trust: tuple[float, float] = (1.0, 0.1)  # draws to the start, in shares of a shape's mean square motion
    faces_at_once: int = 2048


POLICY = RiggingPolicy()
"""The constants as they were measured."""


@dataclass(frozen=True, eq=False)
class PersonalRig:
    """One person's shapes `deltas` [mm], shape (52, n, 3), and the examples' weights, shape (k, 52), in [0, 1].

    `history` [mm], shape (rounds + 1,): root mean square distance between examples and rig, first of the generic shapes
    with weights fitted to them, then after each round.
    """

    deltas: Floats
    weights: Floats
    history: Floats


def personalise(neutral: Surface, deltas, examples, weights, *, rounds: int = POLICY.rounds) -> PersonalRig:
    """Fit the shapes to scanned expressions of one person.

    neutral: that person's neutral skin [mm]. deltas: generic shapes on it, such as `transfer_expressions` gives [mm],
    shape (52, n, 3). examples: vertices of k scans of the same triangles, aligned to the neutral at rest [mm], shape
    (k, n, 3). weights: a guess of the expression in each, shape (k, 52), in [0, 1] (clipped with a warning); a shape
    that is 0 in all of them is not used, and stays as it is. Raises MeshError or InputError for other shapes, values
    that are not finite, weights that are all zero, triangles without area, and no round.
    """
    generic = check_deltas("deltas", deltas, neutral)
    check_areas("neutral", neutral.vertices, neutral.triangles)
    values = finite("examples", examples, (None, *neutral.vertices.shape), error=MeshError)
    if not len(values):
        raise MeshError("examples: there is none")
    motions = values - neutral.vertices
    start = np.atleast_2d(check_weights(weights))
    if len(start) != len(motions):
        raise InputError(f"weights: {len(start)} rows for {len(motions)} examples")
    if not start.any():
        raise InputError("weights: all are zero, so no example shows any of the 52 expressions")
    if rounds < 1:
        raise InputError(f"rounds: {rounds}, expected 1 or more")

    edges = _Edges.from_motions(neutral, generic, motions)
    anchors = Anchors.from_shapes(generic, neutral.triangles)
    system = DeformationTransfer(neutral, anchors.held, weight=HELD)
    areas = neutral.vertex_areas / neutral.vertex_areas.sum()
    shapes, history = generic, list[float]()
    for beta, gamma in zip(
        np.geomspace(*POLICY.shape_trust, rounds), np.geomspace(*POLICY.weight_trust, rounds), strict=True
    ):
        fitted = _fit_weights(shapes, motions, start, areas, gamma)
        if not history:
            history.append(_distance(shapes, motions, fitted))
        correction = system.displacements(edges.corrections(fitted, beta))
        shapes = generic + anchors.settle(np.ascontiguousarray(correction), np.zeros_like(generic))
        history.append(_distance(shapes, motions, fitted))
    return PersonalRig(shapes, fitted, np.array(history))


@dataclass(frozen=True, eq=False)
class _Edges:
    """Changes of each face's edges [mm] by examples (k, m, 6) and generic shapes (52, m, 6), and r_i, shape (52, m)."""

    examples: Floats
    generic: Floats
    hold: Floats

    @classmethod
    def from_motions(cls, neutral: Surface, generic: Floats, motions: Floats) -> _Edges:
        hold = np.empty((len(generic), len(neutral.triangles)))
        for shape, delta in enumerate(generic):
            jacobians = deformation_gradients(neutral.vertices, neutral.vertices + delta, neutral.triangles)
            strain = np.linalg.norm(jacobians - np.eye(3), axis=(1, 2)) / 0.01  # per cent
            hold[shape] = ((1.0 + strain) / (0.1 + strain)) ** 2
        return cls(_edges(motions, neutral.triangles), _edges(generic, neutral.triangles), hold)

    def corrections(self, weights: Floats, beta: float) -> Floats:
        """D - D* of all shapes and faces [mm], shape (52, m, 2, 3), by k equations per face (Woodbury's identity)."""
        out = np.empty_like(self.generic)
        pairs = (weights[:, None] * weights[None]).reshape(-1, len(ARKIT))
        for first in range(0, self.generic.shape[1], POLICY.faces_at_once):
            faces = slice(first, first + POLICY.faces_at_once)
            loose = 1.0 / (beta * self.hold[:, faces])
            matrix = (pairs @ loose).T.reshape(-1, len(weights), len(weights)) + np.eye(len(weights))
            missing = self.examples[:, faces] - np.tensordot(weights, self.generic[:, faces], axes=1)
            forces = np.linalg.solve(matrix, missing.transpose(1, 0, 2)).transpose(1, 0, 2)
            out[:, faces] = loose[:, :, None] * np.tensordot(weights.T, forces, axes=1)
        return out.reshape(len(ARKIT), -1, 2, 3)


def _edges(motions: Floats, triangles: Ints) -> Floats:
    corners = motions[:, triangles]
    return (corners[:, :, 1:] - corners[:, :, :1]).reshape(len(motions), -1, 6)


def _fit_weights(shapes: Floats, motions: Floats, start: Floats, areas: Floats, gamma: float) -> Floats:
    """Weights in [0, 1] of each example, shape (k, 52), drawn to `start`; unused shapes keep weight 0."""
    used = np.flatnonzero(start.any(axis=0))
    fitted = np.zeros_like(start)
    basis = (shapes[used] * np.sqrt(areas)[:, None]).reshape(len(used), -1)
    gram = basis @ basis.T
    squares = gram.diagonal()
    trust = gamma * np.where(squares > 0.0, squares, 1.0)
    factor = np.linalg.cholesky(gram + np.diag(trust))
    for example, motion in enumerate(motions):
        right = basis @ (motion * np.sqrt(areas)[:, None]).ravel() + trust * start[example, used]
        reduced = solve_triangular(factor, right, lower=True)
        fitted[example, used] = np.clip(lsq_linear(factor.T, reduced, bounds=(0.0, 1.0), method="bvls").x, 0.0, 1.0)
    return fitted


def _distance(shapes: Floats, motions: Floats, weights: Floats) -> float:
    difference = motions - np.tensordot(weights, shapes, axes=1)
    return float(np.sqrt((difference**2).sum(axis=2).mean()))
