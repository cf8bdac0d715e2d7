"""Gates of a head as it moves: tets inverted when the simulated jaw opens and the lids close."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...lhm import expressions
from ...lhm.check import Figure
from ...lhm.head import LayeredHead
from ...lhm.membranes import BLINK, OPEN
from .. import Parameters, facial_scene, solve

INVERTED = 100
"""Random identities and scans of levels 1 and 2: 0 to 68. Sealed lips alone may stay below it: `jaw_open_torn` tells
those."""
GATES = (("jaw_open_inverted_tets", OPEN), ("blink_inverted_tets", BLINK))


def check_posed_head(head: LayeredHead) -> tuple[Figure, ...]:
    """Tets inverted in jawOpen and in both blinks, each at full weight by the head's own rig; none without one."""
    if head.rig is None:
        return ()
    known = set(expressions.ARKIT) - set(head.rig.missing)
    return tuple(
        Figure(name, _inverted(head, names) if set(names) <= known else None, "", "at most", INVERTED)
        for name, names in GATES
    )


def _inverted(head: LayeredHead, names: Sequence[str]) -> int:
    shape = head.expression(expressions.weights_of(dict.fromkeys(names, 1.0)))
    solution = solve(facial_scene(head, Parameters(), shape), solver="projective")
    return int(np.count_nonzero(~(solution.volume_ratio > 0.0)))
