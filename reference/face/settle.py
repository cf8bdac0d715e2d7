"""The neutral face under p: an effect such as weight, gravity or a longer jaw changes it before anything is expressed.

The paper is silent about how targets, which hold the old surface, give way to a face that has grown. Here the neutral
face settles first, with the bones at their scaled rest: where it is fleshy its flesh hangs on bone and on the face
around alone, held by no target; elsewhere skin is held where the bones carry it. That displacement is then added to
every target, so an expression moves the settled face.

A face settles under a law. Answers of two laws are compared where each face has settled by its own law: targets that
hold one law's settled face hide most of what the other law changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ...lhm.head.columns import fill_harmonically
from ...lhm.head.flesh import LEAN_REGIONS, flesh_share
from ...lhm.head.head import FREE, LayeredHead
from .. import projective, terms
from ..added import all_solvers
from ..scene import Scene
from ..solution import OnIteration, Reason, Solution
from ..solve import prepare
from .bones import scale_skull
from .facial import PD_ENERGY, FaceLaw, apply_law, facial_scene
from .parameters import Parameters
from .tissue import Stack

TOLERANCE = 1e-6
"""Gradient norm relative to its start."""
ROUGH = 1e-4
"""Gradient norm relative to its start of PD's answer, from which another law starts."""
TARGET_OPTIONS: dict[str, Any] = {"tolerance": 1e-4, "max_iterations": 2000}
"""Options of a face that only targets follow: it need be no more exact than they are."""
GROWING = ("soft_volume", "muscle_volume", "skin_growth")
"""Besides bone scales and added gravity, what changes a neutral face where it differs from 1."""


@dataclass(frozen=True, eq=False)
class SettledFace:
    """Rest of a head's neutral face under p.

    positions (scene's vertices, 3) [mm]: of the tets; neutral (skin vertices, 3) [mm]: the skin without p, which has
    moved by `displacement`, of the same shape. `solution` is None where p leaves the neutral face as it is. `law` is
    the one by which it settled.
    """

    positions: Floats
    neutral: Floats
    displacement: Floats
    solution: Solution | None = None
    law: FaceLaw = PD_ENERGY

    @property
    def skin(self) -> Floats:
        """The neutral skin [mm] under p, shape (skin vertices, 3)."""
        return self.neutral + self.displacement

    @property
    def converged(self) -> bool:
        """Whether it came to rest."""
        return self.solution is None or self.solution.is_balanced

    @property
    def reason(self) -> Reason:
        """Why settling stopped."""
        return Reason.CONVERGED if self.solution is None else self.solution.reason

    def targets(self, expression: Floats) -> Floats:
        """Return the skin's targets [mm] for an expression of the head without p, both (..., skin vertices, 3)."""
        return expression + self.displacement


def settle(
    head: LayeredHead,
    parameters: Parameters,
    *,
    law: FaceLaw = PD_ENERGY,
    solver: str | None = None,
    element: str | None = None,
    start: Floats | None = None,
    tolerance: float = TOLERANCE,
    max_iterations: int | None = None,
    on_iteration: OnIteration | None = None,
    **choices: Any,
) -> SettledFace:
    """Settle the neutral face under p by a law; solve only where p changes it.

    `Face.scene` has the expressions of a face that has settled.
    `law` is "PD" for projective dynamics' own energy, "neo-Hookean", the name of a law that was added, or a function of
    Lamé's moduli (see `apply_law`). `solver` is by default "projective" for PD's energy and "fenicsx" for
    another law, which starts at PD's answer, or where bones carry the tets if PD's answer has inverted ones.
    `element` is the solver's; `start` [mm] is a stack's positions, as of a face that has settled by another one.
    `choices` go to `facial_scene`; other solvers than PD take contact as the pairs near in PD's answer. A head without
    the regions that tell where it has flesh is held everywhere. An answer that has not converged says so by `reason`.
    `on_iteration` may interrupt it; see `solve`. Raises what `facial_scene`, `apply_law` and the solver raise.
    """
    if not 0.0 < tolerance < 1.0:
        raise SceneError(f"tolerance: expected a number in (0, 1), got {tolerance}")
    if solver is None:
        solver = "projective" if law == PD_ENERGY else "fenicsx"
    if solver not in all_solvers():
        raise SceneError(f"unknown solver {solver!r}; there are {', '.join(all_solvers())}")
    stack = Stack.from_head(head, choices.get("layers", (1, 1)), choices.get("without", ()))
    if not changes_neutral(parameters):
        kept = apply_law(facial_scene(head, parameters, head.skin.vertices, **choices), law)
        return SettledFace(kept.vertices, head.skin.vertices, np.zeros_like(head.skin.vertices), law=law)
    scene = neutral_scene(head, parameters, **choices)
    given = start is not None
    if start is None:
        start = np.array(scene.vertices)
        start[: len(stack.vertices)] = carry_by_bones(head, parameters, stack)
    if solver != "projective" and scene.of(terms.Contact):  # others take the pairs that projective dynamics finds
        prepared = projective.prepare(scene)
        scene = prepared.freeze_contact(prepared.solve(start=start, tolerance=ROUGH).positions)
    if law != PD_ENERGY:
        start, scene = start if given else _start_of_law(scene, start), apply_law(scene, law)
    options = {} if element is None else {"element": element}
    solution = prepare(scene, solver=solver, **options).solve(
        start=start, tolerance=tolerance, max_iterations=max_iterations, on_iteration=on_iteration
    )
    displacement = solution.positions[: len(head.bone)] - head.skin_wrap.vertices
    return SettledFace(solution.positions, head.skin.vertices, head.skin_from_wrap @ displacement, solution, law)


def _start_of_law(scene: Scene, start: Floats) -> Floats:
    """Return PD's answer to a scene [mm], or `start` where PD inverts a tet: there a law's energy may be infinite."""
    by_pd = prepare(scene).solve(start=start, tolerance=ROUGH)
    return by_pd.positions if by_pd.converged and by_pd.volume_ratio.min() > 0.0 else start


def changes_neutral(parameters: Parameters) -> bool:
    """Whether the neutral face is not at rest under p: another volume, area, bone or gravity than it was made with."""
    scales = np.concatenate([parameters.scale(bone) for bone in ("cranium", "mandible")])
    grown = any(np.any(np.asarray(getattr(parameters, name)) != 1.0) for name in GROWING)
    return grown or bool(np.any(scales != 1.0)) or bool(np.any(parameters.added_gravity))


def neutral_scene(head: LayeredHead, parameters: Parameters, **choices: Any) -> Scene:
    """Build the scene in which the neutral face settles.

    Bones are at their scaled rest, and no target is where the face is fleshy. A palsy takes no part: it changes
    only how a face is drawn to an expression.
    """
    parameters = replace(parameters, paralysis_left=0.0, paralysis_right=0.0)
    skin = head.skin.vertices + carry_skin(head, parameters)
    scene = facial_scene(head, parameters, skin, **choices | {"bones": "prescribed", "neutral": skin})
    share = 1.0 - (flesh_share(head) if all(name in head.regions for name in (*LEAN_REGIONS, "face", "neck")) else 0.0)
    return replace(
        scene,
        terms=tuple(
            replace(t, stiffness=t.stiffness * share) if isinstance(t, terms.Target) else t for t in scene.terms
        ),
    )


def bones_displacement(head: LayeredHead, parameters: Parameters) -> Floats:
    """Displace the wraps [mm], shape (n, 3), with the bones that p scales, harmonic along the skull between."""
    motion = scale_skull(head, parameters) - head.skull_wrap.vertices
    return fill_harmonically(head.skull_wrap.triangles, motion, head.bone != FREE) if motion.any() else motion


def carry_skin(head: LayeredHead, parameters: Parameters) -> Floats:
    """Displace the neutral skin with the bones that p scales, without physics [mm], shape (skin vertices, 3)."""
    return head.skin_from_wrap @ bones_displacement(head, parameters)


def carry_by_bones(head: LayeredHead, parameters: Parameters, stack: Stack | None = None) -> Floats:
    """Move a stack's vertices [mm], by default the stacked wraps', with `bones_displacement`.

    A start without inverted tets, from which the energy can only fall.
    """
    stack = Stack.from_head(head, (1, 1), ()) if stack is None else stack
    motion = bones_displacement(head, parameters)
    return stack.interpolate(*(wrap.vertices + motion for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap)))
