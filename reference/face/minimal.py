"""The smallest scene that answers a question: what may be left out before an answer changes by more than is allowed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from ...lhm.base.checks import check_arguments
from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.mesh import Floats
from ...lhm.head.head import LayeredHead
from ..scene import Scene
from ..solve import prepare
from .parameters import Parameters
from .settle import SettledFace, settle

WITHIN = 0.1
"""[mm], below what one sees on a face."""
TOLERANCE = 1e-6
"""Gradient norm relative to its start, far below what the differences need."""

Model = TypeVar("Model")


@dataclass(frozen=True, eq=False)
class Smallest:
    """What was left out, in that order, and the largest change [mm] of the answer by all of it together.

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
    left, gone, total = whole, [], 0.0
    for _, name in sorted((size, name) for name, size in changes.items() if size is not None and size <= within):
        tried = pieces[name](left)
        together = change(tried)
        if together is not None and together <= within:
            left, total = tried, together
            gone.append(name)
    return Smallest(tuple(gone), total, changes, left)


@check_arguments
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


@dataclass(frozen=True, eq=False)
class FacialModel:
    """An expression `targets` [mm], shape (skin vertices, 3), of a face that first settles under p.

    Both the settled neutral face and the expression take the choices of `facial_scene`, so a piece that is left out is
    left out of both. `targets` are those of the head without p.
    """

    head: LayeredHead
    parameters: Parameters
    targets: Floats
    choices: Mapping[str, Any] = field(default_factory=dict)

    def settle(self) -> SettledFace:
        """Settle the neutral face; raise SoftdecaError where it does not come to rest."""
        face = settle(self.head, self.parameters, tolerance=TOLERANCE, **self.choices)
        if not face.converged:
            raise SoftdecaError(f"the neutral face: {face.reason}")
        return face

    def scene(self) -> Scene:
        """Build the expression's scene of the settled face."""
        return self.settle().scene(self.targets)

    def skin(self) -> Floats:
        """Solve for the skin [mm], shape (skin vertices, 3)."""
        face = self.settle()
        return face.skin_after(self.targets, solve_positions(face.scene(self.targets)))

    def choosing(self, **choices: Any) -> FacialModel:
        """Copy the model with other choices."""
        return replace(self, choices={**self.choices, **choices})

    def with_parameters(self, **values: Any) -> FacialModel:
        """Copy the model with other parameters."""
        return replace(self, parameters=replace(self.parameters, **values))


def lower_face(head: LayeredHead) -> np.ndarray:
    """Mask the face below the lids, shape (n,), of the wraps' vertices."""
    height = head.skin_wrap.vertices[:, 1]
    return head.regions["face"] & (height < height[head.regions["lids"]].min())


def _without(part: str) -> Callable[[FacialModel], FacialModel]:
    return lambda model: model.choosing(without=(*model.choices.get("without", ()), part))


FACIAL_PIECES: Mapping[str, Callable[[FacialModel], FacialModel]] = {
    "muscle layer": _without("muscle"),
    "softness of muscle in strain": lambda model: model.with_parameters(muscle_strain_ratio=1.0),
    "membrane of the skin": _without("skin"),
    "tissue outside the face": lambda model: model.choosing(region="face"),
    "tissue outside the lower face": lambda model: model.choosing(region=lower_face(model.head)),
    "free rigid mandible": lambda model: model.choosing(bones="prescribed"),
    "contact": lambda model: model.choosing(contact=()),
    "gravity beyond the scan's": lambda model: model.with_parameters(
        gravity=1.0, gravity_x=0.0, gravity_y=-1.0, gravity_z=0.0
    ),
}
"""What a facial scene may do without: its layers and terms, regions (others are carried along), motions of bone."""


def smallest_facial_scene(model: FacialModel, *, within: float = WITHIN) -> Smallest:
    """Leave in a facial scene as few of `FACIAL_PIECES` as keep its skin within so many mm of the whole one's.

    Regions are left out on heads that have them. Raises as `find_smallest`.
    """
    pieces = dict(FACIAL_PIECES)
    if "face" not in model.head.regions:
        del pieces["tissue outside the face"], pieces["tissue outside the lower face"]
    if not model.choices.get("contact"):
        del pieces["contact"]
    if not np.any(model.parameters.added_gravity):
        del pieces["gravity beyond the scan's"]
    return find_smallest(model, pieces, FacialModel.skin, within=within)
