"""A cheek let go and a head shaken by implicit Euler's steps: Eq. 9 and PD with mass on the skin, beside FEM."""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from ...lhm import LayeredHead
from ...lhm.base.errors import SoftdecaError
from ...lhm.base.mesh import Floats
from ...reference import Face, Reason, Sequence, Solution, march, problems, solve
from ...reference.face.dynamics import Recurrence
from ...reference.face.sequence import SequenceState

EQUATION, LET_GO, SHAKEN = (
    "a cheek let go, Eq. 9",
    "a cheek let go, mass on the skin",
    "a head shaken, mass on the skin",
)
MOTIONS = (EQUATION, LET_GO, SHAKEN)
SOURCE = "implicit Euler's steps; reference: FEniCSx with mass on the skin"
FRAME, FRAMES = 1.0 / 60.0, 12
"""[s] of a step, and their number."""
DRAWN, REACH, BESIDE = 5.0, 25.0, 45.0
"""[mm] down at the cheek, the standard deviation of what follows it, and the cheek's distance from the lips."""
SHAKE = (5.0, 2.0)
"""[mm] to either side and [Hz]; 20 mm turn 700 tets inside out, and a step has more than one answer then."""
TIGHT, BOUND = 1e-8, 1e-5
"""Gradient norm relative to its start, and the difference that is allowed over the largest displacement."""


def run_motion(name: str, head: LayeredHead) -> problems.Outcome:
    """Compare a motion, one of MOTIONS, with FEM's: largest displacement [mm], and largest difference over it.

    Bones are held. The mass per skin area is the one with which Eq. 9 of p's springs swings at p's frequency. Raises
    SoftdecaError for a march that stops early.
    """
    # Eq. 9 is of springs at vertices, which faces of tets have.
    face = Face(head, choices={"bones": "prescribed", "cells": "tets"})
    scene, p = face.neutral_scene(), face.parameters
    drawn = draw_cheek(head)
    start = None if name == SHAKEN else solve(scene.with_targets(drawn), solver="fenicsx", tolerance=TIGHT)
    march_by = partial(
        march,
        scene,
        time_step=FRAME,
        steps=FRAMES,
        scheme="implicit Euler",
        skin=head.skin_wrap.triangles,
        skin_density=float(np.mean(p.target_stiffness)) / (2.0 * np.pi * p.frequency) ** 2,
        positions=None if start is None else start.positions,
        acceleration=_shake if name == SHAKEN else None,
        tolerance=TIGHT,
    )
    begin = time.perf_counter()
    if name == EQUATION:
        assert start is not None
        frames = _play_frames(face, start, drawn)
    else:
        frames = [moment.solution for moment in march_by(solver="projective")]
    seconds, truth = time.perf_counter() - begin, [moment.solution for moment in march_by(solver="fenicsx")]
    if not all(frame.converged for frame in (*frames, *truth)):
        raise SoftdecaError(f"{name}: a march stopped early: {frames[-1].reason}, by FEniCSx {truth[-1].reason}")
    motion, theirs = (np.stack([frame.positions for frame in each])[:, : len(head.bone)] for each in (frames, truth))
    rest = scene.vertices[: len(head.bone)]
    value, reference = (float(np.abs(positions - rest).max()) for positions in (motion, theirs))
    error = float(np.abs(motion - theirs).max()) / reference
    return problems.Outcome(
        name, SOURCE, "projective", value, reference, error, BOUND, error <= BOUND, Reason.CONVERGED.name, seconds,
        sum(frame.iterations for frame in frames),
    )  # fmt: skip


def draw_cheek(head: LayeredHead) -> Floats:
    """Give the skin wrap's targets [mm], shape (n, 3), with the skin around a cheek drawn down."""
    wrap, face, skin = head.skin_wrap.vertices, np.flatnonzero(head.regions["face"]), head.skin.vertices
    beside = wrap[head.regions["lips"]].mean(axis=0)[:2] + [BESIDE, 0.0]
    cheek = wrap[face[np.linalg.norm(wrap[face, :2] - beside, axis=1).argmin()]]
    near = np.exp(-np.sum((skin - cheek) ** 2, axis=1) / (2.0 * REACH**2))
    return head.wrap_targets(skin + DRAWN * near[:, None] * [0.0, -1.0, 0.0])


def _shake(t: float) -> Floats:
    pace = 2.0 * np.pi * SHAKE[1]
    return np.array([-SHAKE[0] * pace**2 * np.sin(pace * t), 0.0, 0.0])


def _play_frames(face: Face, start: Solution, drawn: Floats) -> list[Solution]:
    """March frames of Eq. 9 with implicit Euler's coefficients, the start first."""
    sequence = Sequence(face, time_step=FRAME, dynamic=True, tolerance=TIGHT)
    sequence.recurrence = Recurrence.from_implicit_euler(face.parameters.frequency, FRAME)
    sequence.state = SequenceState(start.positions, drawn, start.positions[: len(face.head.bone)])
    return [start, *(sequence.frame(face.head.skin.vertices) for _ in range(FRAMES))]
