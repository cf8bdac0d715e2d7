"""Better answers to a change, one after another: the simulator's derivatives, then the simulator on its way.

Each tells how far the converged simulator is estimated to be; see `surrogate.certified`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ...lhm.base.errors import SceneError
from ...reference import Face, Parameters
from ...surrogate import CertifiedFace, Surrogate, certify
from ...surrogate.methods import DERIVATIVES, NETWORK_AND_DERIVATIVES, PD
from .messages import Change, DerivativesFound, Frame

ENOUGH = 3e-5
"""[mm] Mean error of the last answer: no vertex is then off by a hundredth of a millimetre."""

IsSuperseded = Callable[[], bool]


class SupersededError(Exception):
    """A newer change has come."""


class Refinement:
    """Refines answers about one face, in contact; what it prepared for a p serves all expressions under it."""

    def __init__(self, face: Face):
        self._face, self._network = face.in_contact(), Surrogate.load()
        self._now: tuple[Parameters, CertifiedFace] | None = None

    def is_prepared_for(self, parameters: Parameters) -> bool:
        """Return whether derivatives under this p are there."""
        return self._now is not None and self._now[0] == parameters

    def prepare(self, parameters: Parameters, is_superseded: IsSuperseded) -> DerivativesFound:
        """Settle and differentiate the face under p, in seconds.

        SupersededError as soon as it is; InputError for a face that does not settle, and what the simulator raises.
        """
        self._now = None  # before another is made: a factor is an eighth of a gigabyte
        face = replace(self._face, parameters=parameters, on_iteration=lambda *_: _check(is_superseded))
        self._now = parameters, certify(face, self._network)
        offset, responses = (array.astype(np.float32) for array in (face.offset, face.responses))
        return DerivativesFound(parameters, offset, responses)

    def frames(self, change: Change, is_superseded: IsSuperseded) -> Iterator[Frame]:
        """Answer a change under the p that was prepared, better and better, until the simulator has converged.

        SupersededError between two frames as soon as it is; SceneError where the simulator does not converge.
        """
        if self._now is None or not self.is_prepared_for(change.parameters):
            raise SceneError("refinement: prepare the parameters first")
        begin = time.perf_counter()
        for frame in self._now[1].improve(change.weights):
            _check(is_superseded)
            has_converged = frame.method == "converged" or frame.bound <= ENOUGH
            yield Frame(
                change.number,
                frame.method if frame.method in (DERIVATIVES, NETWORK_AND_DERIVATIVES) else PD,
                frame.skin,
                frame.errors,
                frame.error,
                certain=frame.certain,
                is_last=has_converged,
                seconds=time.perf_counter() - begin,
                crossings=self._face.count_crossings(frame.skin),
            )
            if has_converged:
                return
        raise SceneError("the simulator has not converged; what is shown may be far off")


def _check(is_superseded: IsSuperseded) -> None:
    if is_superseded():
        raise SupersededError
