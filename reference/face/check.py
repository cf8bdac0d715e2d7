"""Gates of a head as it moves: `lhm.head.gates.check_posed` with the fast simulator."""

from __future__ import annotations

from ...lhm.head.gates import Figure, check_posed
from ...lhm.head.head import LayeredHead
from .. import Parameters, facial_scene, solve


def check_posed_head(head: LayeredHead) -> tuple[Figure, ...]:
    """Count the tets inverted in jawOpen and in both blinks, simulated; none without a rig."""
    return check_posed(head, lambda skin: solve(facial_scene(head, Parameters(), skin)).volume_ratio)
