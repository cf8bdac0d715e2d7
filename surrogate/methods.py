"""METHODS: every way to a frame, with the only labels, colours and marks of the house.

A method binds a face, live (`reference.face.Face`) or of a corpus (`KeptFace`), and gives a rig, which makes skins of
52 weights. Squares solve, circles use the network or derivatives, triangles are simple rivals. Methods that learn from
a corpus have a file each in `networks`; solvers of other packages have one in the arena.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..reference import Solution, prepare
from ..reference.face.correction import predict
from ..reference.face.derivatives import FRAME_ACCURACY, spring_norm
from ..reference.face.face import Face
from ..reference.face.facial import PD_ENERGY, FaceLaw
from .certified import ACCURACY, CertifiedFace
from .corpus.face import KeptFace
from .rigs.bound import BoundSurrogate
from .rigs.rig import CorrectedRig, FaceModes, Needs, Rig, check_out, check_weights
from .runtime import Beyond, BoundRig, Surrogate

PD, PD_PLAIN, PD_ANDERSON, PD_ARAP = "PD", "PD, plain", "PD, Anderson", "PD on ARAP"
PD_FIRST_ORDER = "PD, from first order"
FENICSX, FENICSX_P2, FENICSX_P2P1 = "FEniCSx", "FEniCSx, P2", "FEniCSx, P2-P1"
FENICSX_NEO_HOOKEAN = "FEniCSx, neo-Hookean"
SKFEM, SKFEM_NEO_HOOKEAN = "scikit-fem", "scikit-fem, neo-Hookean"
LIBIGL_ARAP = "libigl ARAP"
NETWORK, DERIVATIVES, NETWORK_AND_DERIVATIVES = "network", "derivatives", "network + derivatives"
NETWORK_ALIKE = "network, trained alike"
SETTLED, CARRIED, BLENDSHAPES = "settled + blendshapes", "bones carried", "blendshapes"
DIAL = "dial"
VERTICES_ONLY = "vertices only, z(w) L(p, h)"
SOFTDECA, SOFTDECA_OURS, FACE_WISE = "SoftDECA as printed", "SoftDECA, our form", "face-wise"
SOFTDECA_BEGUN, TABLES = "SoftDECA, our form, on the network's tables", "the network's tables alone"
SOFTSMPL_SMALL, SOFTSMPL_LARGE, SOFTSMPL_GRU = "SoftSMPL, small", "SoftSMPL, large", "SoftSMPL, dynamic (GRU)"
SNP = "SNP"

AnyFace = Face | KeptFace
Binder = Callable[[Any], Rig]
"""Binds any face; what has learned from a corpus binds kept ones alone."""


@dataclass(frozen=True)
class Method:
    """A way to frames; `colour` and `mark` are Matplotlib's."""

    name: str
    bind: Binder
    needs: Needs = "nothing"
    colour: str = "#000000"
    mark: str = "s"


def get_live(face: AnyFace) -> Face:
    """Return a face on a head; InputError for one of a corpus whose head nobody fits."""
    return face.live if isinstance(face, KeptFace) else face


def no_face(face: AnyFace) -> Rig:
    """Refuse every face: the method moves other scenes."""
    raise InputError("this method moves no face")


@dataclass(frozen=True, eq=False)
class SolvedRig:
    """Frames of a face's own shapes by what solves for the skin [mm], shape (n, 3), of weights (52,)."""

    skin: Surface
    solve: Callable[[Floats], Floats | Floats32]

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """Solve for a frame; see `Rig.frame`. InputError for `blended`, too, and what solving raises."""
        if blended is not None:
            raise InputError("blended: a solver moves the face's own shapes alone")
        known = check_weights(weights).astype(np.float64)
        surface = check_out(out, self.skin.vertices.shape)
        surface[:] = self.solve(known)
        return surface


def solved_by(solver: str, law: FaceLaw = PD_ENERGY, *, tolerance: float, **how: Any) -> Binder:
    """Return what binds a face to a solver, prepared at bind; `how` are options of `prepare`.

    Each frame begins at rest. One that does not converge raises InputError with the reason. Quadratic elements are
    those of a face's tets.
    """

    def bind(face: AnyFace) -> SolvedRig:
        live = get_live(face)
        if how.get("element", "P1") != "P1":
            live = replace(live, choices={**live.choices, "cells": "tets"})
        prepared = prepare(live.neutral_scene(law), solver=solver, **how)

        def solve(weights: Floats) -> Floats:
            solution = prepared.solve(live.scene(weights, law), tolerance=tolerance)
            return live.skin_after(weights, _check_converged(solver, solution).positions, law)

        return SolvedRig(live.skin, solve)

    return bind


def _check_converged(method: str, solution: Solution) -> Solution:
    if not solution.converged:
        raise InputError(f"{method}: {solution.reason}")
    return solution


def blend(face: AnyFace) -> CorrectedRig:
    """Bind T = S: the error of doing nothing."""
    return CorrectedRig(face.skin, face.shapes, lambda weights: np.float32(0.0))


def carry(face: AnyFace) -> CorrectedRig:
    """Bind T - S as scaled bones carry the neutral skin, whatever the expression."""
    carried = face.carried.astype(np.float32)
    return CorrectedRig(face.skin, face.shapes, lambda weights: carried)


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


def use_network(surrogate: Surrogate | None = None, *, exact: bool = False, beyond: Beyond = "refuse") -> Binder:
    """Return what binds a face to a network, by default the shipped one; with `exact` beside the derivatives."""

    def bind(face: AnyFace) -> BoundRig:
        network = Surrogate.load() if surrogate is None else surrogate
        return network.bind_face(face, exact=exact, beyond=beyond)

    return bind


def use_dial(accuracy: float = ACCURACY) -> Binder:
    """Return what binds a face to the dial, at an accuracy [mm]."""

    def bind(face: AnyFace) -> SolvedRig:
        certified = certify(get_live(face))
        return SolvedRig(certified.skin, lambda weights: certified.frame(weights, accuracy).skin)

    return bind


def start_at_first_order(face: AnyFace) -> SolvedRig:
    """Bind PD whose frames begin at the first order and go on by the PD matrix, as a corpus makes them."""
    live = get_live(face)
    prepared = live.derivatives.prepared

    def solve(weights: Floats) -> Floats:
        scene = live.scene(weights)
        stop = FRAME_ACCURACY * spring_norm(scene)
        solution = prepared.solve(scene, start=predict(live, weights), absolute=stop, untangle=False)
        return live.skin_after(weights, _check_converged(PD_FIRST_ORDER, solution).positions)

    return SolvedRig(live.skin, solve)


def simulate(name: str, bind: Binder, colour: str, mark: str = "s") -> Method:
    """Make a method that needs the simulator."""
    return Method(name, bind, "simulator", colour, mark)


METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        simulate(PD, solved_by("projective", tolerance=1e-8), "#1f77b4"),
        simulate(PD_PLAIN, solved_by("projective", tolerance=1e-6, method="plain"), "#aec7e8"),
        simulate(PD_ANDERSON, solved_by("projective", tolerance=1e-8, method="anderson"), "#6b8fd6"),
        simulate(PD_ARAP, no_face, "#c5b0d5"),
        simulate(PD_FIRST_ORDER, start_at_first_order, "#4c3f91"),
        simulate(FENICSX, solved_by("fenicsx", tolerance=1e-10), "#d62728"),
        simulate(FENICSX_P2, solved_by("fenicsx", tolerance=1e-10, element="P2"), "#8c1a1a"),
        simulate(FENICSX_P2P1, solved_by("fenicsx", tolerance=1e-10, element="P2P1"), "#a0522d"),
        simulate(FENICSX_NEO_HOOKEAN, solved_by("fenicsx", "neo-Hookean", tolerance=1e-10), "#8c564b"),
        simulate(SKFEM, solved_by("skfem", tolerance=1e-10), "#c49c94"),
        simulate(SKFEM_NEO_HOOKEAN, solved_by("skfem", "neo-Hookean", tolerance=1e-10), "#7a5c52"),
        simulate(LIBIGL_ARAP, no_face, "#2ca02c"),
        Method(NETWORK, use_network(), colour="#17becf", mark="o"),
        simulate(DERIVATIVES, differentiate, "#006d5b", "o"),
        simulate(NETWORK_AND_DERIVATIVES, use_network(exact=True), "#7a7a00", "o"),
        simulate(DIAL, use_dial(), "#222222", "D"),
        simulate(SETTLED, rest, "#9467bd", "^"),
        Method(CARRIED, carry, "head", colour="#e377c2", mark="^"),
        Method(BLENDSHAPES, blend, colour="#ff7f0e", mark="^"),
    )
}
"""Every way to a frame, by its label."""
_added: dict[str, Method] = {}
READY = (NETWORK, NETWORK_AND_DERIVATIVES, DERIVATIVES, SETTLED, CARRIED, BLENDSHAPES)
"""Methods at the price of blendshapes that learn nothing from a corpus."""


def bind_cheaply(face: Face, surrogate: Surrogate, *, beyond: Beyond = "refuse") -> tuple[str, BoundRig]:
    """Bind a face by what serves its head at the price of blendshapes; returns the method's label, too.

    The network where the head is one of its people, with derivatives besides where it has their triangles; derivatives
    alone on other heads.
    """
    nearest = surrogate.find_nearest(face.skin)
    if nearest is None:
        return DERIVATIVES, differentiate(face)
    rig = surrogate.bind_face(face, exact=not nearest.is_same, beyond=beyond)
    return NETWORK if nearest.is_same else NETWORK_AND_DERIVATIVES, rig


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

    Without a surrogate the network's methods are left out. `beyond` is what the network does with p out of its range.
    """
    ready = {name: METHODS[name] for name in READY}
    networks = {NETWORK: False, NETWORK_AND_DERIVATIVES: True} if surrogate is not None else {}
    for name, exact in networks.items():
        ready[name] = replace(METHODS[name], bind=use_network(surrogate, exact=exact, beyond=beyond))
    if surrogate is None:
        del ready[NETWORK]
    if surrogate is None or not surrogate.has_derivatives:
        del ready[NETWORK_AND_DERIVATIVES]
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
