"""An open surface closed by a fan over each opening, for what needs an inside."""

from __future__ import annotations

import numpy as np

from ..errors import MeshError
from ..mesh import Ints, Surface


def closed(surface: Surface) -> Surface:
    """The surface with its openings closed; its own vertices come first, one more for each opening follows.

    Raises MeshError for edges with more than two triangles, and for neighbours oriented against one another.
    """
    loops = openings(surface.triangles)
    if not loops:
        return surface
    first = len(surface.vertices)
    centres = np.array([surface.vertices[loop].mean(axis=0) for loop in loops])
    fans = [np.stack([np.roll(loop, -1), loop, np.full(len(loop), first + k)], axis=1) for k, loop in enumerate(loops)]
    return Surface(np.vstack([surface.vertices, centres]), np.vstack([surface.triangles, *fans]))


def openings(triangles: Ints) -> list[Ints]:
    """The loops of edges that have one triangle, as vertices in the direction of their triangles, the longest first.

    Where the boundary touches itself at a vertex it is several loops. Raises MeshError for edges with more than two
    triangles, and for neighbours oriented against one another.
    """
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    n = int(triangles.max()) + 1
    forth, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    if len(np.unique(forth)) < len(forth):
        raise MeshError("skin: edges with more than two triangles, or neighbours oriented against one another")
    following: dict[int, list[int]] = {}
    for start, end in edges[~np.isin(forth, back)].tolist():
        following.setdefault(start, []).append(end)
    loops = []
    while following:
        way = [next(iter(following))]
        place = {way[0]: 0}
        # Each vertex has as many edges out as in, so the way ends only where it began.
        while way[-1] in following:
            ends = following[way[-1]]
            end = ends.pop()
            if not ends:
                del following[way[-1]]
            if end in place:
                loops.append(np.array(way[place[end] :]))
                for vertex in way[place[end] + 1 :]:
                    del place[vertex]
                way = way[: place[end] + 1]
            else:
                place[end] = len(way)
                way.append(end)
    return sorted(loops, key=len, reverse=True)
