"""The surrogate that is shipped: bound to a person and p once, then frames like linear blendshapes, without torch."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import cache, cached_property
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import InputError
from ..lhm.base.geometry.deformation import DeformationTransfer
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.head.head import LayeredHead
from ..lhm.head.skin import check_shapes
from ..lhm.identities import LinearSpace
from ..lhm.identities.nearest import SAME, NearestPerson, check_belonging
from ..reference import Parameters
from ..reference.face.dynamics import OSCILLATION, Swing
from ..reference.face.face import Face
from ..reference.face.local import at_vertices as spread_over
from .corpus.face import KeptFace, name_person
from .corpus.mixture import BONES, NAMES, STATIC, basis
from .networks.gradients import GradientRig, open_transfer
from .networks.modal import bind_modal
from .networks.tables import Tables, expand, find_first_order
from .networks.weights import FORMS, MODAL, Weights, has_tables
from .rigs.baked import compress
from .rigs.bound import BoundSurrogate
from .rigs.inertia import Swings
from .rigs.rig import Needs, check_code, check_skin

Beyond = Literal["refuse", "clamp"]
_PRETRAINED = Path(str(files("softdeca.surrogate") / "pretrained"))
SHIPPED: Mapping[str, Path] = {
    "network": _PRETRAINED / "anny.safetensors",
    "hypernetwork": _PRETRAINED / "anny-hypernetwork.safetensors",
}
"""Weights of the default space by name: the network at vertices, and SoftDECA's hypernetwork on the same tables."""


class Described(NamedTuple):
    """A face as a network needs it: skin, code, p at its vertices, shapes, how it swings, and how bones carry it."""

    skin: Surface
    code: Floats
    at_vertices: Floats
    shapes: Floats32
    swing: Swings | None
    carry: Callable[[], Floats | Floats32]


class Surrogate:
    """A trained network for any person and parameters of its space.

    `networks.modal` and `networks.hypernetwork` have the forms of the shipped ones.
    """

    def __init__(self, weights: Weights):
        self.weights, self.inputs = weights, weights.inputs

    @classmethod
    def load(cls, path: str | PathLike[str] | None = None) -> Surrogate:
        """Read weights of a file, or those of the default space that are shipped: "network" (None) or "hypernetwork".

        The shipped ones are read once. InputError if damaged.
        """
        name = "network" if path is None else str(path)
        return _load_shipped(name) if name in SHIPPED else cls(Weights.load(name))

    @property
    def space(self) -> str:
        """The name of the space of people that it knows."""
        return self.weights.space

    def knows(self, skin: Surface) -> bool:
        """Whether a skin is in the triangles of the default space, and the weights are of that space."""
        return self.space == "anny" and np.array_equal(skin.triangles, self.weights.mean.triangles)

    def has_learned_from(self, code: Floats) -> bool | None:
        """Tell whether a person of the code (c,) is among those that it learned from; None where they are unknown."""
        return name_person(code) in self.weights.people if self.weights.people else None

    def find_nearest(self, skin: Surface) -> NearestPerson | None:
        """Find the person of the default space nearest to a skin [mm]; None for one that the weights do not know."""
        return NearestPerson.from_skin(self._people, skin) if self.knows(skin) else None

    def bind(
        self,
        skin: Surface,
        code: Floats,
        parameters: Parameters | None = None,
        *,
        expressions: Floats | None = None,
        exact: bool = False,
        head: LayeredHead | None = None,
        beyond: Beyond = "refuse",
    ) -> BoundRig:
        """Return a rig of one person and p: in milliseconds, or with `exact` in seconds.

        skin: the neutral surface [mm]; code: h, shape (c,). parameters: one set (default: all defaults), whose local
        values may be one per face of the skin. What lies beyond the ranges that the network has seen is refused, or
        clamped with a warning, by `beyond`. expressions:
        what the 52 weights add [mm], shape (52, n, 3); by default the built-in space's, for another they are needed.
        With `exact`, offset and responses are the simulator's, on `head` or on one that is fitted to the skin (the
        default space's only), by the cells that the network learned from, and it adds what is not linear. `dynamic`
        frames follow p's frequency and damping. Raises InputError for a skin of another template, unit, direction or
        order of vertices, for a code out of range or of another person, and for parameters that are refused, and what
        the simulator raises.
        """
        self._check_skin(skin)
        if exact:
            self.check_exact()
        code = check_code(code, len(self.weights.code_mean))
        if self.space == "anny":
            check_belonging(self._people, code, skin)
        shapes = self._expressions(code, expressions)
        chosen = Parameters() if parameters is None else parameters
        if exact:
            choices = {"cells": self.weights.note.cells}
            whole = Face(self._head(skin, head), shapes.astype(np.float64), chosen, code=code, choices=choices)
            return self.bind_face(whole, exact=True, beyond=beyond)
        static, oscillation = (
            [spread_over(name, getattr(chosen, name), skin) for name in names] for names in (STATIC, OSCILLATION)
        )
        at_vertices = _check_seen(np.stack(static, axis=1), self.weights.note.seen, beyond)
        swing = self._swing(code, at_vertices, np.stack(oscillation))
        return self._bind(Described(skin, code, at_vertices, shapes, swing, lambda: self._carry(skin, chosen, head)))

    def _carry(self, skin: Surface, parameters: Parameters, head: LayeredHead | None) -> Floats:
        """Return how far scaled bones carry a skin [mm], shape (n, 3); a head is needed only where one is scaled."""
        if all(getattr(parameters, name) == Parameters.info(name).default for name in BONES):
            return np.zeros(skin.vertices.shape)
        return Face(self._head(skin, head), parameters=parameters).carried

    def bind_face(self, face: Face | KeptFace, *, exact: bool = False, beyond: Beyond = "refuse") -> BoundRig:
        """Bind a face, live or of a corpus; with `exact`, with its own offset and responses.

        A face without a code gets that of the nearest person. A network that has one value of each parameter for the
        whole face takes the mean of those that vary in a corpus. Raises as `bind`.
        """
        if exact:
            self.check_exact()
        described = self._describe_kept(face) if isinstance(face, KeptFace) else self._describe(face, beyond, exact)
        return self._bind(described, face if exact else None)

    def _describe(self, face: Face, beyond: Beyond, exact: bool) -> Described:
        self._check_skin(face.skin)
        given = np.stack([face.at_vertices(name) for name in STATIC], axis=1)
        at_vertices = _check_seen(given, self.weights.note.seen, beyond)
        code = self._code_of(face)
        if exact:
            swing: Swings | None = face.swing
        else:
            swing = self._swing(code, at_vertices, np.stack([face.at_vertices(name) for name in OSCILLATION]))
        return Described(face.skin, code, at_vertices, face.shapes.astype(np.float32), swing, lambda: face.carried)

    def _describe_kept(self, face: KeptFace) -> Described:
        at_vertices = self.inputs.features.at_vertices(face.coefficients)
        if self.weights.kind in FORMS and not FORMS[self.weights.kind].follows_fields:
            at_vertices = np.broadcast_to(at_vertices.mean(axis=0), at_vertices.shape)
        skin = self.weights.mean.with_vertices(face.skin.vertices)
        shapes = np.asarray(face.shapes, dtype=np.float32)
        return Described(skin, face.code, at_vertices, shapes, self.learned_swing(face), lambda: face.carried)

    def _code_of(self, face: Face) -> Floats:
        if face.code is not None:
            code = check_code(face.code, len(self.weights.code_mean))
            if self.space == "anny":
                check_belonging(self._people, code, face.skin)
            return code
        nearest = self.find_nearest(face.skin)
        if nearest is None:
            raise InputError(f"code: the face of a person of {self.space!r} needs one")
        return nearest.code

    def learned_swing(self, face: KeptFace) -> Swings | None:
        """Return how a face of a corpus swings by learned coefficients of Eq. 21; None for weights without."""
        learned = self.weights.recurrence
        if learned is None:
            return None
        waves = basis(self.weights.mean.vertices)
        at_vertices = np.clip(waves @ face.parameters.coefficients.T.astype(np.float64), -1.0, 1.0)
        return learned.bind(self.inputs.code(face.code), at_vertices)

    def _swing(self, code: Floats, static: Floats, oscillation: Floats) -> Swings | None:
        """Return how a face swings, by what was learned or by where it is loose; None where neither is known."""
        learned, known = self.weights.recurrence, self.weights.looseness
        if learned is not None:
            columns = dict(zip((*STATIC, *OSCILLATION), (*static.T, *oscillation), strict=True))
            return learned.bind(self.inputs.code(code), np.stack([columns[name] for name in NAMES], axis=1))
        return None if known is None else Swing.from_shares(*known.predict(code), oscillation)

    @property
    def has_derivatives(self) -> bool:
        """Whether the network has an offset and responses, which the simulator's can replace."""
        return has_tables(self.weights.kind)

    @property
    def needs(self) -> Needs:
        """Input of a bind: a head, by which scaled bones carry the skin, where the weights have not learned that."""
        return "nothing" if self.has_derivatives else "head"

    def check_exact(self) -> None:
        """Raise InputError for a network that has no offset and responses which the simulator could replace."""
        if not self.has_derivatives:
            raise InputError(f"exact: a network of kind {self.weights.kind!r} has no offset and responses to replace")

    def _bind(self, described: Described, simulated: Face | KeptFace | None = None) -> BoundRig:
        """Bind what describes a face; with a `simulated` one, by its own offset and responses."""
        skin, code, at_vertices, shapes, swing, carry = described
        code = self.inputs.code(code)
        if not self.has_derivatives:
            return self._bind_gradients(described, code, carry().astype(np.float32))
        if simulated is None:
            first = find_first_order(
                self.weights.network, self._tables, self.inputs.features, code, at_vertices, shapes
            )
        else:
            first = simulated.offset.astype(np.float32), simulated.responses.astype(np.float32)
        if self.weights.kind != MODAL:
            return self._bind_gradients(described, code, *first)
        modes = compress(bind_modal(self.weights.network, first, self.inputs.features, code, at_vertices))
        return BoundSurrogate(skin, modes, shapes, swing)

    def _bind_gradients(
        self, described: Described, code: Floats, offset: Floats32, responses: Floats32 | None = None
    ) -> GradientRig:
        form = FORMS[self.weights.kind]
        skin, _, at_vertices, shapes, swing, _ = described
        return GradientRig(
            form, self.weights.network, self._transfer, code, at_vertices, skin, shapes, offset, responses, swing
        )

    @cached_property
    def _tables(self) -> Tables:
        """The tables of responses and offset, which a file has in bytes; a tenth of a second."""
        return expand(self.weights.network)

    @cached_property
    def _transfer(self) -> DeformationTransfer:
        return open_transfer(self.weights.network, self.weights.mean)

    @cached_property
    def _people(self) -> LinearSpace:
        """The default space, which takes longer to read than a bind."""
        return identities.Anny()

    def _check_skin(self, skin: Surface) -> None:
        check_skin(skin, self.weights.mean, f"the weights' template {self.weights.template}")

    def _expressions(self, code: Floats, expressions: Floats | None) -> Floats32:
        if expressions is None:
            if self.space != "anny":
                raise InputError("expressions: not known for the weights' space; bind needs expressions=")
            expressions = self._people.expression_deltas(code)
        return check_shapes(expressions, self.weights.mean).astype(np.float32)

    def _head(self, skin: Surface, head: LayeredHead | None) -> LayeredHead:
        if head is not None:
            self._check_skin(head.skin)
            away = np.linalg.norm(head.skin.vertices - skin.vertices, axis=1).max()
            if away > SAME:
                raise InputError(f"head: its skin is {away:.2g} mm from the skin given, expected at most {SAME:g} mm")
            return head
        if self.space != "anny":
            raise InputError(f"head: none is fitted for the space {self.space!r}; give bind(exact=True, head=)")
        return fit_head(load_template(identities.Anny()), skin)


@cache
def _load_shipped(name: str) -> Surrogate:
    return Surrogate(Weights.load(SHIPPED[name]))


def _check_seen(at_vertices: Floats, seen: Mapping[str, tuple[float, float]], beyond: Beyond) -> Floats:
    """Return parameters within what training saw of each."""
    if beyond not in ("refuse", "clamp"):
        raise InputError(f"beyond: expected 'refuse' or 'clamp', got {beyond!r}")
    low, high = (np.array([seen[name][side] for name in STATIC]) for side in (0, 1))
    slack = 1e-3 * np.maximum(high - low, 1e-3)
    outside = ((at_vertices < low - slack) | (at_vertices > high + slack)).any(axis=0)
    if outside.any():
        name = STATIC[int(np.flatnonzero(outside)[0])]
        info, k = Parameters.info(name), STATIC.index(name)
        bounds = ", ".join(f"{info.denormalise(seen[name][side]):.4g}" for side in (0, 1))
        worst = at_vertices[np.argmax(np.abs(at_vertices[:, k])), k]
        text = f"parameter {name} = {info.denormalise(worst):.4g} is beyond [{bounds}], what the network has seen"
        if beyond == "refuse":
            raise InputError(f"{text}; bind(beyond='clamp') takes the nearest")
        warnings.warn(f"{text}; the nearest is taken", stacklevel=3)
    return np.clip(at_vertices, low, high)


BoundRig = BoundSurrogate | GradientRig
"""Rigs that weights of either kind are bound to."""
