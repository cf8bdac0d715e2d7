"""The face that all tabs share, and its first answer to a change: at once, by what is known of p so far."""

from __future__ import annotations

import time
import warnings
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Floats32
from ...lhm.head import LayeredHead
from ...reference import Parameters
from ...reference.face.settle import carry_skin
from ...surrogate import BoundRig, Surrogate
from ...surrogate.codes import NearestPerson
from ...surrogate.methods import BLENDSHAPES, DERIVATIVES, NETWORK, NETWORK_AND_DERIVATIVES, PD
from ...surrogate.rig import FaceModes, check_shapes
from ...surrogate.ruler import MOVES
from ...surrogate.runtime import BoundSurrogate
from .messages import Change, DerivativesFound, Frame

NETWORK_SHARE, DERIVATIVES_SHARE = 0.21, 0.04
"""Typical errors of network and derivatives, as shares of the motion beyond scaled bones: see the model card."""
ELSEWHERE_SHARE = 0.45
"""The network's on heads that are none of its people, as ICT-FaceKit's in their triangles: see the model card."""
KEPT = 4
"""Parameter sets whose rigs are kept, of some 15 MB each."""


@dataclass(frozen=True, eq=False)
class LiveFace:
    """A head, what the 52 weights add to its skin (52, n, 3) [mm], p as the page begins, and who is nearest.

    `nearest` is one of the network's people; None for a head with other triangles, which no network knows.
    """

    head: LayeredHead
    shapes: Floats
    start: Parameters
    nearest: NearestPerson | None

    @classmethod
    def from_head(cls, head: LayeredHead, shapes: Floats, start: Parameters) -> LiveFace:
        """Find who is nearest to a head that has the triangles of the network's people."""
        nearest = Surrogate.load().find_nearest(head.skin)
        return cls(head, check_shapes(shapes, head.skin).astype(np.float64), start, nearest)

    @property
    def methods(self) -> tuple[str, str, str]:
        """The methods of its answers, each better than the one before."""
        return (BLENDSHAPES, DERIVATIVES, PD) if self.nearest is None else (NETWORK, NETWORK_AND_DERIVATIVES, PD)

    def blend(self, weights: Floats | Floats32) -> Floats:
        """Blend the shapes [mm], shape (n, 3), without p."""
        blended: Floats = self.head.skin.vertices + np.tensordot(weights.astype(np.float64), self.shapes, axes=1)
        return blended


class RigBinder:
    """Binds the network to a face and p, and the simulator's derivatives with it or alone."""

    def __init__(self, face: LiveFace):
        self._face = face
        self._network = None if face.nearest is None else Surrogate.load()

    def bind(self, parameters: Parameters) -> BoundRig | None:
        """Bind the network, in some 20 ms; None where it does not know the face."""
        if self._network is None or self._face.nearest is None:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of p a little beyond what it has seen: the nearest will do at first
            return self._network.bind(
                self._face.head.skin, self._face.nearest.code, parameters, expressions=self._face.shapes, beyond="clamp"
            )

    def bind_derivatives(self, found: DerivativesFound) -> BoundSurrogate:
        """Bind derivatives, and where the network knows the face what it adds to them."""
        rig = self.bind(found.parameters)
        if isinstance(rig, BoundSurrogate):
            return rig.with_derivatives(found.offset, found.responses)
        modes = FaceModes.linear(found.offset, found.responses)
        return BoundSurrogate(self._face.head.skin, modes, self._face.shapes.astype(np.float32))


@dataclass(frozen=True, eq=False)
class _Bound:
    """A rig under one p, the typical share of the motion that it leaves, and what bones carry the skin by."""

    method: str
    rig: BoundRig | None
    share: float | None
    carried: Floats


class FirstAnswer:
    """Answers changes at once: by the network, by blendshapes where there is none, by derivatives once they are found.

    One thread at a time may ask.
    """

    def __init__(self, face: LiveFace):
        self._face, self._binder = face, RigBinder(face)
        self._bound: OrderedDict[Parameters, _Bound] = OrderedDict()

    def frame(self, change: Change) -> Frame:
        """Answer a change; its error is a typical one of the method, so not certain."""
        begin = time.perf_counter()
        bound = self._bound.get(change.parameters) or self._bind(change.parameters)
        self._bound.move_to_end(change.parameters)
        blended = self._face.blend(change.weights)
        skin = blended.astype(np.float32) if bound.rig is None else bound.rig.frame(change.weights)
        error = mean = None
        if bound.share is not None:
            moved = np.linalg.norm(skin - blended - bound.carried, axis=1)
            counted = moves if (moves := moved > MOVES).any() else np.ones_like(moves)
            error, mean = (bound.share * moved).astype(np.float32), float(bound.share * moved[counted].mean())
        seconds = time.perf_counter() - begin
        return Frame(change.number, bound.method, skin, error, mean, certain=False, is_last=False, seconds=seconds)

    def learn(self, found: DerivativesFound) -> None:
        """Answer by these derivatives from now on, under their p."""
        carried = carry_skin(self._face.head, found.parameters)
        rig = self._binder.bind_derivatives(found)
        self._keep(found.parameters, _Bound(self._face.methods[1], rig, DERIVATIVES_SHARE, carried))

    def _bind(self, parameters: Parameters) -> _Bound:
        nearest, rig = self._face.nearest, self._binder.bind(parameters)
        carried = carry_skin(self._face.head, parameters)
        share = None if nearest is None else NETWORK_SHARE if nearest.is_same else ELSEWHERE_SHARE
        return self._keep(parameters, _Bound(self._face.methods[0], rig, share, carried))

    def _keep(self, parameters: Parameters, bound: _Bound) -> _Bound:
        self._bound[parameters] = bound
        while len(self._bound) > KEPT:
            self._bound.popitem(last=False)
        return bound
