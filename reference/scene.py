"""A scene to solve: vertices, tets and a list of terms. Every solver takes the same scene."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..lhm.base.checks import indices_below
from ..lhm.base.errors import MeshError, SceneError
from ..lhm.base.mesh import Floats, Ints, TetMesh
from .materials import Material
from .terms import Cells, Fixed, OnTets, OnTriangles, Pressure, RigidBody, Solid, Target, Term
from .terms.cells import prism_vertices


@dataclass(frozen=True, eq=False)
class Scene:
    """Rest vertices [mm], shape (n, 3), tets (m, 4) and terms; checked when made.

    `columns` are a hint for solvers: arrays (k, m) of k rows of m vertices, one behind the other through thin layers of
    tets. A mesh without those inside a row, which has only their ends, models all but what is finer than a row.
    `prisms` (k, 3) are the tets that share a deformation in some terms, three a row.
    Raises SceneError for a tet that is inverted, flat or there twice (by index), where nothing is there to be deformed,
    for a term that names vertices, tets or triangles that are not there, or that is no term, for a tet that is in two
    prisms, and for columns that are no indices or share a vertex inside a row.
    """

    vertices: Floats
    tets: Ints
    terms: tuple[Term, ...]
    columns: tuple[Ints, ...] = field(default=(), repr=False, kw_only=True)
    volumes: Floats = field(init=False, repr=False)
    prisms: Ints = field(init=False, repr=False)

    def __post_init__(self):
        try:
            mesh = TetMesh(self.vertices, self.tets)
        except MeshError as error:
            raise SceneError(f"scene: {error}") from None
        object.__setattr__(self, "vertices", mesh.vertices)
        object.__setattr__(self, "tets", mesh.tets)
        object.__setattr__(self, "volumes", mesh.volumes)
        try:
            object.__setattr__(self, "terms", tuple(self.terms))
        except TypeError:
            raise SceneError(f"terms: expected a list of terms, got {type(self.terms).__name__}") from None
        if not len(self.tets) and not any(isinstance(term, OnTriangles) for term in self.terms):
            raise SceneError("scene: tets: there are none, and no term acts on triangles")
        for position, term in enumerate(self.terms):
            if not isinstance(term, Term):
                raise SceneError(f"term {position}: {type(term).__name__} is no term; see softdeca.reference.terms")
            try:
                term.check(self)
            except SceneError as error:
                raise SceneError(f"term {position} ({term.name}): {error}") from None
        object.__setattr__(self, "prisms", self._gather_prisms())
        self._check_columns()
        held, _ = self.dirichlet()
        self._check_bodies(held.any(axis=1))

    def _gather_prisms(self) -> Ints:
        """Gather the terms' rows of three tets, each once; SceneError where a tet is in two, or they are no prism."""
        mates, seen = np.full((len(self.tets), 3), -1), list[Ints]()
        for term in self.of(Solid):
            if not term.on_prisms or any(np.array_equal(term.tets, rows) for rows in seen):
                continue
            before, own = mates[term.tets], term.tets[:, None]
            clash = (before != own) & (before >= 0)
            if clash.any():
                tet = term.tets[clash.any(axis=2)][0]
                raise SceneError(f"{term.name}: tet {tet} shares its deformation with others elsewhere")
            mates[term.tets] = own
            seen.append(term.tets)
        prisms = mates[mates[:, 0] == np.arange(len(mates))]
        prism_vertices(self, prisms)
        return prisms

    @cached_property
    def prism_cells(self) -> Cells:
        """The prisms as cells."""
        return Cells.from_mesh(self, self.prisms)

    def _check_columns(self):
        """Take columns of indices (k, m) of vertices; SceneError for others, and where two rows share an inner one."""
        n, columns = len(self.vertices), []
        for position, column in enumerate(self.columns):
            columns.append(indices_below(f"columns {position}", column, n, (None, None), error=SceneError))
            if columns[-1].shape[1] < 2:
                raise SceneError(f"columns {position}: expected at least 2 vertices a row, got {columns[-1].shape[1]}")
        object.__setattr__(self, "columns", tuple(columns))
        if not columns:
            return
        inside = np.bincount(np.concatenate([column[:, 1:-1].ravel() for column in columns]), minlength=n)
        ends = np.concatenate([column[:, [0, -1]].ravel() for column in columns])
        twice = np.flatnonzero(inside > 1)
        if not twice.size:
            twice = ends[inside[ends] > 0]
        if twice.size:
            raise SceneError(f"columns: vertex {twice[0]} is inside one row and in another one too")

    def _check_bodies(self, held: np.ndarray):
        """Raise SceneError for bodies in line, that share a vertex, or that have one held by a Fixed term."""
        taken = np.full(len(self.vertices), -1)
        for body, term in enumerate(self.of(RigidBody)):
            rest = self.body_rest(term)
            if np.linalg.svd(rest - rest.mean(axis=0), compute_uv=False)[1] <= 1e-9 * np.ptp(rest):
                raise SceneError(f"RigidBody {body}: its vertices lie in line, so its rotation is not determined")
            if (taken[term.vertices] >= 0).any():
                vertex = term.vertices[taken[term.vertices] >= 0][0]
                raise SceneError(f"RigidBody {body}: vertex {vertex} belongs to another body too")
            if held[term.vertices].any():
                vertex = term.vertices[held[term.vertices]][0]
                raise SceneError(
                    f"RigidBody {body}: vertex {vertex} is Fixed too; hold the body by Target, or fix it all"
                )
            taken[term.vertices] = body

    def body_rest(self, body: RigidBody) -> Floats:
        """A rigid body's shape [mm], (k, 3)."""
        return self.vertices[body.vertices] if body.rest is None else body.rest

    def of(self, kind: type[Term]) -> list:
        """The terms of one class, in order."""
        return [term for term in self.terms if isinstance(term, kind)]

    def tets_of(self, term: OnTets) -> Ints:
        """The indices of the tets that a term acts on, shape (k,), or (k, 3) of prisms."""
        return term.tets_of(self)

    def dirichlet(self) -> tuple[np.ndarray, Floats]:
        """Mask (n, 3) of held components, and positions (n, 3) [mm] that are the held values there, rest elsewhere.

        Raises SceneError where two Fixed terms hold one component at different values.
        """
        held = np.zeros(self.vertices.shape, dtype=bool)
        positions = np.array(self.vertices)
        for term in self.of(Fixed):
            values = self.vertices[term.vertices] if term.values is None else term.values
            for c in term.components:
                clash = held[term.vertices, c] & (positions[term.vertices, c] != values[:, c])
                if clash.any():
                    raise SceneError(f"Fixed: vertex {term.vertices[clash][0]} is held at two places in component {c}")
                held[term.vertices, c] = True
                positions[term.vertices, c] = values[:, c]
        return held, positions

    def loads(self) -> Floats:
        """Dead nodal forces [mN] of all terms, lumped exactly for linear shape functions, shape (n, 3)."""
        forces = np.zeros(self.vertices.shape)
        for term in self.terms:
            term.add_load(self, forces)
        return forces

    def force_scale(self) -> float:
        """A force [mN] that unit strain would cause, the scale below which a gradient is rounding."""
        return self._unit_force() / max(len(self.vertices), 1)

    def rounding(self) -> float:
        """A gradient norm [mN] below which all may be rounding, independent from vertex to vertex: by their root.

        It is a hint: beside great stiffness elsewhere the loads on soft tissue are smaller.
        """
        return 1e-14 * self._unit_force() / max(len(self.vertices), 1) ** 0.5

    def is_rest(self, norm: float) -> bool:
        """Whether a gradient norm [mN] is rounding in a scene without loads, where there is nothing to solve for."""
        return norm <= self.rounding() and not self.of(Pressure) and not self.loads().any()

    def _unit_force(self) -> float:
        """Give the force [mN] that unit strain would cause at all vertices together."""
        return sum(term.unit_force(self) for term in self.terms)

    def with_targets(self, positions) -> Scene:
        """The same scene with other positions [mm], shape (k, 3), in its one Target term."""
        return self._with_one(Target, positions=positions)

    def with_fixed(self, values) -> Scene:
        """The same scene with other values [mm], shape (k, 3), in its one Fixed term."""
        return self._with_one(Fixed, values=values)

    def _with_one(self, kind, **changes) -> Scene:
        found = self.of(kind)
        if len(found) != 1:
            raise SceneError(f"the scene has {len(found)} {kind.__name__} terms; replace them in Scene.terms by hand")
        return replace(self, terms=tuple(replace(t, **changes) if t is found[0] else t for t in self.terms))

    def check_prepared_for(self, other: Scene, *, fixed: Container[tuple[type[Term], str]] = ()):
        """Raise SceneError if `other` differs from this scene in more than the `varying` fields of its terms.

        `fixed` are those of them that a solver has prepared for all the same.
        """
        if other is self:
            return
        if other.vertices is not self.vertices and not np.array_equal(other.vertices, self.vertices):
            raise SceneError("the scene's rest vertices differ from the prepared ones: prepare it anew")
        if other.tets is not self.tets and not np.array_equal(other.tets, self.tets):
            raise SceneError("the scene's tets differ from the prepared ones: prepare it anew")
        if [type(t) for t in other.terms] != [type(t) for t in self.terms]:
            raise SceneError("the scene's terms differ from the prepared ones: prepare it anew")
        for position, key in sorted(self.find_changes(other)):
            mine = self.terms[position]
            if key not in mine.varying or (type(mine), key) in fixed:
                raise SceneError(f"{mine.name}.{key} differs from the prepared scene's: prepare it anew")

    def find_changes(self, other: Scene) -> set[tuple[int, str]]:
        """Find the fields of terms that another scene of the same kinds of terms has otherwise: place and name."""
        return {
            (position, key)
            for position, (mine, its) in enumerate(zip(self.terms, other.terms, strict=True))
            for key in mine.__dataclass_fields__
            if not _are_equal(getattr(mine, key), getattr(its, key))
        }

    def first(self, kind: type[Term]) -> int:
        """The place of the first term of a class."""
        return next(position for position, term in enumerate(self.terms) if isinstance(term, kind))


def _are_equal(one, other) -> bool:
    """Whether two fields of terms, numbers or arrays, are the same."""
    return one is other or bool(np.all(np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other))


def refuse_unknown(
    scene: Scene,
    solver: str,
    known: tuple[type[Term], ...],
    laws: tuple[type[Material], ...] = (),
    *,
    prisms: bool = False,
):
    """Raise SceneError for the first term or law of tissue that a solver cannot model; prisms, if it can, it says."""
    if len(scene.prisms) and not prisms:
        raise SceneError(f"solver {solver!r} cannot model prisms of three tets; it models tets")
    for term in scene.terms:
        if not isinstance(term, known):
            names = ", ".join(kind.__name__ for kind in known)
            raise SceneError(f"solver {solver!r} cannot model {term.name}; it models {names}")
        if (unmodelled := term.explain_unmodelled(laws)) is not None:
            raise SceneError(f"solver {solver!r} cannot model {unmodelled}")
