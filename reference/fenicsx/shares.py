"""A problem whose solids several processes integrate: each has its share of the tets, the first all other terms.

The first process keeps the whole mesh and matrix, so that all else works on them as it does alone. The others have a
scene of their tets only. Sums over shares differ from a sum over all tets by rounding.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import fields, replace

import numpy as np

from ...lhm.mesh import Floats, Ints
from ..materials import Material
from ..ranks import Remote, Team, team
from ..scene import Scene
from ..terms import Hyperelastic, Strain, Term, Volume
from .dolfinx_version import PETSc
from .numbering import Numbering
from .problem import Problem, State

SOLIDS = (Strain, Volume, Hyperelastic)
FEW = 300  # tets, below which sharing them costs more than it saves
KEPT = 4  # states, that a share remembers: a line search returns to the one before


def problem_of(scene: Scene, numbering: Numbering) -> Problem:
    """The scene's problem, shared with the processes that mpirun has started, if there are any."""
    others = team()
    if others is None or len(scene.tets) < FEW:
        return Problem(scene, numbering)
    return SharedProblem(scene, numbering, others)


def share_of(scene: Scene, tets: Ints) -> tuple[Term, ...]:
    """The scene's solids on tets (k,) alone, sorted, and without those that act on none of them."""
    member = np.zeros(len(scene.tets), dtype=bool)
    member[tets] = True
    solids = []
    for term in scene.terms:
        if isinstance(term, SOLIDS):
            mine = member[scene.tets_of(term)]
            if mine.any():
                solids.append(_restricted(scene, term, mine))
    return tuple(solids)


def _restricted(scene: Scene, term: Term, mine: np.ndarray) -> Term:
    changes: dict[str, object] = {"tets": scene.tets_of(term)[mine]}
    changes |= {key: value[mine] for key, value in vars(term).items() if _per_tet(value, 1) and key != "tets"}
    if isinstance(term, Hyperelastic):
        changes["material"] = _material(term.material, mine)
    return replace(term, **changes)


def _material(material: Material, mine: np.ndarray) -> Material:
    values = {field.name: getattr(material, field.name) for field in fields(material)}
    changes = {key: value[mine] for key, value in values.items() if _per_tet(value, 2)}
    return replace(material, **changes) if changes else material


def _per_tet(value, dimensions: int) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == dimensions


def small_scene(scene: Scene, tets: Ints) -> tuple[Scene, Ints]:
    """A scene of tets (k,) with its solids alone, and the vertices that it has."""
    vertices, corners = np.unique(scene.tets[tets], return_inverse=True)
    place = np.full(len(scene.tets), -1)
    place[tets] = np.arange(len(tets))
    terms = tuple(replace(term, tets=place[term.tets]) for term in share_of(scene, tets))  # type: ignore[attr-defined,call-arg]
    return Scene(scene.vertices[vertices], corners.reshape(-1, 4), terms), vertices


class Share:
    """One process' part of a problem: a scene of its tets and solids alone, by elements of a degree."""

    def __init__(self, scene: Scene, degree: int):
        self._problem = Problem(scene, Numbering(scene, degree))
        self._states: OrderedDict[int, State] = OrderedDict()

    def pattern(self) -> tuple[Ints, Ints, Ints]:
        """Ends of the nodes (n, 2) by the scene's vertices; where rows of blocks start, and the blocks' columns."""
        stiffness = self._problem.stiffness
        return self._problem.numbering.ends, stiffness.starts, stiffness.columns

    def set(self, scene: Scene):
        """Take other limits, targets and the like."""
        self._states.clear()
        self._problem.set(scene)

    def energy(self, number: int, u: Floats) -> float:
        """The energy [µJ] at displacement u [mm], shape (n, 3), which is known by its number from now on."""
        return self._at(number, u).energy

    def gradient(self, number: int, u: Floats) -> Floats:
        """The gradient [mN], shape (n, 3)."""
        return self._at(number, u).gradient()

    def hessian(self, number: int, u: Floats, kept: float | None) -> Floats:
        """The Hessian's values [mN/mm], row by row; softened where `kept` is given."""
        state = self._at(number, u)
        if kept is None:
            state.hessian()
        else:
            state.softened_hessian(kept)
        return self._problem.stiffness.values

    def _at(self, number: int, u: Floats) -> State:
        if number not in self._states:
            self._states[number] = self._problem.at(u)
            while len(self._states) > KEPT:
                self._states.popitem(last=False)
        return self._states[number]


class SharedProblem(Problem):
    """See Problem; what is not a solid, and the first share of those, is this process'."""

    def __init__(self, scene: Scene, numbering: Numbering, team: Team):
        self._tets = [np.sort(tets) for tets in np.array_split(numbering.tet, team.size)]
        self._remote: Remote | None = None
        self._number = 0
        small = [small_scene(scene, tets) for tets in self._tets[1:]]
        remote = team.begin_making(Share, [(share, numbering.degree) for share, _ in small])
        super().__init__(scene, numbering)
        remote.end()
        self._remote = remote
        patterns = self._remote.call("pattern", [()] * len(small))
        self._nodes = [numbering.nodes_between(v[ends]) for (_, v), (ends, _, _) in zip(small, patterns, strict=True)]
        self._places = [
            self.stiffness.places(nodes, starts, columns)
            for nodes, (_, starts, columns) in zip(self._nodes, patterns, strict=True)
        ]

    def _own(self, scene: Scene) -> Scene:
        others = tuple(term for term in scene.terms if not isinstance(term, SOLIDS))
        return replace(scene, terms=(*others, *share_of(scene, self._tets[0])))

    def set(self, scene: Scene):
        """See Problem."""
        super().set(scene)
        if self._remote is not None:
            self._remote.call("set", [(small_scene(scene, tets)[0],) for tets in self._tets[1:]])

    def at(self, u: Floats) -> State:
        """See Problem."""
        self._number += 1
        return SharedState(self, u, self._number)

    def moved(self, state: State, step: Floats) -> State:
        """See Problem."""
        return self.at(state.u + step.reshape(state.u.shape))

    def begin(self, method: str, number: int, u: Floats, *arguments):
        """Ask the others for what they have at a displacement [mm], shape (n, 3), known by its number."""
        assert self._remote is not None
        self._remote.begin(method, [(number, u[nodes], *arguments) for nodes in self._nodes])

    def end(self) -> list:
        """What they answer."""
        assert self._remote is not None
        return self._remote.end()

    def add_rows(self, parts: list[Floats], into: Floats):
        """Add parts by the shares' nodes to an array by node (n, 3)."""
        for nodes, part in zip(self._nodes, parts, strict=True):
            into[nodes] += part

    def add_values(self, parts: list[Floats]):
        """Add the values of the shares' matrices to the matrix."""
        for places, part in zip(self._places, parts, strict=True):
            self.stiffness.values[places] += part
        self.stiffness.touch()


class SharedState(State):
    """See State; the others compute their parts while this process computes its own."""

    def __init__(self, problem: SharedProblem, u: Floats, number: int):
        self._shared, self._number = problem, number
        problem.begin("energy", number, u)
        super().__init__(problem, u)
        self.energy += sum(problem.end())

    def gradient(self) -> Floats:
        """See State."""
        self._shared.begin("gradient", self._number, self.u)
        total = super().gradient()
        self._shared.add_rows(self._shared.end(), total)
        return total

    def hessian(self) -> PETSc.Mat:
        """See State."""
        self._shared.begin("hessian", self._number, self.u, None)
        matrix = super().hessian()
        self._shared.add_values(self._shared.end())
        return matrix

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """See State."""
        self._shared.begin("hessian", self._number, self.u, kept)
        matrix = super().softened_hessian(kept)
        self._shared.add_values(self._shared.end())
        return matrix
