"""An effect by each law and solver, each on the neutral face that it settles itself; and by rules without physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from ..lhm.base.mesh import Floats
from ..lhm.head import LayeredHead
from ..reference import SettledFace, Solution, prepare, settle
from ..reference.face.settle import carry_skin
from ..surrogate.ruler import Ruler, measure
from .differences import distances
from .effect_cases import Effect
from .effect_run import EffectResult
from .insides import compare_insides, load_on_mandible

PD, SAME, LAW = "PD", "PD's energy by FEM", "neo-Hookean by FEM"
SURROGATE, CARRIED, BLENDED = "surrogate", "bones carried", "settled neutral face + blendshapes"
NEO_HOOKEAN = "neo-Hookean"
TOLERANCE = 1e-8
"""Gradient norm relative to its start of a finite-element answer."""
APART = 1e-2
"""[mm] Answers to one energy that are farther apart are two minima."""


@dataclass(frozen=True, eq=False)
class LawAnswer:
    """An effect's expression by one law: the settled face, the answer, and the skin [mm], shape (skin vertices, 3).

    `another_minimum` is how far [mm] from PD's answer the solve from the settled face ends, where that is another
    minimum; the answer is then the one next to PD's.
    """

    neutral: SettledFace
    solution: Solution
    skin: Floats
    another_minimum: float | None = None


def answer_by(
    head: LayeredHead, effect: Effect, expression: Floats, result: EffectResult, law: str, solver: str
) -> LawAnswer:
    """Settle an effect's face and solve its expression by a law and a finite-element solver.

    The same energy starts at its own settled face, another law at PD's answer, or at its own settled face where PD's
    answer has inverted tets.
    """
    neutral = settle(head, effect.with_it(head), law=law, solver=solver, tolerance=TOLERANCE)
    prepared = prepare(neutral.scene(expression), solver=solver)
    by_pd = result.solution
    same = law == PD
    start = neutral.positions if same or by_pd.volume_ratio.min() <= 0.0 else by_pd.positions
    solution, another = prepared.solve(start=start, tolerance=TOLERANCE), None
    if same and (away := float(distances(solution.positions, by_pd.positions).max())) > APART:
        solution, another = prepared.solve(start=by_pd.positions, tolerance=TOLERANCE), away
    return LawAnswer(neutral, solution, neutral.skin_after(expression, solution.positions), another)


def rule_skins(head: LayeredHead, expression: Floats, neutral: SettledFace) -> dict[str, Floats]:
    """Return the skins [mm] of two rules that solve no expression: a method that loses to one of them is no use."""
    carried = expression + carry_skin(head, neutral.parameters)
    return {CARRIED: carried, BLENDED: expression + neutral.displacement}


def distances_by_method(
    skins: Mapping[str, Floats], truth: Floats, carried: Floats
) -> dict[str, dict[str, float | None]]:
    """Measure each method's skin [mm] against `truth`: over all vertices, and by `surrogate.ruler` over what moves.

    The ruler's figures are None where nothing moves but what bones carry.
    """
    motion = distances(truth, carried)
    return {name: _figures(distances(skin, truth), motion) for name, skin in skins.items()}


def compare_laws(
    head: LayeredHead, effect: Effect, expression: Floats, result: EffectResult, solver: str, others: Mapping
) -> dict:
    """Solve an effect with PD's energy and with the neo-Hookean law by `solver`, and compare all methods.

    `others` are further methods' skins [mm] by name. Distances "to_pd" and "to_law" are of skins, by method; "inside"
    compares all vertices, stresses and the mandible of PD's answer and the law's.
    """
    same, law = (answer_by(head, effect, expression, result, name, solver) for name in (PD, NEO_HOOKEAN))
    by_solver = {SAME: same.skin, LAW: law.skin}
    carried = others[CARRIED]
    answers = (same.neutral, law.neutral, same, law)
    return {
        "solver": solver,
        "done": all(a.converged if isinstance(a, SettledFace) else a.solution.converged for a in answers),
        "same_mm": float(distances(same.solution.positions, result.solution.positions).max()),
        "another_minimum_mm": same.another_minimum,
        "to_pd": distances_by_method(by_solver, result.with_it, carried),
        "to_law": distances_by_method({PD: result.with_it, SAME: same.skin, **others}, law.skin, carried),
        "inside": _inside(head, expression, result, law, solver),
    }


def _figures(error: Floats, motion: Floats) -> dict[str, float | None]:
    by_ruler: Ruler = measure(error, motion)
    moving = {key: None if value != value else value for key, value in asdict(by_ruler).items()}  # NaN is no JSON
    return {"skin_mean": float(error.mean()), "skin_max": float(error.max()), **moving}


def _inside(head: LayeredHead, expression: Floats, result: EffectResult, law: LawAnswer, solver: str) -> dict:
    """Compare the expression inside, whose mandible is free, and the load on that of each settled neutral face."""
    by_pd = PD, result.scene, result.solution
    by_law = LAW, law.neutral.scene(expression), law.solution
    faces = (PD, result.at_rest), (LAW, law.neutral)
    loads = {name: load_on_mandible(head, face.solution) for name, face in faces if face.solution is not None}
    return compare_insides(head, by_pd, by_law, solver=solver) | {"prescribed": loads}
