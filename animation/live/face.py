"""The face that all tabs share, and its first answer to a change: at once, by what is known of p so far."""

from __future__ import annotations

import time
import warnings
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from ...lhm.base.mesh import Floats
from ...reference import Face, Parameters
from ...surrogate import BoundRig, BoundSurrogate, Surrogate
from ...surrogate.methods import (
    BLENDSHAPES,
    DERIVATIVES,
    HYPERNETWORK,
    METHODS,
    NETWORK,
    NETWORK_AND_DERIVATIVES,
    PD,
    name_network,
)
from ...surrogate.rigs.rig import FaceModes, Rig
from ...surrogate.ruler import MOVES
from .messages import Change, DerivativesFound, Frame

# [[[cog
# from figures import *
# show_typical_errors("TYPICAL", "surrogate/fresh", "all")
# show_typical_errors("ELSEWHERE", "surrogate/moving", "external")
# ]]]
TYPICAL = {NETWORK: 0.178, HYPERNETWORK: 0.180, NETWORK_AND_DERIVATIVES: 0.045, DERIVATIVES: 0.055}
ELSEWHERE = {NETWORK: 0.482, HYPERNETWORK: 0.482, NETWORK_AND_DERIVATIVES: 0.062, DERIVATIVES: 0.064}
# [[[end]]]
"""Shares of the motion beyond scaled bones that methods leave: on its people, and on heads of their triangles alone."""
KEPT = 4
"""Parameter sets whose rigs are kept, of some 15 MB each."""


def list_methods(face: Face, network: Surrogate) -> tuple[str, str, str]:
    """Name the methods of a face's answers, each better than the one before; the network gives the first."""
    if not network.knows(face.skin):
        return BLENDSHAPES, DERIVATIVES, PD
    return name_network(network), NETWORK_AND_DERIVATIVES, PD


@dataclass(frozen=True, eq=False)
class _Answering:
    """Answers under one p: a rig, the typical share of the motion that it leaves, and how bones carry the skin."""

    method: str
    rig: Rig
    share: float | None
    carried: Floats


class FirstAnswer:
    """Answers changes at once: by a network, by blendshapes where there is none, by derivatives once they are found.

    To these the shipped network adds. One thread at a time may ask.
    """

    def __init__(self, face: Face, network: Surrogate):
        self._network = network
        nearest = network.find_nearest(face.skin)
        self._face = face if nearest is None else replace(face, code=nearest.code)
        self._shares = TYPICAL if nearest is not None and nearest.is_same else ELSEWHERE
        self._methods = list_methods(face, network)
        self._known: OrderedDict[Parameters, _Answering] = OrderedDict()

    def frame(self, change: Change) -> Frame:
        """Answer a change; its error is a typical one of the method, so not certain."""
        begin = time.perf_counter()
        known = self._known.get(change.parameters) or self._bind(change.parameters)
        self._known.move_to_end(change.parameters)
        skin = known.rig.frame(change.weights)
        error = mean = None
        if known.share is not None:
            blended = self._face.blend(change.weights.astype(np.float64))
            motion = np.linalg.norm(skin - blended - known.carried, axis=1)
            moving = motion[motion > MOVES] if (motion > MOVES).any() else motion
            error, mean = (known.share * motion).astype(np.float32), float(known.share * moving.mean())
        seconds = time.perf_counter() - begin
        return Frame(change.number, known.method, skin, error, mean, certain=False, is_last=False, seconds=seconds)

    def learn(self, found: DerivativesFound) -> None:
        """Answer by these derivatives from now on, under their p."""
        face = replace(self._face, parameters=found.parameters)
        rig = _bind_network(face, Surrogate.load()) if self._methods[1] == NETWORK_AND_DERIVATIVES else None
        if isinstance(rig, BoundSurrogate):
            rig = rig.with_derivatives(found.offset, found.responses)
        else:
            modes = FaceModes.linear(found.offset, found.responses)
            rig = BoundSurrogate(face.skin, modes, face.shapes.astype(np.float32))
        self._keep(face, rig, self._methods[1])

    def _bind(self, parameters: Parameters) -> _Answering:
        face = replace(self._face, parameters=parameters)
        method = self._methods[0]
        rig = METHODS[BLENDSHAPES].bind(face) if method == BLENDSHAPES else _bind_network(face, self._network)
        return self._keep(face, rig, method)

    def _keep(self, face: Face, rig: Rig, method: str) -> _Answering:
        answering = _Answering(method, rig, self._shares.get(method), face.carried)
        self._known[face.parameters] = answering
        while len(self._known) > KEPT:
            self._known.popitem(last=False)
        return answering


def _bind_network(face: Face, network: Surrogate) -> BoundRig:
    """Bind a network, in some 20 ms."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of p a little beyond what it has seen: the nearest will do at first
        return network.bind_face(face, beyond="clamp")
