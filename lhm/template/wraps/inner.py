"""Muscle and skull wrap under a skin wrap: made valid by climbing and, where that is stuck, by thinner columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu

from ...base.errors import FitError
from ...base.geometry.bvh import TriangleTree
from ...base.geometry.topology import graph_laplacian
from ...base.kernels import njit
from ...base.mesh import Floats, Ints, unit
from ...head.columns import Columns
from . import climb
from .climb import ClimbPolicy


@dataclass(frozen=True)
class LayersPolicy:
    """Constants of valid layers."""

    least_sine: float = 0.04  # of a dihedral angle, 2.3 degrees: a tet below it is a defect
    least_length: float = 0.5  # [mm] of a column
    slope: float = 0.8  # of an edge of the skin wrap, by which a column may be longer than its neighbour
    least_cosine: float = 0.3  # between a direction inward and the normals around it
    crease_rounds: int = 40  # of smoothing
    rounds: int = 24  # of climbing and shortening
    climb: ClimbPolicy = climb.POLICY
    finish: ClimbPolicy | None = None  # one more climb where all is valid


POLICY = LayersPolicy()
"""The constants as they were measured."""


@njit(cache=True)
def _cones(normals, faces, owner, first, rounds):
    n = len(normals)
    least = np.empty(n)
    for v in range(n):
        for step in range(rounds + 1):
            worst, which = 2.0, 0
            for k in range(first[v], first[v + 1]):
                f = owner[k]
                cosine = normals[v, 0] * faces[f, 0] + normals[v, 1] * faces[f, 1] + normals[v, 2] * faces[f, 2]
                if cosine < worst:
                    worst, which = cosine, f
            least[v] = worst
            if worst >= 0.7 or step == rounds:
                break
            pull, size = 0.6 / (1 + 0.2 * step), 0.0
            for c in range(3):
                normals[v, c] += pull * faces[which, c]
                size += normals[v, c] ** 2
            for c in range(3):
                normals[v, c] /= max(np.sqrt(size), 1e-30)
    return normals, least


CONE_ROUNDS = 60


def cone_normals(columns: Columns, wrap: Floats) -> tuple[Floats, Floats]:
    """Unit vectors (n, 3) at an acute angle to the normals of all incident triangles where that can be.

    Starting at the vertex normal, the normal of the worst incident triangle is added again and again. Also the
    smallest cosine that is left, shape (n,): negative where no direction enters all triangles of a vertex.
    """
    surface = columns.surface(wrap)
    faces = unit(surface.face_normals)
    return _cones(surface.vertex_normals, faces, columns.owner, columns.first, CONE_ROUNDS)


def smooth_creases(columns: Columns, wrap: Floats, policy: LayersPolicy = POLICY) -> Floats:
    """A wrap (n, 3) [mm] whose crossings with itself and sharpest creases are smoothed away.

    Vertices of crossing triangles, and those from which no direction enters all their triangles at an angle whose
    sine is `policy.least_cosine`, move half a Laplacian step with their neighbours. Columns with twins are made
    symmetric. Raises FitError for crossings that are left after `policy.crease_rounds`.
    """
    wrap = columns.symmetrise(wrap)
    for _ in range(policy.crease_rounds):
        crossing = TriangleTree(wrap, columns.triangles).self_crossings()
        hit = (cone_normals(columns, wrap)[1] < policy.least_cosine).astype(float)
        hit[columns.triangles[crossing].ravel()] = 1.0
        if not hit.any():
            return wrap
        moved = np.maximum(hit, columns.edges @ hit > 0)[:, None] * 0.5
        wrap = columns.symmetrise(wrap + moved * (columns.mean @ wrap - wrap))
    crossing = TriangleTree(wrap, columns.triangles).self_crossings()
    if len(crossing):
        raise FitError(f"skin wrap: {len(crossing)} pairs of triangles cross, the first is {crossing[0].tolist()}")
    return wrap


def smooth(columns: Columns, values: Floats, amount: float) -> Floats:
    """Solve (1 + amount L) y = values with the graph Laplacian L: implicit smoothing of a field on the wrap."""
    return splu((identity(columns.n) + amount * graph_laplacian(columns.edges)).tocsc()).solve(values)


@njit(cache=True, error_model="numpy")
def sines(stack, tets):
    """The smallest signed sine of each tet's dihedral angles, shape (m,)."""
    smallest = np.empty(len(tets))
    for t in range(len(tets)):
        smallest[t] = climb.smallest_sine(stack, tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3])
    return smallest


@dataclass
class Crossings:
    """Looks for crossings of the stacked wraps of one head again and again; the trees are laid out once."""

    columns: Columns
    skin: TriangleTree
    skull: TriangleTree

    @classmethod
    def from_wraps(cls, columns: Columns, stack: Floats) -> Crossings:
        """For a head that starts with these wraps (3 n, 3) [mm]."""
        n = columns.n
        return cls(columns, *(TriangleTree(x, columns.triangles) for x in (stack[:n], stack[2 * n :])))

    def find(self, stack: Floats) -> tuple[Ints, Ints]:
        """Pairs of triangles in which the skin wrap crosses itself, and in which the skull wrap crosses any, (k, 2).

        Tets that are all positive between two wraps that neither cross themselves nor each other fill the space
        between them once, so the muscle wrap in their midst crosses nothing either.
        """
        n = self.columns.n
        skin, skull = self.skin.moved(stack[:n]), self.skull.moved(stack[2 * n :])
        return skin.self_crossings(), np.vstack([skull.self_crossings(), skin.crossings(skull)])


def make_valid(columns: Columns, stack: Floats, policy: LayersPolicy = POLICY) -> Floats:
    """Wraps (3 n, 3) [mm], skin, muscle, skull, without crossing and inverted tet, close to those given.

    Worst tets are shaped by climbing. Columns of a defect that is left are shortened and, with their neighbours',
    turned towards the inward normal; where that goes on, or the skin wrap crosses itself, that is smoothed there too.
    Columns with twins are made symmetric. Raises FitError naming what is left after `policy.rounds`.
    """
    n = columns.n
    stack = columns.symmetrise(stack)
    skin = smooth_creases(columns, stack[:n], policy)
    stack = stack + np.tile(skin - stack[:n], (3, 1))
    search = Crossings.from_wraps(columns, stack)
    for number in range(policy.rounds):
        stack = climb.improve(columns, stack, least=policy.least_length, policy=policy.climb)
        hit, skin_crosses = _find_defects(columns, stack, search, policy)
        if not len(hit):
            return _finish(columns, stack, search, policy)
        if number < policy.rounds - 1:
            thinner = _thinner(columns, stack, hit, policy, smooth=number >= 4 or skin_crosses)
            stack = columns.symmetrise(thinner)
    inverted = int((sines(stack, columns.tets) <= 0).sum())
    crossing = sum(map(len, search.find(stack)))
    if inverted or crossing:
        raise FitError(f"layers: {inverted} tets are flat or inverted, {crossing} pairs of triangles cross")
    return stack


def _finish(columns: Columns, stack: Floats, search: Crossings, policy: LayersPolicy) -> Floats:
    """Climb once more, by `policy.finish`; columns where that makes a defect stay, with their neighbours."""
    if policy.finish is None:
        return stack
    finished = climb.improve(columns, stack, least=policy.least_length, policy=policy.finish)
    kept = np.zeros(columns.n, dtype=bool)
    for _ in range(policy.rounds):
        hit, _ = _find_defects(columns, finished, search, policy)
        if not len(hit):
            return finished
        kept[hit] = True
        kept |= columns.edges @ kept > 0
        if columns.twins is not None:
            kept |= kept[columns.twins]
        finished = np.where(np.tile(kept, 3)[:, None], stack, finished)
    return stack


def _find_defects(columns: Columns, stack: Floats, search: Crossings, policy: LayersPolicy) -> tuple[Ints, bool]:
    """Return the columns of flat tets or, where there are none, of crossing triangles; and whether the skin's cross."""
    bad = columns.tets[sines(stack, columns.tets) < policy.least_sine]
    skin_pairs, pairs = (np.zeros((0, 2), np.int64),) * 2 if len(bad) else search.find(stack)
    hit = [bad.ravel() % columns.n, columns.triangles[skin_pairs].ravel(), columns.triangles[pairs].ravel()]
    return np.unique(np.concatenate(hit)), len(skin_pairs) > 0


def _thinner(columns: Columns, stack: Floats, hit: Ints, policy: LayersPolicy, *, smooth: bool) -> Floats:
    n = columns.n
    skin, muscle, skull = stack[:n], stack[n : 2 * n], stack[2 * n :]
    chosen = np.zeros(n)
    chosen[hit] = 1.0
    around = columns.edges @ chosen > 0
    if smooth:
        moved = np.maximum(0.5 * chosen, 0.25 * around)[:, None] * (columns.mean @ skin - skin)
        skin, muscle, skull = skin + moved, muscle + moved, skull + moved
    connectors = skull - skin
    length = np.linalg.norm(connectors, axis=1)
    share = np.linalg.norm(muscle - skin, axis=1) / np.maximum(length, 1e-12)
    share = np.clip(share, 0.2, 0.8)[:, None]
    off = muscle - skin - share * connectors
    turned = np.maximum(chosen, 0.5 * around)[:, None]
    direction = connectors / np.maximum(length, 1e-12)[:, None]
    direction = direction - 0.25 * turned * (direction + cone_normals(columns, skin)[0])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    length = np.where(chosen > 0, np.maximum(0.85 * length, np.minimum(length, policy.least_length)), length)
    i, j = columns.edges.nonzero()
    reach = policy.slope * np.linalg.norm(skin[i] - skin[j], axis=1)
    for _ in range(3):
        np.minimum.at(length, i, length[j] + reach)
    connectors = length[:, None] * direction
    return np.vstack([skin, skin + share * connectors + (1 - turned) * off, skin + connectors])
