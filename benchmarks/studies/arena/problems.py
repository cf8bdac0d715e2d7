"""The arena's problems as data: what is held, moved and loaded, of which stiffness, and FEniCSx' answer by law."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ....lhm.base.mesh import Floats, Ints
from ....lhm.head.head import FREE, MANDIBLE, LayeredHead
from ....reference import Parameters, Scene, apply_law, facial_scene, materials, prepare, terms
from ....reference.added import NotModelledError
from ....reference.face.facial import PD_ENERGY, TISSUE_DENSITY
from ....reference.problems.meshes import block, box, triangles_at, vertices_at
from ..measures import ACCURACY, TIGHT, largest_distance, solve_to_end
from ..person import person
from .laws import NEO_HOOKEAN, PROJECTIVE, RIGID, ST_VENANT, find_law
from .solvers.protocol import ArenaProblem

LINEAR = "P1"
"""The element of every other package."""
STANDARD_GRAVITY = 9810.0
"""[mm/s²]"""
FLESH_YOUNG, FLESH_POISSON = 15.0, 0.45
"""[kPa] and 1."""
EXPRESSION = "jawOpen*0.5+mouthSmileLeft*0.7+mouthSmileRight*0.7"
EVERY = 16
"""One vertex in so many of the skin wrap is a handle."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Tets with `held` vertices (k,) that go to `places` (k, 3) [mm], loads, and moduli [kPa] per tet (m,).

    Among the loads may be springs (Target) and a membrane (SurfaceStrain). Errors are measured at the vertices `skin`.
    `closed` gives the exact positions of a law [mm], None without a form.
    """

    vertices: Floats
    tets: Ints
    held: Ints
    places: Floats
    loads: Sequence[terms.Term]
    mu: Floats
    lmbda: Floats
    skin: Ints
    closed: Callable[[str], Floats | None] = lambda law: None

    def scene(self, law: str) -> Scene:
        """Give the scene of a law, by its name in `laws.LAWS` or of a file."""
        pairs, which = np.unique(np.column_stack([self.mu, self.lmbda]), axis=0, return_inverse=True)
        solids = [
            term
            for number, (mu, lmbda) in enumerate(pairs)
            for term in find_law(law)(float(mu), float(lmbda), np.flatnonzero(which.ravel() == number))
        ]
        return Scene(self.vertices, self.tets, (*solids, terms.Fixed(self.held, self.places), *self.loads))

    def arrays(self, start: Floats | None = None) -> ArenaProblem:
        """Give the problem as arrays, with a start [mm], (n, 3); by default rest."""
        scene = self.scene(NEO_HOOKEAN)
        springs, drawn_to = np.zeros(len(self.vertices)), np.array(self.vertices)
        for target in scene.of(terms.Target):
            assert not target.is_spread(1)  # arrays have springs at vertices alone
            springs[target.vertices], drawn_to[target.vertices] = target.stiffness, target.positions
        surfaces = scene.of(terms.SurfaceStrain)
        triangles = np.concatenate([np.zeros((0, 3), dtype=np.int64), *(surface.triangles for surface in surfaces)])
        stiffness = [np.broadcast_to(surface.stiffness, len(surface.triangles)) for surface in surfaces]
        return ArenaProblem(
            self.vertices, self.tets, self.held, self.places, scene.loads(), self.mu, self.lmbda,
            self.skin, np.array(self.vertices if start is None else start), springs, drawn_to,
            triangles, np.concatenate([np.zeros(0), *stiffness]),
        )  # fmt: skip

    @cached_property
    def warm(self) -> Problem:
        """A small block with the same kinds of loads, of the first tet's moduli: the uncounted run before a solve."""
        X, tets = block(2, 10.0)
        low, high, side = vertices_at(X, 2, 0.0), vertices_at(X, 2, 10.0), triangles_at(X, tets, 0, 0.0)
        held, middle = np.concatenate([low, high]), vertices_at(X, 2, 5.0)
        alike = {
            terms.Gravity: self.scene(NEO_HOOKEAN).of(terms.Gravity),
            terms.Traction: [terms.Traction(side, np.array([0.01, 0.0, 0.0]))],
            terms.Target: [terms.Target(middle, X[middle] + 0.1, 1.0)],
            terms.SurfaceStrain: [terms.SurfaceStrain(side, 1.0)],
        }
        loads = [term for kind in dict.fromkeys(map(type, self.loads)) for term in alike[kind]]
        places = X[held] + np.where(X[held, 2:] > 5.0, [[0.0, 0.0, 0.5]], 0.0)
        mu, lmbda = (np.full(len(tets), moduli[0]) for moduli in (self.mu, self.lmbda))
        return Problem(X, tets, held, places, loads, mu, lmbda, np.arange(len(X)))


@dataclass(frozen=True, eq=False)
class PosedFace(Problem):
    """A face by its own scene, of which arrays do not say the free jaw and guards of thin tets."""

    own: Scene | None = None

    def scene(self, law: str) -> Scene:
        """Give its scene under a law."""
        assert self.own is not None
        return apply_law(self.own, PD_ENERGY if law == PROJECTIVE else law)

    def arrays(self, start: Floats | None = None) -> ArenaProblem:
        """Raise NotModelledError."""
        raise NotModelledError("a face's own energy has terms that arrays do not say")


def pose_face(scene: Scene) -> PosedFace:
    """Make the problem of a facial scene by tets, whose errors are those of all vertices."""
    return PosedFace(**_read_face(scene), skin=np.arange(len(scene.vertices)), own=scene)


def _read_face(scene: Scene) -> dict[str, Any]:
    """Mesh, held vertices, springs, membrane and moduli of a facial scene, as fields of a problem."""
    held, places = scene.dirichlet()
    ids, full = np.flatnonzero(held.all(axis=1)), np.ones(len(scene.tets))
    (strain, *_), (volume, *_) = scene.of(terms.Strain), scene.of(terms.Volume)
    moduli = {"mu": strain.stiffness / 2.0 * full, "lmbda": volume.stiffness / 3.0 * full}
    pulls = [*scene.of(terms.Target), *scene.of(terms.SurfaceStrain)]
    mesh = {"vertices": scene.vertices, "tets": scene.tets}
    return {**mesh, "held": ids, "places": places[ids], "loads": pulls, **moduli}


def _make_problem(vertices, tets, held, places, loads, young, poisson, skin, **more) -> Problem:
    """Make a problem of one material."""
    mu, lmbda = materials.material.lame(young, poisson)
    full = np.ones(len(tets))
    return Problem(vertices, tets, held, places, loads, mu * full, lmbda * full, skin, **more)


BAR_CELLS, BAR_HEIGHT, BAR_YOUNG, BAR_DENSITY = 20, 1000.0, 125.0, 1e-6
"""Layers, [mm], [kPa] and [kg/mm³]."""


def bar() -> Problem:
    """Make a bar that hangs from its top under its weight, of Poisson's ratio 0.

    Each layer's weight is shared by the areas of a cross-section's vertices, so that the exact answer of a law on
    these tets is one stretch per layer, which moves no vertex aside.
    """
    X, tets = box((4, 4, BAR_CELLS), (200.0, 200.0, BAR_HEIGHT))
    layer = BAR_HEIGHT / BAR_CELLS
    heights = np.linspace(0.0, BAR_HEIGHT, BAR_CELLS + 1)
    bottom = triangles_at(X, tets, 2, 0.0)
    weight = BAR_DENSITY * STANDARD_GRAVITY * layer
    loads = []
    for number, height in enumerate(heights[:-1]):
        share = 0.5 if number == 0 else 1.0
        # The same triangles one layer up after another: cells number their vertices alike.
        loads.append(terms.Traction(bottom + number, np.array([0.0, 0.0, -share * weight])))
        assert np.allclose(X[bottom + number, 2], height)
    top = vertices_at(X, 2, BAR_HEIGHT)
    mu = BAR_YOUNG / 2.0
    stress = {
        NEO_HOOKEAN: lambda s: mu * (s - 1.0 / s),
        ST_VENANT: lambda s: mu * (s**3 - s),
    }

    def closed(law: str) -> Floats | None:
        if law not in stress:
            return None
        pulls = weight * (np.arange(BAR_CELLS) + 0.5)
        stretches = np.array([brentq(lambda s, t=t: stress[law](s) - t, 1.0, 2.0, xtol=1e-14) for t in pulls])
        drop = np.append(np.cumsum((stretches - 1.0)[::-1])[::-1] * layer, 0.0)
        x = np.array(X)
        x[:, 2] -= drop[np.searchsorted(heights, X[:, 2] - 1e-9)]
        return x

    return _make_problem(X, tets, top, X[top], loads, BAR_YOUNG, 0.0, np.arange(len(X)), closed=closed)


def cube(poisson: float, contrast: float = 1.0) -> Problem:
    """Make a cube of 40 mm whose top turns by 90 degrees over its bottom; one half is `contrast` times as stiff."""
    X, tets = block(8, 40.0)
    low, high = vertices_at(X, 2, 0.0), vertices_at(X, 2, 40.0)
    turn = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()
    centre = np.array([20.0, 20.0, 0.0])
    held = np.concatenate([low, high])
    places = np.concatenate([X[low], (X[high] - centre) @ turn.T + centre])
    problem = _make_problem(X, tets, held, places, [], FLESH_YOUNG, poisson, np.arange(len(X)))
    factor = np.where(X[tets].mean(axis=1)[:, 0] < 20.0, contrast, 1.0)
    return replace(problem, mu=problem.mu * factor, lmbda=problem.lmbda * factor)


def head(what: str, level: int) -> Problem:
    """Make the head's flesh with its skull held: under 2 g ("gravity"), or its jaw moved 5 mm down ("jaw").

    With the jaw, only bones hold the inner side.
    """
    layered = person(seed=None, level=level).head
    scene = facial_scene(layered, Parameters(), layered.skin.vertices, cells="tets")
    X, count = scene.vertices, len(layered.bone)
    inner = np.arange(len(X) - count, len(X))
    places, loads = np.array(X[inner]), []
    if what == "gravity":
        loads = [terms.Gravity(np.array([0.0, -2.0 * STANDARD_GRAVITY, 0.0]), TISSUE_DENSITY)]
    else:
        places[layered.bone == MANDIBLE, 1] -= 5.0
        inner, places = inner[layered.bone != FREE], places[layered.bone != FREE]
    return _make_problem(X, scene.tets, inner, places, loads, FLESH_YOUNG, FLESH_POISSON, np.arange(count))


def face(level: int, membrane: bool = True) -> Problem:
    """Make the mean face posed by Eq. 15: its skull in place, the jaw put by its bone, springs to an expression's skin.

    Muscle is as stiff as soft tissue, so that solvers of one material can take the flesh; `membrane` is Eq. 11.
    """
    someone, p = person(seed=None, level=level), Parameters(muscle_strain_ratio=1.0)
    choices: dict[str, Any] = {"bones": "prescribed", "without": () if membrane else ("skin",), "cells": "tets"}
    scene = facial_scene(someone.head, p, someone.shape(EXPRESSION), **choices)
    return Problem(**_read_face(scene), skin=np.arange(len(someone.head.bone)))


def pull_handles(head: LayeredHead, targets: Floats) -> Problem:
    """Make a head's tets held by handles: what a facial scene holds, and every 16th vertex of the skin wrap.

    The latter go where an expression's skin [mm], (n, 3), draws them, as markers of motion capture do.
    """
    scene = facial_scene(head, Parameters(), targets, cells="tets")
    held, places = scene.dirichlet()
    marks = np.arange(0, len(head.bone), EVERY)
    places[marks] = head.wrap_targets(targets)[marks]
    handles = np.union1d(np.flatnonzero(held.all(axis=1)), marks)
    mu, lmbda = np.ones(len(scene.tets)), np.zeros(len(scene.tets))
    vertices = np.arange(len(scene.vertices))
    return Problem(scene.vertices, scene.tets, handles, places[handles], [], mu, lmbda, vertices)


@dataclass(frozen=True)
class Case:
    """A problem by name, as rows have it; `quick` ones are solved without being asked for."""

    name: str
    make: Callable[[], Problem]
    quick: bool = True
    start_at_answer: bool = False
    """Whether solvers also start from FEniCSx' answer, which shows a bias."""
    quadratic: bool = False
    """Whether quadratic tets are solved too, in the whole study."""


SIZES = {1: "14.5 k tets", 2: "58 k tets"}
"""Size of the mesh, by the template's level."""


def _cases() -> tuple[Case, ...]:
    small, large = SIZES[1], SIZES[2]
    more = partial(Case, quick=False)
    return (
        Case("bar", bar, start_at_answer=True, quadratic=True),
        Case("cube twisted, nu 0.45", lambda: cube(0.45), quadratic=True),
        Case(f"head under 2 g, {small}", lambda: head("gravity", 1), start_at_answer=True, quadratic=True),
        Case(f"head's jaw opened, {small}", lambda: head("jaw", 1), quadratic=True),
        more("cube twisted, nu 0.3", lambda: cube(0.3), quadratic=True),
        more("cube twisted, nu 0.4999", lambda: cube(0.4999), quadratic=True),
        more("cube twisted, half 100 times as stiff", lambda: cube(0.45, 100.0), quadratic=True),
        more(f"head under 2 g, {large}", lambda: head("gravity", 2)),
        more(f"head's jaw opened, {large}", lambda: head("jaw", 2)),
        Case(f"face posed without its membrane, {small}", lambda: face(1, membrane=False)),
        Case(f"face posed by Eq. 15, {small}", lambda: face(1)),
    )


CASES = {case.name: case for case in _cases()}


@lru_cache(maxsize=4)
def make(case: str) -> Problem:
    """Make a problem once per process."""
    return CASES[case].make()


@lru_cache(maxsize=24)
def answer(problem: Problem, law: str, element: str = LINEAR) -> Floats:
    """Give FEniCSx' answer at the vertices [mm], (n, 3); SoftdecaError where it does not converge."""
    how = {"solver": "fenicsx", "element": element, "tolerance": TIGHT}
    return solve_to_end(problem.scene(law), f"{law} by FEniCSx, {element}", **how).positions


@lru_cache(maxsize=24)
def list_answers(problem: Problem, law: str, element: str = LINEAR) -> list[Floats]:
    """Give FEniCSx' answer, and projective dynamics' where its energy has another minimum; see `answer`."""
    answers = [answer(problem, law, element)]
    if law in (PROJECTIVE, RIGID) and element == LINEAR:
        by_pd = prepare(problem.scene(law)).solve(tolerance=TIGHT)
        if by_pd.converged and largest_distance(by_pd.positions, answers[0]) > ACCURACY:
            answers.append(by_pd.positions)
    return answers
