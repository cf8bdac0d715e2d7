"""Methods on a corpus' sequences: Eq. 21 over each method's static answers, and methods that play whole sequences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ..lhm.base.mesh import Floats32, Surface
from ..reference import Parameters
from ..reference.face.dynamics import OSCILLATION, Swing, extrapolate_turns
from .corpus.face import KeptFace
from .corpus.mixture import NAMES, basis
from .corpus.plan import RATE
from .corpus.reading import Row, Table
from .methods import Method
from .rigs.inertia import DynamicRig, Looseness
from .rigs.rig import Needs
from .trials import Player, Trial, play


def move(method: Method, trial: Trial, looseness: Looseness, mean: Surface) -> Method:
    """Make a method of Eq. 21 over another's frames, by the swing that its rig has learned, or where people are loose.

    A sequence begins at the method's own static answer with the simulation's velocity; the head turns as it did there.
    """
    row = trial.sequence
    assert row is not None

    def bind(face: KeptFace) -> Any:
        rig = method.bind(face)
        learned = getattr(rig, "swing", None)
        swing = swing_where_loose(looseness, face, mean) if learned is None else learned
        moving = DynamicRig(rig, swing, 1.0 / RATE)
        turned = row["rotations"].astype(np.float64)
        velocity = RATE * (row["before"][0].astype(np.float64) - row["before"][1])
        moving.begin(trial.weights[0], velocity=velocity, base=extrapolate_turns(turned))
        return Player(moving.frame(w, base=base) for w, base in zip(trial.weights, turned, strict=True))

    return replace(method, bind=bind)


def swing_where_loose(looseness: Looseness, face: KeptFace, mean: Surface) -> Swing:
    """Combine a person's looseness with p's frequency and damping at the vertices of a space's `mean` skin."""
    waves, values = basis(mean.vertices), []
    for name in OSCILLATION:
        row = face.parameters.coefficients[NAMES.index(name)].astype(np.float64)
        values.append(np.asarray(Parameters.info(name).denormalise(np.clip(waves @ row, -1.0, 1.0))))
    loose, pivot = looseness.predict(face.code)
    return Swing(loose, values[0], values[1], pivot)


class Plays(Protocol):
    """A method that learns from sequences, and plays them."""

    needs: Needs

    def fit(self, table: Table) -> None:
        """Learn from a corpus' sequences."""
        ...

    def play(self, row: Row, table: Table) -> Floats32:
        """Return T - S [mm], shape (L, n, 3), of a sequence of a table."""
        ...


def play_sequence(name: str, method: Plays, trial: Trial, table: Table) -> Method:
    """Make a method of one that plays whole sequences of a table, fitted; it begins with two true skins."""
    row = trial.sequence
    assert row is not None
    return replace(play(name, trial, lambda: method.play(row, table)), needs=method.needs)
