"""Random expressions: a few shapes at a time, mostly symmetric, none that contradict another; still, or as a take."""

from __future__ import annotations

import numpy as np

from ..arkit import ARKIT
from ..base.checks import check_arguments
from ..base.mesh import Floats
from .blending import index
from .take import check_frames

UNITS: tuple[tuple[str, ...], ...] = (
    *(
        (f"{name}Left", f"{name}Right")
        for name in (
            "browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookUp eyeSquint eyeWide mouthDimple mouthFrown "
            "mouthLowerDown mouthPress mouthSmile mouthStretch mouthUpperUp noseSneer"
        ).split()
    ),
    ("eyeLookOutLeft", "eyeLookInRight"),
    ("eyeLookInLeft", "eyeLookOutRight"),
    *(
        (name,)
        for name in (
            "browInnerUp cheekPuff jawForward jawLeft jawRight mouthClose mouthFunnel mouthLeft mouthPucker mouthRight "
            "mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper tongueOut"
        ).split()
    ),
)
"""What is drawn together: a symmetric pair, the two eyes looking to one side, or a shape of its own."""

CONTRADICTORY = (
    ("browDown", "browOuterUp"),
    ("browDown", "browInnerUp"),
    ("eyeBlink", "eyeWide"),
    ("eyeSquint", "eyeWide"),
    ("eyeLookDown", "eyeLookUp"),
    ("eyeLookOutLeft", "eyeLookInLeft"),
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("mouthSmile", "mouthFrown"),
    ("mouthSmile", "mouthPucker"),
    ("mouthSmile", "mouthFunnel"),
    ("mouthStretch", "mouthPucker"),
    ("mouthStretch", "mouthFunnel"),
    ("mouthPucker", "mouthFunnel"),
    ("mouthPress", "mouthFunnel"),
    ("mouthPress", "mouthLowerDown"),
    ("mouthPress", "mouthUpperUp"),
    ("mouthRollLower", "mouthLowerDown"),
    ("mouthRollLower", "mouthFunnel"),
    ("mouthRollUpper", "mouthUpperUp"),
    ("mouthRollUpper", "mouthFunnel"),
)
"""Pairs, by how their names begin, that one face does not show at once."""

MOVED, HELD, MEET = (0.15, 0.6), (0.1, 0.4), 0.3  # [s], [s], share of a fall in which the next begins to rise
JAW_SHARE, SYMMETRIC_SHARE, MORE_UNITS = 0.6, 0.8, 2.0
HARD_SHAPES, HARD_RANGES = (2, 5), ((0.2, 1.0), (0.1, 0.5))
"""Shapes of a hard expression, and the range of their weights in either half of all."""


@check_arguments
def sample_weights(rng: np.random.Generator) -> Floats:
    """One random expression: ARKit weights in [0, 1], shape (52,).

    The jaw opens in 60 % of all; one unit is active, and a Poisson number of mean 2 beside it; a pair is symmetric to
    10 % in 80 % of cases and one-sided otherwise. mouthClose, which means closing an open jaw, never exceeds jawOpen.
    """
    weights = np.zeros(len(ARKIT))
    if rng.random() < JAW_SHARE:
        weights[index("jawOpen")] = rng.uniform(0.05, 1.0)
    active: list[str] = []
    for number in rng.permutation(len(UNITS))[: 1 + rng.poisson(MORE_UNITS)]:
        unit = UNITS[number]
        amplitude, sides = rng.uniform(0.1, 1.0), rng.random()
        spread = rng.uniform(0.9, 1.0, len(unit))
        if len(unit) == 2 and sides > SYMMETRIC_SHARE and not unit[0].startswith("eyeLook"):
            unit, spread = (unit[int(sides * 1000) % 2],), spread[:1]
        if any(contradict(name, other) for name in unit for other in active):
            continue
        active.extend(unit)
        for name, factor in zip(unit, spread, strict=True):
            weights[index(name)] = amplitude * factor
    weights[index("mouthClose")] = min(weights[index("mouthClose")], weights[index("jawOpen")])
    # mouthClose alone leaves nothing, which is no expression: draw again.
    return weights if weights.any() else sample_weights(rng)


@check_arguments
def combinations(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Floats:
    """Weights that go from one random expression to another, shape (frames, 52), in [0, 1], `rate` [Hz].

    Each is reached in 0.15 to 0.6 s, smoothly, as the one before has mostly gone, so that of two that contradict each
    other one is below 0.15; it is held for 0.1 to 0.4 s. Raises InputError for fewer than one frame and a rate that is
    not positive.
    """
    check_frames(frames, rate)
    times, weights = np.arange(frames) / rate, np.zeros((frames, len(ARKIT)))
    start, expression = 0.0, sample_weights(rng)
    while start <= times[-1]:
        rises, held, falls = rng.uniform(*MOVED), rng.uniform(*HELD), rng.uniform(*MOVED)
        there, end = start + rises, start + rises + held + falls
        part = np.clip(np.minimum((times - start) / rises, (end - times) / falls), 0.0, 1.0)
        weights = np.maximum(weights, (part * part * (3.0 - 2.0 * part))[:, None] * expression)
        start, expression = there + held + (1.0 - MEET) * falls, sample_weights(rng)
    weights[:, index("mouthClose")] = np.minimum(weights[:, index("mouthClose")], weights[:, index("jawOpen")])
    return weights


@check_arguments
def hard_expressions(rng: np.random.Generator, frames: int) -> Floats:
    """Draw weights without order in time, shape (frames, 52), in [0, 1]: two to five random shapes at once, one-sided.

    Half of the frames have weights of 0.2 to 1, half of 0.1 to 0.5. No two shapes contradict each other, and
    mouthClose never exceeds jawOpen. Raises InputError for fewer than one frame.
    """
    check_frames(frames, 1.0)
    weights = np.zeros((frames, len(ARKIT)))
    for row in weights:
        while not row.any():
            count, span = rng.integers(HARD_SHAPES[0], HARD_SHAPES[1] + 1), HARD_RANGES[rng.integers(2)]
            active: list[str] = []
            for name in rng.permutation(ARKIT):
                if len(active) < count and not any(contradict(name, other) for other in active):
                    active.append(str(name))
                    row[index(str(name))] = rng.uniform(*span)
            row[index("mouthClose")] = min(row[index("mouthClose")], row[index("jawOpen")])
    return weights


def contradict(a: str, b: str) -> bool:
    """Whether two ARKit shapes are kept apart."""
    return any(
        (a.startswith(first) and b.startswith(second)) or (b.startswith(first) and a.startswith(second))
        for first, second in CONTRADICTORY
    )
