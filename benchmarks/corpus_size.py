"""Errors over the size of a corpus: of networks that learned from more and more of its people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..animation import plots
from ..lhm.base.errors import InputError
from ..lhm.base.progress import OnProgress
from ..surrogate import Surrogate
from ..surrogate.corpus.reading import Faces
from ..surrogate.evaluate import evaluate
from ..surrogate.heads import Heads
from ..surrogate.methods import NetworkMethod
from .harness.study import Table

SEEN = 24
"""Training faces, of people that all networks know, on which each is tried, too."""


@dataclass(frozen=True)
class Grown:
    """A network by what it was trained on, and its share of |T - carried(S)| on unseen people, and on seen ones."""

    people: int
    faces: int
    steps: int
    unseen: float
    seen: float


def errors_over_size(
    training: Faces, weights: Sequence[Path], test: Faces, heads: Heads, progress: OnProgress
) -> list[Grown]:
    """One of each weights file of `softdeca train --share`, fewest people first.

    Where the share of seen people stays far below that of unseen ones, more people help; where both are level, another
    form would. InputError for weights of another mesh, and for fewer than two of them.
    """
    networks = sorted((Surrogate.load(path).weights for path in weights), key=lambda one: one.note.people)
    if len(networks) < 2 or networks[0].note.people == networks[-1].note.people:
        raise InputError("curve: two weights at least, trained on different numbers of people")
    for one in networks:
        one.check_mesh(training.mean)
    fewest = networks[0].note
    people = np.unique(training.groups[:, 0])[: fewest.people + len(fewest.held)]
    learned = np.setdiff1d(people, [number for one in networks for number in one.note.held])
    rows = np.flatnonzero(np.isin(training.groups[:, 0], learned))
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, SEEN).round().astype(int))].tolist()
    found = []
    for number, one in enumerate(networks):
        of_unseen = evaluate([NetworkMethod(one)], test, heads)
        of_seen = evaluate([NetworkMethod(one)], training, heads, chosen=chosen)
        note = one.note
        found.append(Grown(note.people, note.faces, note.steps, of_unseen[0].share, of_seen[0].share))
        progress(f"curve: {note.people} people", (number + 1) / len(networks))
    return found


def table(found: Sequence[Grown]) -> Table:
    """The curve, a line per network."""
    head = ["people", "faces", "steps", "error of unseen people [% of |T - carried(S)|]", "of seen ones"]
    lines = [(f.people, f.faces, f.steps, 100.0 * f.unseen, 100.0 * f.seen) for f in found]
    return Table("Error over the number of people trained on", head, lines)


def picture(found: Sequence[Grown]) -> bytes:
    """The curve as PNG."""
    figure, axis = plots.subplots(figsize=(6, 3.4))
    people = [f.people for f in found]
    axis.plot(people, [100.0 * f.unseen for f in found], "o-", label="people that it has not seen")
    axis.plot(people, [100.0 * f.seen for f in found], "s--", label="people that it has learned from")
    axis.set(xlabel="people in training", ylabel="error [% of |T - carried(S)|]", xscale="log", ylim=(0.0, None))
    axis.set_xticks(people, [str(count) for count in people])
    axis.minorticks_off()
    axis.legend()
    return plots.to_png(figure)
