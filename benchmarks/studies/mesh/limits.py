"""Two limits of linear tets on a head: ever finer meshes, and quadratic tets on the same mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ....lhm.base.errors import SoftdecaError
from ....lhm.base.geometry.mirror import find_twins
from ....lhm.base.mesh import Floats
from ....lhm.head.head import LayeredHead
from ....lhm.head.remesh import refine_head, remesh
from ....reference import Parameters, Scene, facial_scene
from ....surrogate.ruler import measure
from ..measures import difference, distances, limit_of_three, limit_of_two, solve_to_end
from ..person import Person
from ..scaling.mixed import make_law_scene

SPLIT_PRISMS, FREE_TETS = "split prisms", "free tets (gmsh)"
SPLIT = "P1, split into eight"
SUB_LAYERS = (1, 2, 4)
ALONG = 2
"""Sub-layers of the head's own surface that compare with the split head: a layer of tets split into eight has two."""
ORDER_ALONG = 1.0
"""Of the two surface levels, assumed: smooth answers show 2, but springs and borders of bone let less be trusted."""
LINEAR_TOLERANCE, QUADRATIC_TOLERANCE, PRESSURE_TOLERANCE = 1e-7, 2e-3, 1e-6
"""Gradient norm over its start. Quadratic tets start at the linear answer, where .002 leaves the skin 0.0001 mm."""
ONE_SIDED = "mouthSmileLeft*0.6"
"""Expression that is mirrored."""
SOFT = 0.45
"""Poisson's ratio of the mirrored loads."""
MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Answer:
    """A head's converged solve: all positions and the skin [mm], (n, 3); iterations, tets and energy [mJ]."""

    positions: Floats
    skin: Floats
    iterations: int
    tets: int
    energy: float

    def describe(self, what: str) -> dict[str, Any]:
        """Give the line of a mesh."""
        return {"what": what, "tets": self.tets, "iterations": self.iterations}


def find_answer(head: LayeredHead, shape: Floats, scene: Scene, **how: Any) -> Answer:
    """Solve a head's scene by `how`, as `solve` takes it; SoftdecaError where it does not converge."""
    solution = solve_to_end(scene, how.get("element", "P1"), **how)
    skin = head.skin_after(shape, solution.positions[: len(head.bone)])
    return Answer(solution.positions, skin, solution.iterations, len(scene.tets), solution.energy)


def compare_finer_meshes(head: LayeredHead, shape: Floats) -> dict[str, Any]:
    """Measure each mesh's distances [mm] to the limits across the layers and along the surface, under PD's energy.

    Sub-layers 1, 2, 4 of each tissue show the error across. A mesh split into eight, beside two sub-layers of the own
    surface, shows the one along. Bones are prescribed, so that every mesh solves the same problem. The first of `rows`
    is the head's own mesh against both limits together; `energy` is of each mesh.
    """
    answers = [_solve_pd(head, shape, count) for count in SUB_LAYERS]
    split = _solve_pd(refine_head(head), shape, 1)
    across = limit_of_three(*(answer.skin for answer in answers))
    unsplit = answers[SUB_LAYERS.index(ALONG)]
    along = limit_of_two(unsplit.skin, split.skin, ORDER_ALONG)
    rest = head.skin.vertices

    def to_limit(answer: Answer, limit: Floats) -> dict[str, float]:
        return asdict(difference(answer.skin, limit, rest))

    rows = [
        answer.describe(name_layers(count)) | {"energy": answer.energy, "across": to_limit(answer, across.positions)}
        for count, answer in zip(SUB_LAYERS, answers, strict=True)
    ]
    rows.append(split.describe(SPLIT) | {"energy": split.energy})
    for line, answer in ((rows[SUB_LAYERS.index(ALONG)], unsplit), (rows[-1], split)):
        line["along"] = to_limit(answer, along.positions)
    rows[0] |= to_limit(answers[0], across.positions + (along.positions - unsplit.skin))
    return {
        "rows": rows,
        "moved_mm": float(distances(answers[0].skin, rest).max()),
        "order_across": across.observed,
        "gci_across_mm": across.index,
        "gci_along_mm": along.index,
    }


def _solve_pd(head: LayeredHead, shape: Floats, count: int) -> Answer:
    scene = facial_scene(head, Parameters(), shape, bones="prescribed", layers=(count, count))
    return find_answer(head, shape, scene, tolerance=LINEAR_TOLERANCE)


class LawOnHead:
    """One expression by the neo-Hookean law of a Poisson's ratio, and what this process has solved of it."""

    def __init__(self, head: LayeredHead, shape: Floats, poisson: float):
        self._head, self._shape, self._poisson = head, shape, poisson
        self._element = "P2P1" if poisson >= 0.49 else "P2"  # from there on with a pressure
        self._linear = solve_linear(head, shape, poisson)
        self._quadratic = self._solve_quadratic(head, self._linear)
        self._motion = distances(self._quadratic.skin, shape)

    def compare_sub_layers(self, counts: Sequence[int]) -> list[dict]:
        """Compare linear tets with quadratic ones; `counts` of sub-layers begin with one."""
        finer = {n: solve_linear(self._head, self._shape, self._poisson, (n, n)) for n in counts[1:]}
        reference = {"reference": self._element, "reference_iterations": self._quadratic.iterations}
        return [
            compare(name_layers(count), answer, self._quadratic.skin, self._motion) | reference
            for count, answer in {1: self._linear, **finer}.items()
        ]

    def compare_free_tets(self, size: float) -> list[dict]:
        """Compare free tets of so many mm, which share no inner edge with split prisms, element by element."""
        free = remesh(self._head, size)
        linear = solve_linear(free, self._shape, self._poisson)
        quadratic = self._solve_quadratic(free, linear)
        pairs = (("P1", linear, self._linear), (self._element, quadratic, self._quadratic))
        return [compare(what, answer, own.skin, self._motion) for what, answer, own in pairs]

    def _solve_quadratic(self, head: LayeredHead, near: Answer) -> Answer:
        scene = make_law_scene(head, self._shape, self._poisson)
        how: dict[str, Any] = {"start": near.positions, "tolerance": QUADRATIC_TOLERANCE}
        if self._element == "P2P1":
            how = {"tolerance": PRESSURE_TOLERANCE}
        return find_answer(head, self._shape, scene, solver="fenicsx", element=self._element, **how)


def solve_linear(head: LayeredHead, shape: Floats, poisson: float, layers: tuple[int, int] = (1, 1)) -> Answer:
    """Solve linear tets of the neo-Hookean law."""
    scene = make_law_scene(head, shape, poisson, layers)
    return find_answer(head, shape, scene, solver="fenicsx", tolerance=LINEAR_TOLERANCE)


def compare_mirrored_loads(person: Person, size: float) -> list[dict]:
    """Compare a one-sided smile with its mirror image, on split prisms and free tets of a symmetric skin.

    SoftdecaError for a skin that is not its own mirror image.
    """
    rest = person.head.skin.vertices
    displacement = person.shape(ONE_SIDED) - rest
    twins = find_twins(rest)
    if twins is None:
        raise SoftdecaError("the mean skin is not its own mirror image")
    rows = []
    for what, head in ((SPLIT_PRISMS, person.head), (FREE_TETS, remesh(person.head, size))):
        shapes = [rest + displacement, rest + displacement[twins] * MIRROR]
        left, right = (solve_linear(head, shape, SOFT) for shape in shapes)
        motion = distances(right.skin, shapes[1])
        rows.append(compare(what, left, right.skin[twins] * MIRROR, motion[twins]))
    return rows


def compare(what: str, answer: Answer, reference: Floats, motion: Floats) -> dict[str, Any]:
    """Give a mesh's line: the skin's distances [mm] to a reference (n, 3), also over how far it moves (n,) [mm]."""
    away = distances(answer.skin, reference)
    ruler: Mapping[str, Any] = asdict(measure(away, motion))
    # Where nothing moves there is no share.
    share = {"share": ruler["share"], "moving": ruler["vertices"]} if ruler["vertices"] else {"moving": 0}
    return answer.describe(what) | {
        "mean": float(away.mean()),
        "max": float(away.max()),
        "over_all": float(away.mean() / motion.mean()),
        "moved": float(motion.mean()),
        **share,
    }


def name_layers(count: int) -> str:
    """Name linear tets of so many sub-layers of the own surface."""
    return f"P1, {count} sub-layer{'s' * (count > 1)}"
