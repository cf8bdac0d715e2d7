"""The smallest scene that answers a question: what may be left out before an answer changes by more than is allowed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.mesh import Floats
from ...lhm.head.head import LayeredHead
from ..scene import Scene
from ..solve import prepare
from .face import Face

WITHIN = 0.1
"""[mm], below what one sees on a face."""
TOLERANCE = 1e-6
"""Gradient norm relative to its start, far below what the differences need."""

Model = TypeVar("Model")


@dataclass(frozen=True, eq=False)
class Smallest:
    """Pieces that were left out, in that order, and the largest change [mm] of the answer by all of it together.

    changes: the largest change [mm] by each piece alone, None for one without which there is no answer; model: what is
    left.
    """

    without: tuple[str, ...]
    change: float
    changes: Mapping[str, float | None]
    model: Any = field(repr=False)


def find_smallest(
    whole: Model,
    pieces: Mapping[str, Callable[[Model], Model]],
    answer: Callable[[Model], Floats],
    *,
    within: float = WITHIN,
) -> Smallest:
    """Leave out of a model as many pieces as its answer (points (k, 3) [mm]) allows to change by at most `within`.

    `pieces` make a model without one. Each is tried alone; then they go one after another, the one that changes least
    first, as long as all together change no point by more. A piece without which `answer` raises SoftdecaError stays.
    Raises InputError for a bound that is not above 0, and what `answer` raises of the whole.
    """
    if not within > 0.0:
        raise InputError(f"within: must be above 0 mm, got {within}")
    truth = answer(whole)

    def change(model: Model) -> float | None:
        try:
            return float(np.linalg.norm(answer(model) - truth, axis=1).max())
        except SoftdecaError:
            return None

    changes = {name: change(without(whole)) for name, without in pieces.items()}
    smallest, gone, total = whole, [], 0.0
    for _, name in sorted((size, name) for name, size in changes.items() if size is not None and size <= within):
        tried = pieces[name](smallest)
        together = change(tried)
        if together is not None and together <= within:
            smallest, total = tried, together
            gone.append(name)
    return Smallest(tuple(gone), total, changes, smallest)


def smallest_scene(
    scene: Scene, *, within: float = WITHIN, solver: str = "projective", tolerance: float = TOLERANCE
) -> Smallest:
    """Leave in a scene as few of its terms as keep every vertex within so many mm of where all of them put it.

    Terms are named by their kind, and by their number where there are several. Raises as `find_smallest`, and
    SoftdecaError where the whole scene is not solved.
    """
    kinds = [type(term).__name__ for term in scene.terms]
    names = {
        kind if kinds.count(kind) == 1 else f"{kind} {kinds[:i].count(kind) + 1}": term
        for i, (kind, term) in enumerate(zip(kinds, scene.terms, strict=True))
    }
    pieces = {name: lambda s, t=term: replace(s, terms=tuple(x for x in s.terms if x is not t))
              for name, term in names.items()}  # fmt: skip
    return find_smallest(scene, pieces, lambda s: solve_positions(s, solver, tolerance), within=within)


def solve_positions(scene: Scene, solver: str = "projective", tolerance: float = TOLERANCE) -> Floats:
    """Solve a scene for positions [mm], shape (n, 3); raise SoftdecaError where it does not converge."""
    solution = prepare(scene, solver=solver).solve(tolerance=tolerance)
    if not solution.converged:
        raise SoftdecaError(str(solution.reason))
    return solution.positions


def solve_skin(face: Face, expression: Floats) -> Floats:
    """Solve for a face's skin [mm], shape (n, 3), in an expression of the head without p, of the same shape.

    SoftdecaError where the neutral face or the expression does not come to rest.
    """
    settled = face.settled()
    if not settled.converged:
        raise SoftdecaError(f"the neutral face: {settled.reason}")
    return face.expression_skin(expression, solve_positions(face.expression_scene(expression)))


def choose(face: Face, **choices: Any) -> Face:
    """Return a face with other choices of `facial_scene`."""
    return replace(face, choices={**face.choices, **choices})


def change_parameters(face: Face, **values: Any) -> Face:
    """Return a face with other parameters."""
    return replace(face, parameters=replace(face.parameters, **values))


def lower_face(head: LayeredHead) -> np.ndarray:
    """Mask the face below the lids, shape (n,), of the wraps' vertices."""
    height = head.skin_wrap.vertices[:, 1]
    return head.regions["face"] & (height < height[head.regions["lids"]].min())


def _without(part: str) -> Callable[[Face], Face]:
    return lambda face: choose(face, without=(*face.choices.get("without", ()), part))


FACIAL_PIECES: Mapping[str, Callable[[Face], Face]] = {
    "muscle layer": _without("muscle"),
    "softness of muscle in strain": lambda face: change_parameters(face, muscle_strain_ratio=1.0),
    "membrane of the skin": _without("skin"),
    "tissue outside the face": lambda face: choose(face, region="face"),
    "tissue outside the lower face": lambda face: choose(face, region=lower_face(face.head)),
    "free rigid mandible": lambda face: choose(face, bones="prescribed"),
    "contact": lambda face: choose(face, contact=()),
    "gravity beyond the scan's": lambda face: change_parameters(
        face, gravity=1.0, gravity_x=0.0, gravity_y=-1.0, gravity_z=0.0
    ),
}
"""What a facial scene may do without: its layers and terms, regions (others are carried along), motions of bone."""


def smallest_facial_scene(face: Face, expression: Floats, *, within: float = WITHIN) -> Smallest:
    """Leave in a face's scenes as few of `FACIAL_PIECES` as keep its skin within so many mm of the whole one's.

    The face settles, and so do those with pieces less, before the expression, which is given by the head's skin [mm]
    without p, shape (n, 3). Regions are left out on heads that have them. Raises as `find_smallest`.
    """
    pieces = dict(FACIAL_PIECES)
    if "face" not in face.head.regions:
        del pieces["tissue outside the face"], pieces["tissue outside the lower face"]
    if not face.choices.get("contact"):
        del pieces["contact"]
    if not np.any(face.parameters.added_gravity):
        del pieces["gravity beyond the scan's"]
    whole = replace(face, settling={"tolerance": TOLERANCE})
    return find_smallest(whole, pieces, lambda model: solve_skin(model, expression), within=within)
