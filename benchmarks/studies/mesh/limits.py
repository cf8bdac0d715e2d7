"""Two limits of linear tets on a head: ever finer meshes, and quadratic tets on the same mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from ....lhm.base.mesh import Floats
from ....lhm.head.head import LayeredHead
from ....lhm.head.remesh import refine_head
from ....reference import Parameters, Scene, apply_law, facial_scene, materials, terms
from ....surrogate.ruler import measure
from ..measures import difference, distances, limit_of_three, limit_of_two, solve_to_end

SPLIT = "P1, split into eight"
SUB_LAYERS = (1, 2, 4)
ALONG = 2
"""Sub-layers of the head's own surface that compare with the split head: a layer of tets split into eight has two."""
ORDER_ALONG = 1.0
"""Of the two surface levels, assumed: smooth answers show 2, but springs and borders of bone let less be trusted."""
LINEAR_TOLERANCE, QUADRATIC_TOLERANCE, PRESSURE_TOLERANCE = 1e-7, 2e-3, 1e-6
"""Gradient norm over its start. Quadratic tets start at the linear answer, where .002 leaves the skin 0.0001 mm."""


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
    scene = facial_scene(head, Parameters(), shape, bones="prescribed", layers=(count, count), cells="tets")
    return find_answer(head, shape, scene, tolerance=LINEAR_TOLERANCE)


class LawOnHead:
    """One expression by the neo-Hookean law of a Poisson's ratio, and what this process has solved of it."""

    def __init__(self, head: LayeredHead, shape: Floats, poisson: float):
        self._head, self._shape, self._poisson = head, shape, poisson
        self._element = "P2P1" if poisson >= 0.49 else "P2"  # from there on with a pressure
        self._linear = solve_linear(head, shape, poisson)
        self._quadratic = self._solve_quadratic()
        self._motion = distances(self._quadratic.skin, shape)

    def compare_sub_layers(self, counts: Sequence[int]) -> list[dict]:
        """Compare linear tets with quadratic ones; `counts` of sub-layers begin with one."""
        finer = {n: solve_linear(self._head, self._shape, self._poisson, (n, n)) for n in counts[1:]}
        reference = {"reference": self._element, "reference_iterations": self._quadratic.iterations}
        return [
            compare(name_layers(count), answer, self._quadratic.skin, self._motion) | reference
            for count, answer in {1: self._linear, **finer}.items()
        ]

    def _solve_quadratic(self) -> Answer:
        scene = make_law_scene(self._head, self._shape, self._poisson)
        how: dict[str, Any] = {"start": self._linear.positions, "tolerance": QUADRATIC_TOLERANCE}
        if self._element == "P2P1":
            how = {"tolerance": PRESSURE_TOLERANCE}
        return find_answer(self._head, self._shape, scene, solver="fenicsx", element=self._element, **how)


def solve_linear(head: LayeredHead, shape: Floats, poisson: float, layers: tuple[int, int] = (1, 1)) -> Answer:
    """Solve linear tets of the neo-Hookean law."""
    scene = make_law_scene(head, shape, poisson, layers)
    return find_answer(head, shape, scene, solver="fenicsx", tolerance=LINEAR_TOLERANCE)


def make_law_scene(head: LayeredHead, shape: Floats, poisson: float, layers: tuple[int, int] = (1, 1)) -> Scene:
    """Make an expression's neo-Hookean scene of a Poisson's ratio, with prescribed bones."""
    by_tets = facial_scene(head, Parameters(), shape, bones="prescribed", layers=layers, cells="tets")
    scene = apply_law(by_tets, "neo-Hookean")
    parts: list[terms.Term] = []
    for term in scene.terms:
        if isinstance(term, terms.Hyperelastic):
            law = term.material
            assert isinstance(law, materials.NeoHookean)
            young = 2 * law.mu * (1 + poisson)
            term = replace(term, material=materials.NeoHookean.from_young(young, poisson))
        parts.append(term)
    return replace(scene, terms=tuple(parts))


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
