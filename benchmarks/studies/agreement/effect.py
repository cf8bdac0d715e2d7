"""An effect on a head by name: simulated, by finite elements and two laws, by rules of thumb and the network; drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from ....lhm import expressions
from ....lhm.base.mesh import Floats
from ....lhm.head.flesh import cheek_share, flesh_share, mean_on_triangles
from ....lhm.head.head import LayeredHead
from ....lhm.identities.space import LinearSpace
from ....reference import Face, Parameters, Scene, SettledFace, Solution, facial_scene, prepare, settle
from ....reference.face.settle import carry_skin
from ....surrogate import Surrogate
from ....surrogate.methods import CARRIED, FENICSX, FENICSX_NEO_HOOKEAN, PD, SETTLED, SKFEM, SKFEM_NEO_HOOKEAN
from ....surrogate.ruler import measure
from ..measures import NEO_HOOKEAN, PD_ENERGY, distances
from ..person import check_known
from .insides import compare_insides

SMILE = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.6, "jawOpen": 0.2}
BROAD_SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0, "jawOpen": 0.2}
SNEER = SMILE | {"noseSneerLeft": 0.6, "noseSneerRight": 0.6}
LEAN = 1.6
"""Soft tissue's stiffness [kPa] of fat and SMAS (Barbarino et al. 2011), where weight is what is looked at."""
SOLVED = {"fenicsx": (FENICSX, FENICSX_NEO_HOOKEAN), "skfem": (SKFEM, SKFEM_NEO_HOOKEAN)}
"""Labels of PD's energy and of the neo-Hookean law, by solver."""
TOLERANCE, TIGHT, FEM_TOLERANCE = 1e-6, 1e-10, 1e-8
"""Gradient norm relative to its start: of what is measured, of what it is compared with, and by finite elements."""
ROUNDING = 1e-12
"""A rise of the energy by at most this share of it is rounding."""
APART = 1e-2
"""[mm] Answers to one energy that are farther apart are two minima."""


@dataclass(frozen=True)
class Effect:
    """Parameters `with_it`, and `without` it, of one head; an expression as ARKit weights; what the paper shows.

    `contact` names regions that are kept apart with it.
    """

    name: str
    shown: str
    expression: Mapping[str, float]
    with_it: Callable[[LayeredHead], Parameters]
    without: Callable[[LayeredHead], Parameters] = lambda head: Parameters()
    contact: tuple[str, ...] = ()

    def weights(self) -> Floats:
        """Give the expression's weights, shape (52,)."""
        return expressions.weights_of(dict(self.expression))


def grow_flesh(share: float) -> Callable[[LayeredHead], Parameters]:
    """Give parameters with flesh of that share more volume."""
    return lambda head: Parameters(soft_volume=1.0 + share * mean_on_triangles(head, flesh_share(head)))


def loosen_cheeks(head: LayeredHead) -> Parameters:
    """Give parameters whose targets are a tenth as stiff in the cheeks."""
    return Parameters(target_stiffness=10.0 ** (1.0 - mean_on_triangles(head, cheek_share(head))))


def stiffen_cheeks(head: LayeredHead) -> Parameters:
    """Give the same with a stiff skin there, which wrinkles."""
    share = mean_on_triangles(head, cheek_share(head))
    return replace(loosen_cheeks(head), skin_stiffness=20.0 * 15.0**share, skin_bending=3.0 * share)


EFFECTS = (
    Effect(
        "bells-palsy",
        "Figure 1: one half of the face does not follow the expression",
        BROAD_SMILE,
        lambda head: Parameters(paralysis_left=1.0),
    ),
    Effect("weight-20", "Figure 7 g: soft tissue's volume raised by 20 %", SMILE, grow_flesh(0.2)),
    Effect("weight-40", "Figure 7 h: soft tissue's volume raised by 40 %", SMILE, grow_flesh(0.4)),
    Effect(
        "jaw",
        "Figure 7 d: the jaw is lengthened vertically, volume kept",
        SMILE,
        lambda head: Parameters(mandible_scale_y=1.15),
    ),
    Effect(
        "zombie",
        "Figure 7 f: the area of the skin grows",
        SMILE,
        lambda head: Parameters(
            skin_growth=1.0 + 0.4 * mean_on_triangles(head, flesh_share(head)), skin_stiffness=100.0, skin_bending=20.0
        ),
    ),
    Effect(
        "gravity-3",
        "Figure 7 c: gravity is increased",
        SMILE,
        lambda head: Parameters(gravity=3.0, soft_stiffness=LEAN),
        lambda head: Parameters(soft_stiffness=LEAN),
    ),
    Effect(
        "lying",
        "3.3.3: another direction of gravity, here of one who lies on the back",
        SMILE,
        lambda head: Parameters(gravity_y=0.0, gravity_z=-1.0, soft_stiffness=LEAN),
        lambda head: Parameters(soft_stiffness=LEAN),
    ),
    Effect(
        "wrinkles",
        "Figure 7 b: the skin's strain weighs more in the cheeks, which wrinkle",
        SNEER,
        stiffen_cheeks,
        loosen_cheeks,
    ),
    Effect(
        "collisions",
        "Figure 7 a: lips that would go through each other are parted",
        {"mouthShrugLower": 1.0},
        lambda head: Parameters(),
        contact=("lips", "mouth"),
    ),
)
"""Weights of expressions and sizes of effects that the paper does not give are this project's.

A broad smile folds the skin beside the mouth's corners, and under 3 g with two minima, 1 mm apart, which no skin, a
skin of 5 mN/mm or a bending of 20 mN mm makes one: hence the smile of 0.6. Grown skin has one minimum only where it
bends, hence the zombie's bending; cheeks whose targets are as stiff as everywhere cannot wrinkle, hence the loose ones.
"""


def parse_effects(names: str) -> tuple[Effect, ...]:
    """Give the effects of a list of names between commas; all for an empty one. InputError for an unknown name."""
    known = {effect.name: effect for effect in EFFECTS}
    asked = [name.strip() for name in names.split(",") if name.strip()] or list(known)
    check_known("effect", asked, known)
    return tuple(known[name] for name in dict.fromkeys(asked))


@dataclass(frozen=True, eq=False)
class EffectResult:
    """PD's answer to an effect: figures, the settled face, and the expression's scene and solution.

    neutral, without and with_it are skins [mm], shape (skin vertices, 3); `plain` is the answer without the effect.
    """

    record: dict
    at_rest: SettledFace
    scene: Scene
    solution: Solution
    plain: Solution
    neutral: Floats
    without: Floats
    with_it: Floats


def simulate_expression(head: LayeredHead, effect: Effect, expression: Floats) -> tuple[SettledFace, Solution]:
    """Settle the neutral face under an effect, and solve the expression from there.

    expression [mm], shape (skin vertices, 3), is that of the head without the effect.
    """
    at_rest = settle(head, effect.with_it(head))
    scene = at_rest.scene(expression, contact=effect.contact)
    return at_rest, prepare(scene).solve(start=at_rest.positions, tolerance=TOLERANCE)


def run_effect(head: LayeredHead, effect: Effect, expression: Floats) -> EffectResult:
    """Solve an effect's scenes by PD and compare the answer with a tight run from another start.

    The other start moves every wrap by the skin wrap's way to its targets, bone or not. expression [mm], shape (skin
    vertices, 3), is that of the head without the effect.
    """
    at_rest, solution = simulate_expression(head, effect, expression)
    scene, targets = at_rest.scene(expression, contact=effect.contact), at_rest.targets(expression)
    answer = solution.positions
    plain_scene = facial_scene(head, effect.without(head), expression, bones="rigid")
    plain = prepare(plain_scene).solve(start=plain_scene.vertices, tolerance=TOLERANCE)
    displaced = head.vertices + np.tile(head.wrap_targets(targets) - head.skin_wrap.vertices, (3, 1))
    prepared = prepare(scene)
    other = prepared.solve(start=displaced, tolerance=TIGHT)
    near = prepared.solve(start=answer, tolerance=TIGHT / TOLERANCE)
    without = head.skin_after(expression, plain.positions[: len(head.bone)])
    with_it = at_rest.skin_after(expression, answer)
    change = distances(without, with_it)
    record = {
        "name": effect.name,
        "shown": effect.shown,
        "expression": dict(effect.expression),
        "runs": {
            name: _figures(head, scene, run)
            for name, run in (("neutral", at_rest.solution), ("with", solution), ("without", plain))
            if run is not None
        },
        "to_own_limit_mm": float(distances(answer, near.positions).max()),
        "to_other_start_mm": float(distances(answer, other.positions).max()),
        "other_start": {"iterations": other.iterations, "converged": other.converged, "energy": other.energy},
        "change_mm": {"mean": float(change.mean()), "max": float(change.max())},
        "neutral_change_mm": float(distances(at_rest.skin, head.skin.vertices).max()),
        **{name: value for name, value in solution.detail.items() if name.startswith("contact")},
    }
    return EffectResult(record, at_rest, scene, solution, plain, at_rest.skin, without, with_it)


def _figures(head: LayeredHead, scene: Scene, solution: Solution) -> dict:
    history, rise = solution.history, None
    if "contact_rounds" not in solution.detail:  # each round of contact has an energy of its own
        size = np.maximum(np.abs(history.energy[:-1]), np.finfo(float).tiny)
        rise = float(np.max(np.diff(history.energy) / size, initial=0.0))
    soft = slice(0, len(head.soft.tets))
    volumes = scene.volumes[soft]
    first = history.gradient_norm[0]
    return {
        "iterations": solution.iterations,
        "seconds": float(history.time[-1]),
        "converged": solution.converged,
        "reason": str(solution.reason),
        "gradient_ratio": float(history.gradient_norm[-1] / first) if first > 0 else 0.0,
        "largest_rise": rise,
        "monotone": None if rise is None else rise <= ROUNDING,
        "energy": solution.energy,
        "inverted_tets": int(np.count_nonzero(solution.volume_ratio <= 0)),
        "smallest_volume_ratio": float(solution.volume_ratio.min()),
        "soft_volume_percent": float(100.0 * (solution.volume_ratio[soft] @ volumes / volumes.sum() - 1.0)),
    }


def apply_rules(head: LayeredHead, expression: Floats, neutral: SettledFace) -> dict[str, Floats]:
    """Give the skins [mm] of two rules that solve no expression: a method that loses to one of them is no use."""
    carried = expression + carry_skin(head, neutral.parameters)
    return {CARRIED: carried, SETTLED: expression + neutral.displacement}


def predict_skin(space: LinearSpace, code: Floats, head: LayeredHead, effect: Effect) -> Floats | None:
    """Predict an effect's expression by the shipped network, (n, 3) [mm]; None for people that it does not know.

    It takes parameters beyond what it has seen at the nearest that it has.
    """
    network = Surrogate.load()
    if network.space != space.name:
        return None
    face = Face(head, space.expression_deltas(code), effect.with_it(head), per="wraps", code=code)
    return network.bind_face(face, beyond="clamp").frame(effect.weights()).astype(np.float64)


def measure_skins(skins: Mapping[str, Floats], truth: Floats, carried: Floats) -> dict[str, dict[str, float | None]]:
    """Measure each method's skin [mm] against `truth`: over all vertices, and by `surrogate.ruler` over what moves.

    The ruler's figures are None where nothing moves but what bones carry.
    """
    motion, figures = distances(truth, carried), {}
    for name, skin in skins.items():
        error = distances(skin, truth)
        moving = {key: None if value != value else value for key, value in asdict(measure(error, motion)).items()}
        figures[name] = {"skin_mean": float(error.mean()), "skin_max": float(error.max()), **moving}
    return figures


def compare_laws(
    head: LayeredHead, effect: Effect, expression: Floats, result: EffectResult, solver: str, others: Mapping
) -> dict:
    """Solve an effect with PD's energy and with the neo-Hookean law by a finite-element solver; compare all methods.

    Each law settles the neutral face. The same energy starts there, and next to PD's answer too where it ends in
    another minimum, so far away [mm]; the other law starts at PD's answer unless that has inverted tets. `others` are
    further methods' skins [mm] by name. Distances "to_pd" and "to_law" are of skins, by method; "inside" compares all
    vertices, stresses and the mandible of PD's answer and the law's.
    """
    same_label, law_label = SOLVED[solver]
    by_pd, carried, another = result.solution, others[CARRIED], None
    same_face, law_face = (
        settle(head, effect.with_it(head), law=law, solver=solver, tolerance=FEM_TOLERANCE)
        for law in (PD_ENERGY, NEO_HOOKEAN)
    )
    prepared = prepare(same_face.scene(expression), solver=solver)
    same = prepared.solve(start=same_face.positions, tolerance=FEM_TOLERANCE)
    if (away := float(distances(same.positions, by_pd.positions).max())) > APART:
        same, another = prepared.solve(start=by_pd.positions, tolerance=FEM_TOLERANCE), away
    law_scene = law_face.scene(expression)
    start = law_face.positions if by_pd.volume_ratio.min() <= 0.0 else by_pd.positions
    law = prepare(law_scene, solver=solver).solve(start=start, tolerance=FEM_TOLERANCE)
    skins = {
        same_label: same_face.skin_after(expression, same.positions),
        law_label: law_face.skin_after(expression, law.positions),
    }
    inside = compare_insides(
        head,
        (PD_ENERGY, result.scene, by_pd),
        (NEO_HOOKEAN, law_scene, law),
        solver=solver,
        settled=(result.at_rest, law_face),
    )
    return {
        "solver": solver,
        "done": all(each.converged for each in (same_face, law_face, same, law)),
        "same_mm": float(distances(same.positions, by_pd.positions).max()),
        "another_minimum_mm": another,
        "to_pd": measure_skins(skins, result.with_it, carried),
        "to_law": measure_skins(
            {PD: result.with_it, same_label: skins[same_label], **others}, skins[law_label], carried
        ),
        "inside": inside,
    }
