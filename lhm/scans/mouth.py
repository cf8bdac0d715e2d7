"""A mouth that is sealed: noticed, and opened between its lips with a pocket behind them, as the template's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ..base.errors import MeshError
from ..base.mesh import Floats, Ints, Surface
from ..identities.space import MOUTH
from ..registration.registration import Registration
from ..wraps.columns import fill_harmonically, neighbours
from ..wraps.landmarks import Mask
from .lips import LipLine, chain_shares, find_lip_line, lips_of_vertices, tie_lips
from .slit import Slit, cut_slit

BESIDE, HIGH, BEHIND, BEFORE = 8.0, 12.0, 15.0, 35.0
"""[mm] The mouth's zone: beyond the corners, above and below the line, behind the corners and before them."""
BAND = (2.0, 6.0)
"""[mm] Lips, as heights over the line."""
ACROSS = 1.8
"""Up to so many times the straight distance, the shortest way over the skin from lip to lip leads across the line."""
CORNERS = (0.6, 0.9)
"""Shares of the mouth's half width between which lips are told apart ever less by the template, and more by height."""
SHARES = (1.0, 0.5, 0.0)
"""Of the way from the template's line to the furrow, tried in turns: lips may be too ragged to be followed."""
GAP, INSIDE, FADES = 0.5, 1.5, 15.0
"""[mm] Between the registered lips; how far behind the cut the pocket begins; how far around the rim the registered
template follows when that is moved to the cut."""


@dataclass(frozen=True, eq=False)
class OpenedMouth:
    """A skin whose mouth was opened, and the registration on it.

    Its vertices are the given ones, those of the cut, and the pocket's, which are the template's vertices `pocket`.
    """

    skin: Surface
    laid: Registration
    slit: Slit = field(repr=False)
    pocket: Ints = field(repr=False)
    before: Registration = field(repr=False)

    def carried(self, own: Mapping[str, Floats]) -> dict[str, Floats]:
        """Displacements [mm] of the given skin, for this one; the pocket follows what lies around it."""
        to_pocket = self.before.template_weights[self.pocket]
        return {name: np.vstack([self.slit.on(delta), to_pocket @ delta]) for name, delta in own.items()}


def is_sealed(line: LipLine, skin: Surface) -> bool:
    """Whether the skin goes on from lip to lip: most shortest ways between them, off the corners, are near straight.

    Of lips that are sealed deep between them it says nothing.
    """
    return bool(np.median(ways_across(line, skin)) < ACROSS)


def ways_across(line: LipLine, skin: Surface) -> Floats:
    """Shortest ways over the skin between the lips over their straight distance, at places off the corners; inf: none.

    Where the skin has no vertices on one of the lips there is no way.
    """
    local, above = line.local(skin.vertices), line.above(skin.vertices)
    near = _zone(line, local, above)
    ids = np.flatnonzero(near)
    number = np.full(len(near), -1)
    number[ids] = np.arange(len(ids))
    sides = number[skin.triangles[near[skin.triangles].all(axis=1)][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    if not len(sides):
        return np.array([np.inf])
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    x = skin.vertices[ids]
    graph = csr_matrix((np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1), edges.T), shape=(len(ids),) * 2)
    # Of the lips themselves, not of the lining behind them: what is seen from the front.
    front = (skin.vertex_normals[ids] @ line.axes[2]) > 0
    found = []
    for place in line.along[-1] * np.linspace(-0.4, 0.4, 5):
        beside = front & (np.abs(local[ids, 0] - place) < max(2.0, 2 * _edge(skin, near)))
        upper = np.flatnonzero(beside & (above[ids] > BAND[0]) & (above[ids] < BAND[1]))
        lower = np.flatnonzero(beside & (above[ids] < -BAND[0]) & (above[ids] > -BAND[1]))
        if not len(upper) or not len(lower):
            continue
        ways = dijkstra(graph, directed=False, indices=upper)[:, lower]
        straight = np.linalg.norm(x[upper][:, None] - x[lower][None], axis=2)
        found.append(float((ways / np.maximum(straight, 1e-9)).min()))
    return np.array(found or [np.inf])


def open_mouth(template: Surface, parts: Ints, laid: Registration, skin: Surface) -> OpenedMouth:
    """The skin with its sealed mouth opened, and the registration on it; MeshError, saying why, if it cannot be cut."""
    furrow = find_lip_line(template, parts, laid.surface, skin)
    if not is_sealed(furrow, skin):
        line = find_lip_line(template, parts, laid.surface, skin, share=0.0)
        return cut_mouth(template, parts, laid, skin, line, _over_membrane(template, parts, laid, skin, line))
    for share in SHARES:
        try:
            line = find_lip_line(template, parts, laid.surface, skin, share=share)
            return cut_mouth(template, parts, laid, skin, line, line.above(skin.vertices))
        except MeshError as error:
            failed = error
    raise failed


def _over_membrane(template: Surface, parts: Ints, laid: Registration, skin: Surface, line: LipLine) -> Floats:
    """What changes its sign (n,) between the lips, however these overlap: on which of them the template's points lie.

    Where they lie on neither, and towards the corners, the height over the line decides.
    """
    side = laid.skin_weights @ lips_of_vertices(template, parts, line)
    aside = np.abs(line.local(skin.vertices)[:, 0]) / line.along[-1]
    height = np.clip(line.above(skin.vertices) / BAND[0], -1.0, 1.0)
    share = np.where(np.abs(side) > 1e-9, np.clip((CORNERS[1] - aside) / (CORNERS[1] - CORNERS[0]), 0.0, 1.0), 0.0)
    return share * side + (1 - share) * height


def cut_mouth(
    template: Surface, parts: Ints, laid: Registration, skin: Surface, line: LipLine, above: Floats
) -> OpenedMouth:
    """The skin cut where `above` (n,) changes its sign, with the template's lining sewn in behind.

    MeshError where it cannot be cut.
    """
    local = line.local(skin.vertices)
    near = _zone(line, local, line.above(skin.vertices))
    allowed = near[skin.triangles].all(axis=1)
    ends = (float(line.along[0]), float(line.along[-1]))
    cut = cut_slit(skin.triangles, above, local[:, 0], ends, allowed, skin.vertices)
    x = cut.on(skin.vertices)
    moved = _rims_moved(template, line, laid.surface.vertices, x, cut)
    laid = replace(laid, surface=laid.surface.with_vertices(moved))
    lining = template.triangles[(parts[template.triangles] == MOUTH).any(axis=1)]
    pocket = np.unique(lining)
    inner = moved.copy()
    inner[np.union1d(line.upper, line.lower)] -= INSIDE * line.axes[2]
    number = np.full(len(parts), -1)
    number[pocket] = len(x) + np.arange(len(pocket))
    vertices = np.vstack([x, inner[pocket]])
    strips = [
        _strip(side, number[chain], line.local(vertices), cut.triangles)
        for side, chain in ((cut.upper, line.upper), (cut.lower, line.lower))
    ]
    whole = Surface(vertices, np.vstack([cut.triangles, number[lining], *strips]))
    tied = tie_lips(template, parts, laid, line, skin, whole, cut, pocket, near, above)
    return OpenedMouth(whole, tied, cut, pocket, laid)


def _zone(line: LipLine, local: Floats, above: Floats) -> Mask:
    beside = np.abs(local[:, 0]) < line.along[-1] + BESIDE
    return beside & (np.abs(above) < HIGH) & (local[:, 2] > -BEHIND) & (local[:, 2] < BEFORE)


def _edge(skin: Surface, near: Mask) -> float:
    """The median length [mm] of the edges in a zone."""
    triangles = skin.triangles[near[skin.triangles].all(axis=1)]
    return float(np.median(np.linalg.norm(skin.vertices[triangles[:, 0]] - skin.vertices[triangles[:, 1]], axis=1)))


def _rims_moved(template: Surface, line: LipLine, x: Floats, skin: Floats, cut: Slit) -> Floats:
    """The registered template (n, 3) with the rims of its lips at the cut, half a gap apart; harmonic around them."""
    shift = np.zeros_like(x)
    for sign, chain, side in ((1, line.upper, cut.upper), (-1, line.lower, cut.lower)):
        share, at = chain_shares(line.local(x[chain])[:, 0]), chain_shares(line.local(skin[side])[:, 0])
        goal = np.stack([np.interp(share, at, skin[side, c]) for c in range(3)], axis=1)
        inner = np.minimum(share, 1 - share) > 0
        goal += 0.5 * sign * GAP * inner[:, None] * line.axes[1]
        shift[chain] = goal - x[chain]
    rim = np.union1d(line.upper, line.lower)
    edges = neighbours(template.triangles, len(x))
    pairs = edges.tocoo()
    gaps = np.linalg.norm(template.vertices[pairs.row] - template.vertices[pairs.col], axis=1)
    graph = csr_matrix((gaps, (pairs.row, pairs.col)), shape=edges.shape)
    free = dijkstra(graph, directed=False, indices=rim, min_only=True) < FADES
    free[rim] = False
    return x + fill_harmonically(template.triangles, shift, ~free)


def _strip(outer: Ints, inner: Ints, local: Floats, triangles: Ints) -> Ints:
    """Triangles between two chains of vertices that run side by side, oriented against the outer one's own."""
    a, b = chain_shares(local[outer, 0]), chain_shares(local[inner, 0])
    i = j = 0
    found = []
    while i < len(outer) - 1 or j < len(inner) - 1:
        if j == len(inner) - 1 or (i < len(outer) - 1 and a[i + 1] <= b[j + 1]):
            found.append([outer[i], outer[i + 1], inner[j]])
            i += 1
        else:
            found.append([outer[i], inner[j + 1], inner[j]])
            j += 1
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    same = (edges == outer[:2]).all(axis=1).any()
    return np.array(found)[:, ::-1] if same else np.array(found)
