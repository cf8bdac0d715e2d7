"""A scene on tets that are split into eight: the same problem on a finer mesh."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ....lhm.base.geometry.topology import midpoints
from ....lhm.base.mesh import Floats, Ints, Surface, TetMesh
from ....lhm.head.remesh import EDGES, refine_tets
from ....reference import Scene, terms
from ....reference.problems.meshes import boundary_triangles
from ....reference.terms.solids import Solid


@dataclass(frozen=True, eq=False)
class Split:
    """Tets split into eight, with the parent of each, and edges (e, 2) whose middles come after the old vertices.

    Children of a tet follow one another.
    """

    mesh: TetMesh
    parents: Ints
    ends: Ints
    count: int

    @classmethod
    def from_tets(cls, vertices: Floats, tets: Ints) -> Split:
        """Split tets (m, 4)."""
        mesh, parents = refine_tets(TetMesh(vertices, tets))
        ends, _ = midpoints(tets, EDGES, len(vertices))
        return cls(mesh, parents, ends, len(vertices))

    def triangles(self, triangles: Ints) -> Ints:
        """Split triangles (k, 3) of the old vertices into four each."""
        keys = self.ends @ [self.count, 1]
        a, b, c = triangles.T
        ab, bc, ca = (
            self.count + np.searchsorted(keys, np.minimum(p, q) * self.count + np.maximum(p, q))
            for p, q in ((a, b), (b, c), (c, a))
        )
        parts = [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        return np.stack(parts, axis=1).reshape(-1, 3)


def refine_scene(scene: Scene) -> tuple[Scene, Ints]:
    """Split every tet of a face by tets into eight; also the edges (e, 2) whose middles come after its vertices.

    Terms keep their values, springs theirs per area, linear along an edge. A middle is held where quadratic tets hold
    it: on boundary triangles whose corners are held. A head that is refined in place of its scene would be another
    problem: guards go by the height of a tet, and shares of flesh by paths along edges.
    """
    split = Split.from_tets(scene.vertices, scene.tets)
    finer, ends = split.mesh, split.ends

    def refine_term(term: Any) -> terms.Term:
        if isinstance(term, Solid):
            changes = _repeat(term, 8) | {"tets": (8 * scene.tets_of(term)[:, None] + np.arange(8)).ravel()}
            return replace(term, **changes)
        if isinstance(term, terms.SurfaceStrain | terms.Bending):
            return replace(term, triangles=split.triangles(term.triangles), **_repeat(term, 4))
        if isinstance(term, terms.Target):
            return _refine_springs(term, scene, ends, finer.vertices, split.triangles(term.triangles))
        return term

    held, places = scene.dirichlet()
    border = boundary_triangles(scene.tets)
    on_held = split.triangles(border[held.all(axis=1)[border].all(axis=1)])
    ids = np.unique(np.concatenate([np.flatnonzero(held.all(axis=1)), on_held.ravel()]))
    parts = [refine_term(term) for term in scene.terms if not isinstance(term, terms.Fixed)]
    parts.append(terms.Fixed(ids, carry(places, ends)[ids]))
    return Scene(finer.vertices, finer.tets, tuple(parts)), ends


def keep_used(scene: Scene) -> tuple[Scene, Ints]:
    """Leave out what no tet of a region's scene has; also the vertices (k,) that are left."""
    used = np.unique(scene.tets)
    number = np.full(len(scene.vertices), -1)
    number[used] = np.arange(len(used))

    def renumber(term: Any) -> terms.Term:
        changes: dict[str, Any] = {}
        if isinstance(term, terms.SurfaceStrain | terms.Bending | terms.Target):
            changes["triangles"] = number[term.triangles]
        if isinstance(term, terms.Target | terms.Fixed):
            kept = number[term.vertices] >= 0
            changes["vertices"] = number[term.vertices[kept]]
            names = ("positions", "stiffness") if isinstance(term, terms.Target) else ("values",)
            changes |= {name: getattr(term, name)[kept] for name in names}
        return replace(term, **changes)

    return Scene(scene.vertices[used], number[scene.tets], tuple(map(renumber, scene.terms))), used


def carry(values: Floats, ends: Ints) -> Floats:
    """Append the means over edges (e, 2) to values of vertices."""
    return np.concatenate([values, values[ends].mean(axis=1)])


def _repeat(term: Any, times: int) -> dict[str, Any]:
    """The values of each of a term's elements, for all parts into which they are split."""
    values = {each.name: getattr(term, each.name) for each in fields(term) if each.name in term.amounts}
    return {name: np.repeat(value, times) for name, value in values.items() if np.ndim(value)}


def _refine_springs(term: terms.Target, scene: Scene, ends: Ints, vertices: Floats, triangles: Ints) -> terms.Target:
    """Springs of the same stiffness per area on finer triangles (4 t, 3) of finer `vertices`."""
    n = len(scene.vertices)
    density, places = np.zeros(n), np.zeros((n, 3))
    _, density[term.triangles], places[term.triangles] = term.spread(scene)
    ids = np.unique(triangles)
    finer = Surface(vertices, triangles).vertex_areas
    return terms.Target(ids, carry(places, ends)[ids], (carry(density, ends) * finer)[ids], triangles)
