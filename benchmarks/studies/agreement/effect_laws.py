"""An effect by other means: finite elements, rules of thumb that move a skin, and the network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from ....lhm import expressions
from ....lhm.base.mesh import Floats
from ....lhm.head import LayeredHead
from ....lhm.identities.space import LinearSpace
from ....reference import Parameters, SettledFace, Solution, prepare, settle
from ....reference.face.settle import carry_skin
from ....surrogate import Surrogate
from ....surrogate.local import around_vertices
from ....surrogate.ruler import Ruler, measure
from ..measures import distances
from .effect_cases import Effect, EffectResult
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


def surrogate_skin(space: LinearSpace, code: Floats, head: LayeredHead, effect: Effect) -> Floats | None:
    """The shipped network's skin [mm] (n, 3) of an effect's expression; None for people that it does not know.

    Parameters beyond what it has seen are taken at the nearest that it has.
    """
    network = Surrogate.load()
    if network.space != space.name:
        return None
    rig = network.bind(head.skin, code, on_skin(effect.with_it(head), head), beyond="clamp")
    return rig.frame(expressions.weights_of(dict(effect.expression))).astype(np.float64)


def on_skin(parameters: Parameters, head: LayeredHead) -> Parameters:
    """The same parameters with local values per face of the skin in place of triangles of the wraps."""
    moved = {}
    for field in fields(parameters):
        value = np.asarray(getattr(parameters, field.name))
        if value.shape == (len(head.skin_wrap.triangles),):
            # Skin off the wrap's triangles is beyond their corners, and must not leave the values' range.
            there = np.clip(head.skin_from_wrap @ around_vertices(value, head.skin_wrap), value.min(), value.max())
            moved[field.name] = there[head.skin.triangles].mean(axis=1)
    return replace(parameters, **moved)
