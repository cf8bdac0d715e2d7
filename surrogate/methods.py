"""METHODS: every way to a frame, with the only labels, colours and marks of the house.

A method binds a face, live (`reference.face.Face`) or of a corpus (`KeptFace`), and gives a rig, which makes skins of
52 weights. A `Solver` solves any scene besides. Squares solve, circles use the network or derivatives, triangles are
simple rivals. Methods that learn from a corpus have a file each in `networks`; solvers of other packages have one in
the arena.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..reference import Solution, prepare
from ..reference.face.correction import predict
from ..reference.face.derivatives import FRAME_ACCURACY, spring_norm
from ..reference.face.face import Face
from ..reference.face.facial import PD_ENERGY, FaceLaw
from ..reference.face.settle import SettledFace
from ..reference.face.tissue import CellKind
from .certified import ACCURACY, CertifiedFace
from .corpus.face import KeptFace
from .corpus.plan import CorpusPlan
from .corpus.reading import Faces
from .corpus.simulator import solve_frame
from .networks.hypernetwork import Hypernetwork
from .rigs.bound import BoundSurrogate
from .rigs.rig import CorrectedRig, FaceModes, Needs, Rig, check_out, check_weights
from .runtime import Beyond, BoundRig, Surrogate

PD, PD_TETS, PD_PLAIN, PD_ANDERSON = "PD", "PD, tets", "PD, plain", "PD, Anderson"
PD_FIRST_ORDER, PD_AS_TRAINED = "PD, from first order", "PD, to the corpus' tolerance"
FENICSX, FENICSX_TETS = "FEniCSx", "FEniCSx, tets"
FENICSX_P2, FENICSX_P2P1 = "FEniCSx, P2", "FEniCSx, P2-P1"
FENICSX_NEO_HOOKEAN = "FEniCSx, neo-Hookean"
SKFEM, SKFEM_P2, SKFEM_NEO_HOOKEAN = "scikit-fem", "scikit-fem, P2", "scikit-fem, neo-Hookean"
NETWORK, DERIVATIVES, NETWORK_AND_DERIVATIVES = "network", "derivatives", "network + derivatives"
HYPERNETWORK = Hypernetwork.kind
NETWORK_ALIKE = "network, trained alike"
SETTLED, CARRIED, BLENDSHAPES = "settled + blendshapes", "bones carried", "blendshapes"
DIAL = "dial"
VERTICES_ONLY = "vertices only, z(w) L(p, h)"
SOFTDECA, SOFTDECA_OURS, FACE_WISE = "SoftDECA as printed", "SoftDECA, our form", "face-wise"
SOFTDECA_ON_TABLES, TABLES = "SoftDECA, our form, on the network's tables", "the network's tables alone"
SOFTSMPL_SMALL, SOFTSMPL_LARGE, SOFTSMPL_GRU = "SoftSMPL, small", "SoftSMPL, large", "SoftSMPL, dynamic (GRU)"
SNP = "SNP"

ROUGH = 1e-6
"""Tolerance of PD's answer that other solvers start at: what is left of the gradient must be more than rounding."""

AnyFace = Face | KeptFace
Binder = Callable[[Any], Rig]
"""Binds any face; what has learned from a corpus binds kept ones alone."""


@dataclass(frozen=True)
class Solver:
    """A solver of any scene: options of `prepare`, with the solver's name.

    law: of the tissue. near: it starts at PD's answer to ROUGH, to which it is near. tolerance: gradient norm relative
    to that at the start.
    """

    how: Mapping[str, Any]
    law: FaceLaw = PD_ENERGY
    tolerance: float = 1e-10
    near: bool = False


@dataclass(frozen=True)
class Method:
    """A way to frames; `colour` and `mark` are Matplotlib's.

    cells: those of the face that it moves, whatever cells the face had; None takes them as they are. solver: what
    solves other scenes likewise, if anything does.
    """

    name: str
    bind: Binder
    needs: Needs = "nothing"
    colour: str = "#000000"
    mark: str = "s"
    cells: CellKind | None = None
    solver: Solver | None = None


class Learns(Protocol):
    """A method that learns from a corpus' training faces before it binds others."""

    needs: Needs

    def fit(self, faces: Faces) -> None:
        """Learn."""
        ...

    def bind(self, face: KeptFace, /) -> Rig:
        """Bind a face."""
        ...


def get_live(face: AnyFace) -> Face:
    """Return a face on a head; InputError for one of a corpus whose head nobody fits."""
    return face.live if isinstance(face, KeptFace) else face


def no_face(face: AnyFace) -> Rig:
    """Refuse every face: nobody has said how the method binds one."""
    raise InputError("this method moves no face")


def on_cells(face: AnyFace, cells: CellKind | None) -> AnyFace:
    """Return a live face with other cells; one of a corpus, and one that has them, stay as they are."""
    if cells is None or isinstance(face, KeptFace) or get_cells(face) == cells:
        return face
    return replace(face, choices={**face.choices, "cells": cells})


def get_cells(face: AnyFace) -> CellKind:
    """Return the cells of a face's scenes."""
    cells: CellKind = face.cells if isinstance(face, KeptFace) else face.choices.get("cells", "prisms")
    return cells


@dataclass(frozen=True, eq=False)
class Solved:
    """A frame that was solved for: skin (n, 3) [mm], the scene's vertices (k, 3) [mm], and what its solver told.

    solution: of the scene, if one solve made it.
    """

    skin: Floats | Floats32
    positions: Floats
    told: Mapping[str, Any]
    solution: Solution | None = None


@dataclass(eq=False)
class SolvedRig:
    """Frames of a face's own shapes by what solves for them, of weights (52,); `last` is the latest.

    settled: the neutral face of a solver that has settled it by itself.
    """

    skin: Surface
    solve: Callable[[Floats], Solved]
    settled: SettledFace | None = None
    last: Solved | None = None

    def __reduce__(self):
        raise InputError("a rig that solves its frames cannot be copied or pickled; pickle its face, and bind it there")

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """Solve for a frame; see `Rig.frame`. InputError for `blended`, too, and what solving raises."""
        if blended is not None:
            raise InputError("blended: a solver moves the face's own shapes alone")
        known = check_weights(weights).astype(np.float64)
        surface = check_out(out, self.skin.vertices.shape)
        self.last = self.solve(known)
        surface[:] = self.last.skin
        return surface


def use_solver(solver: Solver, cells: CellKind | None = None) -> Callable[[Any], SolvedRig]:
    """Return what binds a face to a solver, prepared at bind; the face settles by the same solver, law and tolerance.

    Each frame begins at the settled face, or at PD's answer where the solver is near it. One that does not converge
    raises InputError with the reason. Quadratic elements are those of a face's tets.
    """

    def bind(face: AnyFace) -> SolvedRig:
        live, law = get_live(face), solver.law
        settling = {"solver": solver.how["solver"], "tolerance": solver.tolerance}
        if "element" in solver.how:
            settling["element"] = solver.how["element"]
        # It has prisms where the face has them.
        by_pd = use_solver(Solver({"solver": "projective"}, tolerance=ROUGH))(live) if solver.near else None
        if by_pd is not None and by_pd.settled is not None and law == PD_ENERGY:
            settling["start"] = by_pd.settled.positions
        own = replace(get_live(on_cells(live, cells)), settling=settling)
        settled = own.settled(law)
        if not settled.converged:
            raise InputError(f"the neutral face does not settle ({settled.reason})")
        prepared = prepare(own.neutral_scene(law), **solver.how)

        def solve(weights: Floats) -> Solved:
            start = settled.positions
            if by_pd is not None:
                near = by_pd.solve(weights)
                start = start if law != PD_ENERGY and near.told["inverted"] else near.positions
            solution = prepared.solve(own.scene(weights, law), start=start, tolerance=solver.tolerance)
            return tell_solution(own, weights, solution, law)

        return SolvedRig(own.skin, solve, settled)

    return bind


def tell_solution(face: Face, weights: Floats, solution: Solution, law: FaceLaw = PD_ENERGY) -> Solved:
    """Return the frame of a solution; InputError for one that has not converged."""
    if not solution.is_balanced:
        raise InputError(str(solution.reason))
    told = {
        "iterations": solution.iterations,
        "linear_iterations": solution.detail.get("linear_iterations"),
        "reason": solution.reason.name,
        "inverted": int(np.count_nonzero(solution.volume_ratio <= 0.0)),
    }
    return Solved(face.skin_after(weights, solution.positions, law), solution.positions, told, solution)


def blend(face: AnyFace) -> CorrectedRig:
    """Bind T = S: the error of doing nothing."""
    return CorrectedRig(face.skin, face.shapes, partial(_always, np.float32(0.0)))


def carry(face: AnyFace) -> CorrectedRig:
    """Bind T - S as scaled bones carry the neutral skin, whatever the expression."""
    return CorrectedRig(face.skin, face.shapes, partial(_always, face.carried.astype(np.float32)))


def _always(added: Any, weights: Floats32) -> Any:
    return added


def rest(face: AnyFace) -> BoundSurrogate:
    """Bind T - S as the neutral face settles, whatever the expression."""
    return _bind_linear(face, np.zeros(face.shapes.shape, dtype=np.float32))


def differentiate(face: AnyFace) -> BoundSurrogate:
    """Bind one factor and 52 solves, then blendshapes: the simulator to first order."""
    return _bind_linear(face, face.responses.astype(np.float32))


def _bind_linear(face: AnyFace, responses: Floats32) -> BoundSurrogate:
    modes = FaceModes.linear(face.offset.astype(np.float32), responses)
    swing = face.swing if isinstance(face, Face) else None
    return BoundSurrogate(face.skin, modes, face.shapes.astype(np.float32), swing)


def use_network(surrogate: Surrogate | str = NETWORK, *, exact: bool = False, beyond: Beyond = "refuse") -> Binder:
    """Return what binds a face to a network, or to one that is shipped by name; with `exact` beside the derivatives."""

    def bind(face: AnyFace) -> BoundRig:
        network = Surrogate.load(surrogate) if isinstance(surrogate, str) else surrogate
        return network.bind_face(on_cells(face, network.weights.note.cells), exact=exact, beyond=beyond)

    return bind


def use_dial(accuracy: float = ACCURACY) -> Binder:
    """Return what binds a face to the dial, at an accuracy [mm]."""

    def bind(face: AnyFace) -> SolvedRig:
        certified = certify(get_live(face))

        def solve(weights: Floats) -> Solved:
            frame = certified.frame(weights, accuracy)
            told = {"error": frame.error, "certain": frame.certain, "method": frame.method, "iterations": frame.solves}
            return Solved(frame.skin, frame.positions, told)

        return SolvedRig(certified.skin, solve)

    return bind


def start_at_first_order(accuracy: float = FRAME_ACCURACY) -> Binder:
    """Return what binds PD whose frames begin at the first order and go on by the PD matrix.

    accuracy: gradient norm, relative to that of the targets' springs each 1 mm long.
    """

    def bind(face: AnyFace) -> SolvedRig:
        live = get_live(face)
        prepared = live.derivatives.prepared

        def solve(weights: Floats) -> Solved:
            scene, start = live.scene(weights), predict(live, weights)
            stop = accuracy * spring_norm(scene)
            return tell_solution(live, weights, prepared.solve(scene, start=start, absolute=stop, untangle=False))

        return SolvedRig(live.skin, solve)

    return bind


def solve_as_corpora(face: AnyFace) -> SolvedRig:
    """Bind PD as corpora make their frames, to the tolerance of their plans."""
    live, plan = get_live(face), CorpusPlan()
    _ = live.first_order

    def solve(weights: Floats) -> Solved:
        return tell_solution(live, weights, solve_frame(plan, live, weights))

    return SolvedRig(live.skin, solve)


def simulate(name: str, bind: Binder, colour: str, mark: str = "s", cells: CellKind | None = None) -> Method:
    """Make a method that needs the simulator; with `cells` it moves faces of these alone."""
    return Method(name, lambda face: bind(on_cells(face, cells)), "simulator", colour, mark, cells)


def solve_by(
    name: str,
    solver: str,
    colour: str,
    *,
    law: FaceLaw = PD_ENERGY,
    tolerance: float = 1e-10,
    near: bool = False,
    cells: CellKind | None = None,
    **how: Any,
) -> Method:
    """Make a method of a solver; `how` are its options of `prepare`, the others those of `Solver` and `Method`."""
    known = Solver({"solver": solver, **how}, law, tolerance, near)
    return Method(name, use_solver(known, cells), "simulator", colour, "s", cells, known)


def solve_law(law: str, solver: str = FENICSX) -> Method:
    """Return the method that solves faces of a law by FEniCSx or scikit-fem, such as one that a file has added."""
    name = f"{solver}, {law}"
    how = {FENICSX: "fenicsx", SKFEM: "skfem"}[solver]
    return METHODS[name] if name in METHODS else solve_by(name, how, "#b8860b", law=law, near=True)


NEO_HOOKEAN = "neo-Hookean"
METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        solve_by(PD, "projective", "#1f77b4", tolerance=1e-8),
        solve_by(PD_TETS, "projective", "#7fb2d9", tolerance=1e-8, cells="tets"),
        solve_by(PD_PLAIN, "projective", "#aec7e8", tolerance=1e-6, method="plain"),
        solve_by(PD_ANDERSON, "projective", "#6b8fd6", tolerance=1e-8, method="anderson"),
        simulate(PD_FIRST_ORDER, start_at_first_order(), "#4c3f91"),
        simulate(PD_AS_TRAINED, solve_as_corpora, "#9a8fd1"),
        solve_by(FENICSX, "fenicsx", "#d62728"),
        solve_by(FENICSX_TETS, "fenicsx", "#f0908f", cells="tets"),
        solve_by(FENICSX_P2, "fenicsx", "#8c1a1a", tolerance=1e-6, near=True, cells="tets", element="P2"),
        solve_by(
            FENICSX_P2P1, "fenicsx", "#a0522d", law=NEO_HOOKEAN, tolerance=1e-6, near=True, cells="tets", element="P2P1"
        ),
        solve_by(FENICSX_NEO_HOOKEAN, "fenicsx", "#8c564b", law=NEO_HOOKEAN, near=True),
        solve_by(SKFEM, "skfem", "#c49c94", tolerance=1e-4, near=True),
        solve_by(SKFEM_P2, "skfem", "#b08a82", tolerance=1e-6, near=True, cells="tets", element="P2"),
        solve_by(SKFEM_NEO_HOOKEAN, "skfem", "#7a5c52", law=NEO_HOOKEAN, near=True),
        Method(NETWORK, use_network(), colour="#17becf", mark="o", cells="prisms"),
        Method(HYPERNETWORK, use_network(HYPERNETWORK), colour="#2ca02c", mark="o", cells="prisms"),
        simulate(DERIVATIVES, differentiate, "#006d5b", "o"),
        Method(NETWORK_AND_DERIVATIVES, use_network(exact=True), "simulator", "#7a7a00", "o", cells="prisms"),
        simulate(DIAL, use_dial(), "#222222", "D"),
        simulate(SETTLED, rest, "#9467bd", "^"),
        Method(CARRIED, carry, "head", colour="#e377c2", mark="^"),
        Method(BLENDSHAPES, blend, colour="#ff7f0e", mark="^"),
    )
}
"""Every way to a frame, by its label.

Solvers without a mesh in their label take the face's own cells, by default prisms. The networks have learned the
simulator of prisms, and move faces of prisms.
"""
_added: dict[str, Method] = {}
READY = (NETWORK, HYPERNETWORK, NETWORK_AND_DERIVATIVES, DERIVATIVES, SETTLED, CARRIED, BLENDSHAPES)
"""Methods at the price of blendshapes that learn nothing from a corpus."""


def bind_cheaply(face: Face, surrogate: Surrogate, *, beyond: Beyond = "refuse") -> tuple[str, BoundRig]:
    """Bind a face by what serves its head at the price of blendshapes; returns the method's label, too.

    The network where the head is one of its people, with derivatives besides where it has their triangles; derivatives
    alone on other heads.
    """
    nearest = surrogate.find_nearest(face.skin)
    if nearest is None:
        return DERIVATIVES, differentiate(face)
    rig, name = surrogate.bind_face(face, exact=not nearest.is_same, beyond=beyond), name_network(surrogate)
    return name if nearest.is_same else f"{name} + {DERIVATIVES}", rig


def name_network(surrogate: Surrogate) -> str:
    """Return the label of a network: a hypernetwork's, or that of any other."""
    return HYPERNETWORK if surrogate.weights.kind == Hypernetwork.kind else NETWORK


def add_method(method: Method) -> Method:
    """Let `softdeca evaluate` score a method of a file of one's own. InputError for a label that is taken."""
    if method.name in METHODS or method.name in _added:
        raise InputError(f"method {method.name!r} is there already")
    _added[method.name] = method
    return method


def get_method(name: str) -> Method:
    """Return the method of a label, or for another label one that binds no face, as figures need it."""
    return METHODS.get(name) or _added.get(name) or Method(name, no_face)


def ready_methods(surrogate: Surrogate | None, *, beyond: Beyond = "refuse") -> dict[str, Method]:
    """Return READY with the weights of a surrogate, less what these cannot do, and the methods that were added.

    Without a surrogate the networks' methods are left out; the hypernetwork stands beside the shipped network alone.
    `beyond` is what a network does with p out of its range.
    """
    networks: dict[str, Surrogate] = {}
    if surrogate is not None:
        networks[NETWORK] = surrogate
        if surrogate is Surrogate.load():
            networks[HYPERNETWORK] = Surrogate.load(HYPERNETWORK)
        if surrogate.has_derivatives:
            networks[NETWORK_AND_DERIVATIVES] = surrogate
    ready = {}
    for name in READY:
        method = METHODS[name]
        if name in networks:
            exact, network = name == NETWORK_AND_DERIVATIVES, networks[name]
            bind, needs = use_network(network, exact=exact, beyond=beyond), method.needs if exact else network.needs
            method = replace(method, bind=bind, cells=network.weights.note.cells, needs=needs)
        elif name in (NETWORK, HYPERNETWORK, NETWORK_AND_DERIVATIVES):
            continue
        ready[name] = method
    return ready | _added


def certify(face: Face, surrogate: Surrogate | None = None) -> CertifiedFace:
    """Bind a face that tells each frame's error to the simulator; some seconds.

    The surrogate, by default the shipped one, adds what is not linear where it is modal and can be bound to the head
    and the parameters; elsewhere it is left out. Raises what the simulator raises.
    """
    network = Surrogate.load() if surrogate is None else surrogate
    if network.has_derivatives and network.knows(face.skin):
        with suppress(InputError):  # a skin unlike its people's, or parameters beyond what it has seen
            rig = network.bind_face(face, exact=True)
            if isinstance(rig, BoundSurrogate):
                return CertifiedFace(face, rig, NETWORK_AND_DERIVATIVES)
    return CertifiedFace(face, differentiate(face), DERIVATIVES)
