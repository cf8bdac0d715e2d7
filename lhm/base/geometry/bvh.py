"""Bounding-volume trees over triangles and tets: closest points, crossings, containing tets. Compiled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..kernels import njit
from ..mesh import Floats, Ints
from .triangles import closest_on_triangle, parting_shifts, triangles_cross

LEAF = 4
ALL = 2**62
"""More pairs than there can be."""


@njit(cache=True)
def _build(low, high):
    m = len(low)
    centre = 0.5 * (low + high)
    order = np.arange(m)
    start, stop = np.empty(2 * m, np.int64), np.empty(2 * m, np.int64)
    left = np.full(2 * m, -1)
    box = np.empty((2 * m, 6))
    start[0], stop[0], count, node = 0, m, 1, 0
    while node < count:
        inside = order[start[node] : stop[node]]
        for c in range(3):
            box[node, c], box[node, 3 + c] = low[inside, c].min(), high[inside, c].max()
        if len(inside) > LEAF:
            axis = 0
            for c in range(1, 3):
                if box[node, 3 + c] - box[node, c] > box[node, 3 + axis] - box[node, axis]:
                    axis = c
            order[start[node] : stop[node]] = inside[np.argsort(centre[inside, axis])]
            middle = (start[node] + stop[node]) // 2
            left[node] = count
            start[count], stop[count] = start[node], middle
            start[count + 1], stop[count + 1] = middle, stop[node]
            count += 2
        node += 1
    return order, start[:count], stop[:count], left[:count], box[:count]


@njit(cache=True)
def _refit(low, high, order, start, stop, left):
    box = np.empty((len(start), 6))
    # Children are numbered after their parent.
    for node in range(len(start) - 1, -1, -1):
        for c in range(3):
            if left[node] >= 0:
                box[node, c] = min(box[left[node], c], box[left[node] + 1, c])
                box[node, 3 + c] = max(box[left[node], 3 + c], box[left[node] + 1, 3 + c])
            else:
                box[node, c], box[node, 3 + c] = np.inf, -np.inf
                for k in range(start[node], stop[node]):
                    box[node, c] = min(box[node, c], low[order[k], c])
                    box[node, 3 + c] = max(box[node, 3 + c], high[order[k], c])
    return box


@njit(cache=True)
def _box_distance2(box, p):
    total = 0.0
    for c in range(3):
        gap = max(box[c] - p[c], p[c] - box[3 + c], 0.0)
        total += gap * gap
    return total


@njit(cache=True)
def _closest(points, normals, cosine, turned2, most, corners, faces, order, start, stop, left, box):
    """Find the closest triangle whose normal in `faces` is within arccos(cosine) of the point's; -1: none.

    The cost is distance², plus `turned2` for a turned normal. Triangles that cost `most` or more are ignored.
    """
    n = len(points)
    which, weights, distance = np.full(n, -1), np.zeros((n, 3)), np.full(n, np.inf)
    stack = np.empty(128, np.int64)
    for i in range(n):
        p, best, size = points[i], most, 1
        stack[0] = 0
        while size > 0:
            size -= 1
            node = stack[size]
            if _box_distance2(box[node], p) >= best:
                continue
            if left[node] < 0:
                for k in range(start[node], stop[node]):
                    t = order[k]
                    aligned = normals[i, 0] * faces[t, 0] + normals[i, 1] * faces[t, 1] + normals[i, 2] * faces[t, 2]
                    if aligned < cosine:
                        continue
                    u, v, w, d2 = closest_on_triangle(p, corners[t])
                    cost = d2 + turned2 * (2.0 - 2.0 * aligned)
                    if cost < best:
                        best, which[i], distance[i] = cost, t, np.sqrt(d2)
                        weights[i, 0], weights[i, 1], weights[i, 2] = u, v, w
            else:
                a, b = left[node], left[node] + 1
                if _box_distance2(box[a], p) < _box_distance2(box[b], p):
                    a, b = b, a
                stack[size], stack[size + 1] = a, b
                size += 2
    return which, weights, distance


@njit(cache=True)
def _apart(a, b):
    for c in range(3):
        if a[c] > b[3 + c] or b[c] > a[3 + c]:
            return True
    return False


@njit(cache=True)
def _common(a, b):
    for i in range(3):
        if a[i] == b[0] or a[i] == b[1] or a[i] == b[2]:
            return True
    return False


@njit(cache=True)
def _boxes(corners):
    """Return the boxes (m, 6), lower ends first, of triangles or tets with corners (m, 3 or 4, 3)."""
    boxes = np.empty((len(corners), 6))
    for t in range(len(corners)):
        for c in range(3):
            low = high = corners[t, 0, c]
            for k in range(1, corners.shape[1]):
                low, high = min(low, corners[t, k, c]), max(high, corners[t, k, c])
            boxes[t, c], boxes[t, 3 + c] = low, high
    return boxes


def _lay_out(corners, layout):
    """Return the nodes of a tree over such corners: a new one, or a given layout with its boxes fitted again."""
    low, high = np.hsplit(_boxes(corners), 2)
    return _build(low, high) if layout is None else (*layout, _refit(low, high, *layout))


@njit(cache=True)
def _crossings(query, query_ids, same, most, corners, ids, order, start, stop, left, box):
    """Return pairs (query, triangle) that cross, at most about `most`, leaving out pairs with a common vertex.

    `same` lists each pair once.
    """
    pairs, count = [], 0
    stack = np.empty(128, np.int64)
    boxes = _boxes(corners)
    own = boxes if same else _boxes(query)
    for q in range(len(query)):
        if count >= most:
            break
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            node = stack[size]
            if _apart(own[q], box[node]):
                continue
            if left[node] >= 0:
                stack[size], stack[size + 1] = left[node], left[node] + 1
                size += 2
                continue
            for k in range(start[node], stop[node]):
                t = order[k]
                if (same and t <= q) or _apart(own[q], boxes[t]) or _common(query_ids[q], ids[t]):
                    continue
                if triangles_cross(query[q], corners[t]):
                    pairs.append((q, t))
                    count += 1
    return pairs


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Closest points on, and crossings with, the triangles (m, 3) of `vertices` (n, 3)."""

    vertices: Floats
    triangles: Ints
    layout: tuple[np.ndarray, ...] | None = field(default=None, repr=False)
    corners: Floats = field(init=False, repr=False)
    nodes: tuple[np.ndarray, ...] = field(init=False, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "corners", np.ascontiguousarray(self.vertices[self.triangles]))
        object.__setattr__(self, "nodes", _lay_out(self.corners, self.layout))

    def moved(self, vertices: Floats) -> TriangleTree:
        """Return the tree of the same triangles over other vertices (n, 3) [mm]: quicker, good for small motions."""
        return TriangleTree(vertices, self.triangles, self.nodes[:-1])

    def closest(self, points: Floats) -> tuple[Ints, Floats, Floats]:
        """Return triangle (k,), barycentric weights (k, 3) and distance (k,) of the point closest to each point."""
        any_direction = np.zeros((1, 3))
        normals, faces = (np.broadcast_to(any_direction, (len(a), 3)) for a in (points, self.triangles))
        return _closest(np.ascontiguousarray(points), normals, -1.0, 0.0, np.inf, self.corners, faces, *self.nodes)

    def closest_facing(
        self, points: Floats, normals: Floats, faces: Floats, cosine: float, turned: float = 0.0, reach: float = np.inf
    ) -> tuple[Ints, Floats, Floats]:
        """Search as `closest`, among the triangles whose normal is within arccos(cosine) of the point's.

        Minimises distance² + turned² |n_p - n_t|². Triangles beyond `reach` [mm] may be left out, which is quicker.

        `normals` (k, 3) of the points and `faces` (m, 3) of the triangles are unit vectors. Where no triangle
        qualifies the triangle is -1, its weights are 0 and the distance is infinite.
        """
        arrays = (np.ascontiguousarray(a) for a in (points, normals))
        most = reach * reach + turned * turned * (2.0 - 2.0 * cosine)
        return _closest(*arrays, cosine, turned * turned, most, self.corners, np.ascontiguousarray(faces), *self.nodes)

    def self_crossings(self, *, most: int = ALL) -> Ints:
        """Return pairs of triangles without a common vertex that cross, (k, 2); the search ends after `most`."""
        return self._pairs(self.corners, self.triangles, True, most)

    def crossings_of(self, some: Ints) -> Ints:
        """Return those of these pairs that have one of some triangles (k,), each pair and row in rising order."""
        pairs = self._pairs(self.corners[some], self.triangles[some], False, ALL)
        pairs[:, 0] = some[pairs[:, 0]]
        return np.unique(np.sort(pairs, axis=1), axis=0)

    def measure_overlap(self) -> tuple[int, float]:
        """Count `self_crossings`, and measure the longest shift [mm] that one of these pairs needs to be parted."""
        pairs = self.self_crossings()
        shifts = parting_shifts(*(self.corners[pairs[:, side]] for side in range(2)))
        return len(pairs), float(shifts.max(initial=0.0))

    def crossings(self, other: TriangleTree, *, most: int = ALL) -> Ints:
        """Return pairs (triangle of `other`, triangle of this) that cross, (k, 2); the search ends after `most`."""
        return self._pairs(other.corners, other.triangles + len(self.vertices), False, most)

    def _pairs(self, query, query_ids, same, most) -> Ints:
        pairs = _crossings(query, query_ids, same, most, self.corners, self.triangles, *self.nodes)
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)


@njit(cache=True)
def _overlap_boxes(query, query_ids, same, boxes, ids, order, start, stop, left, box, out):
    """Write pairs (query, box) that overlap and have no common id, as far as there is room; return their number."""
    stack = np.empty(128, np.int64)
    count = 0
    for q in range(len(query)):
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            node = stack[size]
            if _apart(query[q], box[node]):
                continue
            if left[node] >= 0:
                stack[size], stack[size + 1] = left[node], left[node] + 1
                size += 2
                continue
            for k in range(start[node], stop[node]):
                t = order[k]
                if (same and t <= q) or _apart(query[q], boxes[t]):
                    continue
                common = False
                for i in query_ids[q]:
                    for j in ids[t]:
                        common = common or i == j
                if not common:
                    if count < len(out):
                        out[count, 0], out[count, 1] = q, t
                    count += 1
    return count


@dataclass(frozen=True, eq=False)
class BoxTree:
    """A tree over boxes (m, 6), lower ends first, of elements with vertices `ids` (m, any)."""

    boxes: Floats
    ids: Ints
    layout: tuple[np.ndarray, ...] | None = field(default=None, repr=False)
    nodes: tuple[np.ndarray, ...] = field(init=False, repr=False)

    def __post_init__(self):
        low, high = (np.ascontiguousarray(ends) for ends in np.hsplit(self.boxes, 2))
        nodes = _build(low, high) if self.layout is None else (*self.layout, _refit(low, high, *self.layout))
        object.__setattr__(self, "nodes", nodes)

    def moved(self, boxes: Floats) -> BoxTree:
        """Return the tree of the same elements in other boxes: quicker, good for small motions."""
        return BoxTree(boxes, self.ids, self.nodes[:-1])

    def self_overlaps(self) -> Ints:
        """Return pairs of boxes that overlap and whose elements have no common vertex, each once, shape (r, 2)."""
        return self._pairs(self.boxes, self.ids, True)

    def overlaps(self, boxes: Floats, ids: Ints) -> Ints:
        """Return pairs (one of `boxes` (q, 6), own box) that overlap and have no common vertex, shape (r, 2).

        ids (q, any): the vertices of the elements in those boxes.
        """
        return self._pairs(boxes, ids, False)

    def _pairs(self, boxes: Floats, ids: Ints, same: bool) -> Ints:
        out = np.empty((4 * len(self.boxes), 2), dtype=np.int64)
        while (count := _overlap_boxes(boxes, ids, same, self.boxes, self.ids, *self.nodes, out)) > len(out):
            out = np.empty((count, 2), dtype=np.int64)
        return out[:count]
