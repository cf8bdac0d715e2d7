"""What each piece of the facial scene costs, and what the face is wrong by where it is left out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..lhm import expressions
from ..lhm.errors import SoftdecaError
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..reference import Parameters, facial_scene
from ..reference.connecting import bone_points
from ..reference.sequence import Sequence
from .apart import apart
from .costs import megabytes, timed
from .differences import distances
from .throughput import RATE, default_head
from .traces import Stopwatch

TOLERANCE = 1e-6
"""Gradient norm relative to its start, far below what the differences need."""
DYNAMIC_FRAMES = 12
WHOLE = "whole model"


@dataclass(frozen=True)
class Variant:
    """A facial scene by its choices, its parameters, and whether its skull is tied on by connecting tets."""

    choices: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    tied: bool = False

    def scene(self, head: LayeredHead, targets: Floats):
        """The scene of an expression [mm], shape (skin vertices, 3)."""
        choices = {"bones": "rigid"} | dict(self.choices)
        if choices.get("region") == LOWER_FACE:
            choices["region"] = lower_face(head)
        if self.tied:
            choices["attached"] = bone_points(head)
        return facial_scene(head, Parameters(**self.parameters), targets, **choices)


LOWER_FACE = "lower face"
VARIANTS = {
    WHOLE: Variant(),
    "soft tissue down to the skull": Variant({"without": ("muscle",)}),
    "muscle as stiff as soft tissue": Variant(parameters={"muscle_strain_ratio": 1.0}),
    "no membrane": Variant({"without": ("skin",)}),
    "face alone": Variant({"region": "face"}),
    "lower face alone": Variant({"region": LOWER_FACE}),
    "lips and lids apart": Variant({"contact": ("lips", "lids")}),
    "mandible prescribed": Variant({"bones": "prescribed"}),
    "soft bones": Variant({"bones": "soft"}),
    "gravity doubled": Variant(parameters={"gravity": 2.0}),
    "skull tied on": Variant(tied=True),
}


@dataclass(frozen=True)
class Piece:
    """A piece, and the variants with and without it."""

    name: str
    kept: str
    left_out: str


PIECES = (
    Piece("muscle layer (else one layer of soft tissue)", WHOLE, "soft tissue down to the skull"),
    Piece("softness of muscle in strain (else as soft tissue)", WHOLE, "muscle as stiff as soft tissue"),
    Piece("membrane of the skin", WHOLE, "no membrane"),
    Piece("tissue outside the face (else carried along)", WHOLE, "face alone"),
    Piece("tissue outside the lower face (else carried along)", WHOLE, "lower face alone"),
    Piece("contact of lips and lids", "lips and lids apart", WHOLE),
    Piece("free rigid mandible (else prescribed)", WHOLE, "mandible prescribed"),
    Piece("soft bones of Eq. 13 (else rigid)", "soft bones", WHOLE),
    Piece("gravity beyond the scan's, 1 g", "gravity doubled", WHOLE),
    Piece("connecting tets to the skull", "skull tied on", WHOLE),
)


def lower_face(head: LayeredHead) -> np.ndarray:
    """The face below the lids, a mask (n,) of the wraps' vertices."""
    height = head.skin_wrap.vertices[:, 1]
    return head.regions["face"] & (height < height[head.regions["lids"]].min())


def measure_minimal(names: Collection[str], tell: Callable[[str], None]) -> dict:
    """A row per piece: cost with and without it, and the distance of the skins [mm] over the expressions."""
    space, code, head = default_head()
    targets = [expressions.blend(space, code, expressions.parsed(name))[0] for name in names]
    found = {}
    for name, variant in VARIANTS.items():
        tell(f"minimal model: {name}")
        found[name] = apart(measure_variant, head, targets, variant)
    rows = [_row(piece, found[piece.kept], found[piece.left_out]) for piece in PIECES]
    tell("minimal model: dynamics")
    talk = expressions.conversation(np.random.default_rng(3), DYNAMIC_FRAMES, rate=RATE)
    rows.append(apart(measure_dynamics, head, expressions.blend(space, code, talk)))
    costs = {name: variant["cost"] | {"failure": variant["failure"]} for name, variant in found.items()}
    return {"expressions": list(names), "rows": rows, "variants": costs}


def measure_variant(head: LayeredHead, targets: list[Floats], variant: Variant) -> dict:
    """Cost of a variant, its mean over the expressions, and the skins [mm]; a failure is its reason.

    To be called in a process of its own, for the memory's sake.
    """
    rows, skins = [], []
    n = len(head.bone)
    try:
        held = megabytes(partial(variant.scene, head, targets[0]))
        for expression in targets:
            solution, cost = timed(partial(variant.scene, head, expression), TOLERANCE)
            rows.append(cost)
            skins.append(head.skin_after(expression, solution.positions[:n]))
    except SoftdecaError as error:
        return {"failure": str(error), "cost": {}, "skins": []}
    unfinished = [row["reason"] for row in rows if not row["converged"]]
    cost = {key: float(np.mean([row[key] for row in rows])) for key in ("seconds", "cpu_seconds", "iterations")}
    return {"failure": "; ".join(unfinished) or None, "cost": cost | {"megabytes": held}, "skins": skins}


def _row(piece: Piece, kept: Mapping, left_out: Mapping) -> dict:
    skins = list(zip(left_out["skins"], kept["skins"], strict=False))
    apart_by = np.array([distances(a, b) for a, b in skins])
    return {
        "piece": piece.name,
        "kept": kept["cost"],
        "left_out": left_out["cost"],
        "mean_mm": float(apart_by.mean()) if skins else None,
        "max_mm": float(apart_by.max()) if skins else None,
        "failure": kept["failure"] or left_out["failure"],
    }


def measure_dynamics(head: LayeredHead, targets: Floats) -> dict:
    """The row of dynamics (Eq. 9): frames of talk at 60 Hz, (frames, skin vertices, 3), with inertia and without."""
    costs, skins, failure = [], [], None
    for dynamic in (True, False):
        running = Sequence(head, Parameters(), time_step=1.0 / RATE, dynamic=dynamic, bones="rigid")
        running.frame(targets[0])
        frames, laps, iterations = [], [], []
        for expression in targets[1:]:
            watch = Stopwatch()
            solution = running.frame(expression)
            laps.append(watch.lap())
            iterations.append(solution.iterations)
            frames.append(running.skin(expression, solution))
            if not solution.converged:
                failure = str(solution.reason)
        wall, cpu = np.mean(laps, axis=0)
        costs.append({"seconds": wall, "cpu_seconds": cpu, "iterations": float(np.mean(iterations)), "megabytes": None})
        skins.append(frames)
    apart_by = np.array([distances(a, b) for a, b in zip(*skins, strict=True)])
    return {
        "piece": "dynamics of Eq. 9 (per frame of talk)",
        "kept": costs[0],
        "left_out": costs[1],
        "mean_mm": float(apart_by.mean()),
        "max_mm": float(apart_by.max()),
        "failure": failure,
    }
