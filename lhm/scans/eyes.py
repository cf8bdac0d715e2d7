"""The eyes of a skin, open, solid, closed or unclear; lids that are one surface stay still."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import dijkstra

from ..arkit import ARKIT
from ..base.geometry.cholesky import factorise
from ..base.geometry.topology import neighbours
from ..base.mesh import Floats, Ints, Surface
from ..identities.space import OUTSIDE, LinearSpace
from ..registration.alignment import Target, fit_similarity
from ..rig import Rig
from ..wraps.columns import edge_graph, unit
from ..wraps.landmarks import Mask, distance_to

State = Literal["open", "solid", "closed", "unclear"]
SIDES = ("Left", "Right")
AROUND, CLOSE = 16.0, 7.0
"""[mm] of the template's lids: what is laid on the skin, and what is compared."""
LIMITS = np.geomspace(6.0, 2.0, 10)
FAR = 3.0
"""[mm] Farther points count as this far."""
CLOSED = 0.9
"""Lids of the template that fit an eye so much better drawn down than open, in shares of the distance: it is closed."""
DRAWN = (0.5, 0.75, 1.0)
"""Weights of the blinks tried: closed lids of a scan meet higher or lower than the template's."""
DIRECT = 1.45
"""A way from lid to lid of up to so many times the straight distance leads across the eye; around it is pi / 2."""
EDGE, LAID = 3.0, 82.0
"""So near their rims [mm] the template's lids are turned from a solid eye's skin by less than this on average
[degrees]: 68 to 70 on a bust with lids cut to an edge, 93 to 102 where other folds were taken for lids."""
STILL: tuple[State, ...] = ("closed", "unclear")
LIDS = ("eyeBlink", "eyeWide", "eyeLookUp", "eyeLookDown", "eyeLookIn", "eyeLookOut")
"""What moves lids only; lids that are closed, or not to be made out, do not."""
_WORDS = {
    "closed": "closed; eyeBlink, eyeWide and eyeLook do nothing to the lids",
    "solid": "solid, one surface with the lids; eyeBlink draws the lids over it",
    "unclear": "one surface on which the template's lids are not made out; eyeBlink, eyeWide and eyeLook do nothing",
}
REACH = 8.0
"""[mm] From the template's lid rims: its lids part or meet there, where this skin is one piece."""
LEAST = 0.1
"""[mm] Shorter edges count as this long."""


@dataclass(frozen=True)
class Eyes:
    """The states of the left and the right eye, the subject's."""

    left: State
    right: State

    @property
    def still(self) -> dict[str, str]:
        """The expressions that do nothing on lids that stay still, each with the reason."""
        return {
            f"{name}{side}": f"the {side.lower()} eye is {state}: its lids stay as they are"
            for side, state in zip(SIDES, (self.left, self.right), strict=True)
            for name in LIDS
            if state in STILL and f"{name}{side}" in ARKIT
        }

    def still_rims(self, template: Surface, parts: Ints, lids: Ints) -> Ints:
        """Find those of the template's `lids` vertices that are of eyes that stay still."""
        sides = zip(_by_side(template, parts, lids), (self.left, self.right), strict=True)
        return np.concatenate([rim if state in STILL else rim[:0] for rim, state in sides])

    def told(self) -> str:
        """Describe them in a line; empty for open eyes."""
        if self.left == self.right:
            return "" if self.left == "open" else f"eyes: {_WORDS[self.left]}"
        both = (("left", self.left), ("right", self.right))
        return "; ".join(f"{side} eye: {_WORDS[state]}" for side, state in both if state != "open")


def classify_eyes(
    space: LinearSpace, template: Surface, parts: Ints, lids: Ints, registered: Surface, skin: Surface
) -> Eyes:
    """Tell the states of a skin's eyes, on which the registered template (n vertices) [mm] lies.

    `space`: whose expressions the template has; `lids`: the vertices of its lids' rims.
    """
    target = Target(skin)
    states: list[State] = []
    for side, rim in zip(SIDES, _by_side(template, parts, lids), strict=True):
        away = distance_to(template.vertices, template.vertices[rim])
        visible = parts == OUTSIDE
        blink = space.expressions[ARKIT.index(f"eyeBlink{side}")]
        opened, *drawn = (
            _misfit(template, weight * blink, registered.vertices, visible & (away < AROUND), away < CLOSE, target)
            for weight in (0.0, *DRAWN)
        )
        if min(drawn) < CLOSED * opened:
            states.append("closed")
        elif _way(template, rim, registered, skin) >= DIRECT:
            states.append("open")
        else:
            turned = _turned(registered, visible & (away < EDGE), target)
            states.append("solid" if turned < LAID else "unclear")
    return Eyes(*states)


def _by_side(template: Surface, parts: Ints, lids: Ints) -> tuple[Ints, Ints]:
    """The vertices of the left and of the right eye's lids, the subject's."""
    left = template.vertices[lids, 0] > np.median(template.vertices[parts == OUTSIDE, 0])
    return lids[left], lids[~left]


def _misfit(template: Surface, delta: Floats, registered: Floats, patch, close, target: Target) -> float:
    """Mean distance [mm] of the template's lids, moved by `delta` and laid rigidly, to the skin."""
    shape = template.with_vertices(template.vertices + delta)
    x, normals = shape.vertices[patch], shape.vertex_normals[patch]
    motion = fit_similarity(template.vertices[patch], registered[patch])
    for limit in LIMITS:
        closest, distance, weight = target.match(motion(x), normals @ motion.rotation.T, reach=limit)
        used = (weight > 0) & (distance < limit)
        if used.sum() < 10:
            return FAR
        motion = fit_similarity(x[used], closest[used])
    _, distance, weight = target.match(motion(x), normals @ motion.rotation.T, reach=FAR)
    off = np.where(weight > 0, np.minimum(distance, FAR), FAR)
    return float(off[close[patch]].mean())


def _turned(registered: Surface, edge: Mask, target: Target) -> float:
    """The mean angle [degrees] between the registered lids at their edge and the skin there."""
    triangle, shares, _ = target.tree.closest(registered.vertices[edge])
    there = unit(np.einsum("kc,kcd->kd", shares, target.normals[target.skin.triangles[triangle]]))
    cosine = np.einsum("kd,kd->k", there, registered.vertex_normals[edge])
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean())


def _way(template: Surface, rim: Ints, registered: Surface, skin: Surface) -> float:
    """The shortest way over the skin from the middle of the upper lid to that of the lower, over the straight one."""
    x = template.vertices[rim]
    centre = 0.5 * (x.min(axis=0) + x.max(axis=0))
    order = np.argsort(np.abs(x[:, 0] - centre[0]), kind="stable")
    above = x[order, 1] > centre[1]
    ends = registered.vertices[[rim[order[above][0]], rim[order[~above][0]]]]
    up = ends[0] - ends[1]
    # A little away from the rims, on the lids themselves.
    places = np.stack([ends[0] + 0.25 * up, ends[1] - 0.25 * up])
    near = np.linalg.norm(skin.vertices - places.mean(axis=0), axis=1) < 2.5 * np.ptp(x[:, 0])
    triangles = skin.triangles[near[skin.triangles].all(axis=1)]
    if not len(triangles):
        return np.inf
    used = np.unique(triangles)
    start, end = (used[np.linalg.norm(skin.vertices[used] - place, axis=1).argmin()] for place in places)
    straight = np.linalg.norm(skin.vertices[start] - skin.vertices[end])
    ways = dijkstra(edge_graph(skin.vertices, triangles), directed=False, indices=start)
    return float(ways[end] / max(straight, 1e-9))


def calm_lids(rig: Rig, skin: Surface, rims: Floats, own: Collection[str]) -> Rig:
    """Let the skin near the registered rims (k, 3) [mm] of lids that stay still go with what is around it.

    Displacements there are those of least squared Laplacian, so that no expression draws one lid over the other; the
    expressions in `own` stay as they are.
    """
    x, edges = skin.vertices, neighbours(skin.triangles, len(skin.vertices)).tocoo()
    used = np.bincount(edges.row, minlength=len(x)) > 0
    inside = (distance_to(x, rims) < REACH) & used
    if not inside.any() or inside[used].all():
        return rig
    # By their lengths, so that short edges take no more of a stretch than long ones.
    length = np.linalg.norm(x[edges.row] - x[edges.col], axis=1)
    weights = csr_matrix((1.0 / np.maximum(length, LEAST), (edges.row, edges.col)), shape=edges.shape)
    total = np.maximum(np.asarray(weights.sum(axis=1)).ravel(), 1e-12)
    laplacian = (diags(used.astype(float)) - diags(1.0 / total) @ weights).tocsr()
    rows = np.asarray(abs(laplacian[:, inside]).sum(axis=1)).ravel() > 0
    free = laplacian[rows][:, inside]
    # A piece that lies wholly inside has nothing to go along with.
    solve = factorise((free.T @ free + 1e-9 * diags(np.ones(int(inside.sum())))).tocsc())
    moved = [k for k, name in enumerate(ARKIT) if name not in own and np.abs(rig.deltas[k][inside]).max() > 0]
    deltas = np.array(rig.deltas)
    around = laplacian[rows][:, ~inside]
    for k in moved:
        deltas[k, inside] = solve(-(free.T @ (around @ deltas[k, ~inside].astype(np.float64))))
    return replace(rig, deltas=deltas)
