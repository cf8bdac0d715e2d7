"""Expressions that a rig is likely to be asked for, by which its shapes are chosen and compressed."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..lhm.base.mesh import Floats32
from ..lhm.expressions import conversation
from ..lhm.expressions.made_up import combinations

APART = 8
"""Frames of a conversation: those in a row hardly differ."""


@cache
def usual_expressions(seed: int, count: int) -> Floats32:
    """Weights (2 count, 52): every APART-th frame of a made-up conversation, then random combinations."""
    talked = conversation(np.random.default_rng([seed, 0]), APART * count)[::APART]
    random = combinations(np.random.default_rng([seed, 1]), count)
    found: Floats32 = np.concatenate([talked, random]).astype(np.float32)
    found.flags.writeable = False
    return found
