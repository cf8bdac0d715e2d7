"""A fan of random starts on one face: do they end in one minimum, or which term lets them part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ....lhm.base.mesh import Floats
from ....lhm.head import LayeredHead
from ....reference import Parameters, Prepared, facial_scene, prepare, terms
from ..measures import distances
from .effect import TIGHT

JITTERS = (1.0, 2.0, 10.0)
"""How far [mm] the starts' vertices are moved, root mean square of each component, one after the other."""
KINDS = "vertices", "waves"
"""What moves: three starts vertex by vertex, then three where targets moved by waves have taken the face.

The first invert tets; the solver untangles them first, which leaves little of where they began. The second invert few.
"""
WAVES, SHORTEST = 8, 30.0
"""How many plane waves are added, and the shortest [mm]."""
ROUGH = 1e-3
"""Gradient norm relative to its start at which a face has followed its waves far enough."""
ONE_MINIMUM = 1e-3
"""Answers that differ by at most so much [mm] are one."""
SUSPECTS: dict[str, tuple[dict[str, float], tuple[str, ...]]] = {
    "the skin bends: skin_bending 3": ({"skin_bending": 3.0}, ()),
    "no skin": ({}, ("skin",)),
    "muscle as stiff as soft tissue: muscle_strain_ratio 1": ({"muscle_strain_ratio": 1.0}, ()),
    "volumes less stiff: volume_ratio 5": ({"volume_ratio": 5.0, "muscle_volume_ratio": 1.0}, ()),
    "targets less stiff: target_stiffness 1": ({"target_stiffness": 1.0}, ()),
}
"""Changes of one term each, by which a second minimum is traced to it: parameters, and parts left out."""


def fan(
    head: LayeredHead,
    parameters: Parameters,
    expression: Floats,
    count: int,
    *,
    tell: Callable[[int], None] = lambda done: None,
) -> dict:
    """Solve an expression [mm], shape (skin vertices, 3), from `count` random starts; `tell` counts them.

    Distances are to the answer of the lowest energy. Where one is above `ONE_MINIMUM`, its start and that of the
    lowest are solved again with one term changed at a time: {"suspects": {change: distance between both}}.
    """
    prepared = prepare(facial_scene(head, parameters, expression, bones="rigid"))
    answers: list[Floats] = []
    rows: list[dict] = []
    for seed in range(count):
        solution = prepared.solve(start=_make_start(prepared, seed), tolerance=TIGHT)
        answers.append(solution.positions)
        rows.append(
            {
                "seed": seed,
                "moved": _kind(seed),
                "jitter_mm": _jitter(seed),
                "iterations": solution.iterations,
                "converged": solution.converged,
                "energy": solution.energy,
                "inverted_tets": int(np.count_nonzero(solution.volume_ratio <= 0)),
            }
        )
        tell(seed + 1)
    lowest = int(np.argmin([row["energy"] for row in rows]))
    for row, positions in zip(rows, answers, strict=True):
        row["to_lowest_mm"] = float(distances(positions, answers[lowest]).max())
    farthest = int(np.argmax([row["to_lowest_mm"] for row in rows]))
    spread = rows[farthest]["to_lowest_mm"]
    suspects = _trace_suspects(head, parameters, expression, (lowest, farthest)) if spread > ONE_MINIMUM else {}
    return {"starts": rows, "spread_mm": spread, "suspects": suspects}


def _jitter(seed: int) -> float:
    return JITTERS[seed % len(JITTERS)]


def _kind(seed: int) -> str:
    return KINDS[seed // len(JITTERS) % len(KINDS)]


def _make_start(prepared: Prepared, seed: int) -> Floats:
    random, scene = np.random.default_rng(seed), prepared.scene
    if _kind(seed) == "vertices":
        return scene.vertices + _jitter(seed) * random.standard_normal(scene.vertices.shape)
    (target,) = scene.of(terms.Target)
    moved = scene.vertices[target.vertices] + _jitter(seed) * _draw_waves(random, scene.vertices[target.vertices])
    return prepared.solve(scene.with_targets(moved), tolerance=ROUGH).positions


def _draw_waves(random: np.random.Generator, points: Floats) -> Floats:
    """A sum of plane waves of random directions, lengths and phases at points (k, 3), components of mean square 1."""
    direction = random.standard_normal((WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    length = SHORTEST * (1.0 + random.exponential(size=(WAVES, 1)))
    phase = points @ (2.0 * np.pi * direction / length).T + random.uniform(0.0, 2.0 * np.pi, WAVES)
    return np.sin(phase) @ random.standard_normal((WAVES, 3)) * np.sqrt(2.0 / WAVES)


def _trace_suspects(
    head: LayeredHead, parameters: Parameters, expression: Floats, seeds: tuple[int, int]
) -> dict[str, float]:
    found = {}
    for change, (values, without) in SUSPECTS.items():
        scene = facial_scene(head, replace(parameters, **values), expression, bones="rigid", without=without)
        prepared = prepare(scene)
        first, second = (prepared.solve(start=_make_start(prepared, seed), tolerance=TIGHT).positions for seed in seeds)
        found[change] = float(distances(first, second).max())
    return found
