"""Heads of a corpus' people: how far scaled bones carry a face's skin, and the cost of a bind by simulation."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import OnProgress, silent
from ..lhm.head import LayeredHead
from ..reference import Parameters, prepare, settle
from ..reference.face.derivatives import QUICK_ACCURACY, spring_norm
from ..reference.face.settle import TARGET_OPTIONS, carry_skin
from .corpus.face import Face
from .corpus.folder import read_kept_plan
from .corpus.people import OfSpace, People, people_from_text
from .ruler import BONES
from .runtime import derivatives

SCALED = 1.02
"""Of a cranium, to measure what carrying costs."""


class Heads:
    """Heads of people, fitted as they are asked for; the last one is kept, and how bones carry its last face.

    `people` fit them. Where it is None, faces without a scaled bone are carried by nothing, and another raises
    InputError, which says `why`.
    """

    def __init__(self, people: People | None, why: str = "nobody fits their heads"):
        self._people, self._why = people, why
        self._last: tuple[bytes, LayeredHead] | None = None
        self._carried: tuple[tuple[bytes, bytes], Floats32] | None = None

    @classmethod
    def of_corpus(cls, folder: str | PathLike[str], on_progress: OnProgress = silent) -> Heads:
        """Return the heads of a corpus' people; nobody fits them where its folder does not tell how."""
        try:
            made_with = read_kept_plan(folder)[1]
        except InputError as error:
            return cls(None, str(error))
        return cls(people_from_text(made_with["identities"], level=made_with["level"], on_progress=on_progress))

    @property
    def people(self) -> People:
        """Who fits the heads; InputError where nobody does."""
        if self._people is None:
            raise InputError(f"bones carried: a head of each person is needed, but {self._why}")
        return self._people

    def head(self, face: Face) -> LayeredHead:
        """Fit the head of a face's person. Raises InputError where nobody fits them, and what fitting raises."""
        key = face.skin.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.fit(face)
        return self._last[1]

    def fit(self, face: Face) -> LayeredHead:
        """Fit the head anew."""
        return self.people.head(face.person)

    def shapes(self, face: Face) -> Floats:
        """Return what each shape adds to a person's skin [mm], shape (52, n, 3): in a space, by the code."""
        people = self.people
        return people.space.expression_deltas(face.code) if isinstance(people, OfSpace) else np.asarray(face.shapes)

    def parameters(self, face: Face, head: LayeredHead) -> Parameters:
        """Return the parameters of a face on the wraps of its head, as the corpus simulated it."""
        return face.parameters.parameters(head, self.people.mean)

    def carry(self, face: Face) -> Floats32:
        """Displace a face's skin with its scaled bones [mm], shape (n, 3); see `settling.carry_skin`."""
        scales = {name: face.parameters.level(name) for name in BONES}
        if all(scale == Parameters.info(name).default for name, scale in scales.items()):
            return np.zeros(face.skin.shape, dtype=np.float32)
        key = face.skin.tobytes(), face.parameters.coefficients.tobytes()
        if self._carried is None or self._carried[0] != key:
            self._carried = key, carry_skin(self.head(face), Parameters(**scales)).astype(np.float32)
        return self._carried[1]


@dataclass(frozen=True)
class BindCosts:
    """Median processor seconds of a bind on one thread, over `faces` faces, each on a head that is there.

    head: fitting it, once a person. carried: scaled bones carry the skin. settled: the neutral face settles under p and
    comes to rest among its targets. derivatives: these, the tangent and 52 responses.
    """

    faces: int
    head: float
    carried: float
    settled: float
    derivatives: float

    def seconds(self, takes: str) -> float:
        """Return the seconds that a method takes of the simulator (`protocol.Takes`), without the head."""
        return 0.0 if takes == "nothing" else float(getattr(self, takes))


def measure_binds(heads: Heads, faces: Sequence[Face], on_progress: OnProgress = silent) -> BindCosts:
    """Run what binds take on each of some faces, after one that is not counted."""
    rows = []
    for number, face in enumerate([faces[0], *faces]):
        begin = time.process_time()
        head = heads.fit(face)
        fitted = time.process_time()
        parameters = heads.parameters(face, head)
        begun = time.process_time()
        carry_skin(head, replace(parameters, cranium_scale_x=SCALED))  # which costs nothing where no bone is scaled
        carried = time.process_time()
        solve_neutral(head, parameters)
        rested = time.process_time()
        derivatives(head, parameters, np.asarray(face.shapes, dtype=np.float32))
        rows.append((fitted - begin, carried - begun, rested - carried, time.process_time() - rested))
        on_progress("seconds of a bind by simulation", number / len(faces))
    return BindCosts(len(faces), *(float(value) for value in np.median(rows[1:], axis=0)))


def solve_neutral(head: LayeredHead, parameters: Parameters) -> Floats:
    """Solve the neutral skin [mm], settled and at rest among its targets, without a tangent."""
    face = settle(head, parameters, **TARGET_OPTIONS)
    scene = face.scene(head.skin.vertices)
    answer = prepare(scene).solve(start=face.positions, absolute=QUICK_ACCURACY * spring_norm(scene))
    return face.skin_after(head.skin.vertices, answer.positions)
