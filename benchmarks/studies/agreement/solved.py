"""A case on a person with what has been solved of it, each answer once: by PD, FEniCSx, scikit-fem and another law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.mesh import Floats
from ....reference import Face, Scene, SettledFace, Solution, prepare, projective, settle, solve, terms
from ....reference.face.facial import FaceLaw, apply_law
from ....surrogate import Surrogate
from ....surrogate import methods as m
from ....surrogate.ruler import measure
from ...harness.first_screen import ALL_VERTICES, SKIN
from ..cases import Case
from ..measures import (
    ACCURACY,
    NEO_HOOKEAN,
    PD_ENERGY,
    TIGHT,
    Trace,
    difference,
    distances,
    trace_solve,
    trace_to_itself,
)
from ..person import Person
from .insides import compare_insides

WARM = 1e-9
"""Gradient norm over its start of those that start at PD's answer, where it is smaller already."""
ROUGH = 1e-6
"""PD is stopped here to start scikit-fem, whose part is to check the answer and not to be fast."""
APART = 1e-4
"""Of the largest displacement: converged answers that are farther apart than this are two minima."""
PLAIN_STOP, PLAIN_LIMIT = 0.005, 4000
"""Plain projective dynamics stops here [mm], below what its iterations are counted to, or after so many."""
ROUNDING = 1e-12
"""A rise of the energy by at most this share of it is rounding."""
TRUTHS: Mapping[str, str] = {
    m.PD: m.FENICSX,
    m.PD_PLAIN: m.PD,
    m.FENICSX: m.PD,
    m.SKFEM: m.FENICSX,
    m.FENICSX_NEO_HOOKEAN: m.PD,
    m.SKFEM_NEO_HOOKEAN: m.FENICSX_NEO_HOOKEAN,
}
"""Solvers, and the one that each is compared with."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A solver's answer to a case: `solution` of `scene`, and the skin [mm], shape (n, 3).

    settled: where this solver settles the neutral face; None where no target follows one. start: where it began.
    another: how far [mm] from PD's answer it ended first, where that is another minimum. trace: the way, if kept.
    """

    solution: Solution
    scene: Scene
    settled: SettledFace | None
    skin: Floats
    start: str
    another: float | None = None
    trace: Trace | None = None

    @property
    def converged(self) -> bool:
        """Whether the neutral face and the scene came to rest, be it with cells inside out."""
        return self.solution.is_balanced and (self.settled is None or self.settled.converged)


def find_start(settled: SettledFace | None, scene: Scene) -> Floats:
    """Return where a solve of a scene begins [mm], shape (n, 3): on the settled face, or at rest without one."""
    return scene.vertices if settled is None else settled.positions


@dataclass(frozen=True, eq=False)
class SolvedCase:
    """A case on a person; each solver's answer is computed when it is first asked, once.

    PD, FEniCSx and each law settle the neutral face by themselves, so no comparison of them shares it. Plain PD takes
    PD's scene, and scikit-fem those of FEniCSx, whose solves it checks.
    """

    person: Person
    case: Case
    network: Surrogate | None = None
    _answers: dict[str, Answer] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def face(self) -> Face:
        """The person's face under the case's p."""
        return self.person.face(self.case.parameters(self.person.head))

    @cached_property
    def shape(self) -> Floats:
        """The expression's blendshapes [mm], shape (n, 3), without p."""
        return self.face.blend(self.case.weights)

    def answer(self, solver: str) -> Answer:
        """Return a solver's answer, by its label in TRUTHS."""
        if solver not in self._answers:
            solve_case = {
                m.PD: self._solve_by_pd,
                m.PD_PLAIN: self._solve_by_plain_pd,
                m.FENICSX: self._solve_by_fenicsx,
                m.SKFEM: self._solve_by_skfem,
                m.FENICSX_NEO_HOOKEAN: self._solve_by_law,
                m.SKFEM_NEO_HOOKEAN: self._solve_law_by_skfem,
            }[solver]
            self._answers[solver] = solve_case()
        return self._answers[solver]

    def _set_scene(self, law: FaceLaw, solver: str) -> tuple[SettledFace | None, Scene]:
        """Return the neutral face that a solver settles, and the case's scene on it."""
        if self.case.scene is not None:
            return None, apply_law(self.case.scene(self.person.head), law)
        how: dict[str, Any] = {"law": law, "solver": solver, "tolerance": TIGHT, **self.face.choices}
        settled = settle(self.person.head, self.face.on_wraps, **how)
        contact = {"contact": self.case.contact} if self.case.contact else {}
        face = replace(self.face, choices={**self.face.choices, **contact}).settled_as(settled)
        return settled, face.scene(self.case.weights, law)

    def _skin(self, settled: SettledFace | None, solution: Solution) -> Floats:
        if settled is not None:
            face = self.face.settled_as(settled)
            return face.skin_after(self.case.weights, solution.positions, settled.law)
        head = self.person.head
        return head.skin_after(head.skin.vertices, solution.positions[: len(head.bone)])

    def _solve_by_pd(self) -> Answer:
        settled, scene = self._set_scene(PD_ENERGY, "projective")
        solution, trace = trace_to_itself(prepare(scene), start=find_start(settled, scene))
        return Answer(solution, scene, settled, self._skin(settled, solution), "settled", trace=trace)

    def _solve_by_plain_pd(self) -> Answer:
        pd = self.answer(m.PD)
        solution, trace = trace_solve(
            prepare(pd.scene, method="plain"),
            pd.solution.positions,
            start=find_start(pd.settled, pd.scene),
            enough=PLAIN_STOP,
            max_iterations=PLAIN_LIMIT,
        )
        return Answer(solution, pd.scene, pd.settled, self._skin(pd.settled, solution), "settled", trace=trace)

    def _solve_by_fenicsx(self) -> Answer:
        settled, scene = self._set_scene(PD_ENERGY, "fenicsx")
        by_pd, begun, another = self.answer(m.PD).solution.positions, "settled", None
        if self.case.contact:
            frozen = projective.prepare(scene).freeze_contact(by_pd)
            solution = solve(frozen, solver="fenicsx", start=by_pd, tolerance=WARM)
            return Answer(solution, frozen, settled, self._skin(settled, solution), "PD's answer, with its pairs")
        prepared = prepare(scene, solver="fenicsx")
        solution = prepared.solve(start=find_start(settled, scene), tolerance=TIGHT)
        apart = difference(solution.positions, by_pd, scene.vertices)
        if apart.relative > APART:
            begun, another = "PD's answer", apart.max
            solution = prepared.solve(start=by_pd, tolerance=WARM)
        return Answer(solution, scene, settled, self._skin(settled, solution), begun, another)

    def _solve_by_skfem(self) -> Answer:
        fenicsx = self.answer(m.FENICSX)
        rough = solve(fenicsx.scene, tolerance=ROUGH).positions
        solution = solve(fenicsx.scene, solver="skfem", tolerance=TIGHT / ROUGH, start=rough)
        skin = self._skin(fenicsx.settled, solution)
        return Answer(solution, fenicsx.scene, fenicsx.settled, skin, "PD, stopped early")

    def _solve_by_law(self) -> Answer:
        settled, scene = self._set_scene(NEO_HOOKEAN, "fenicsx")
        by_pd, start, begun = self.answer(m.PD).solution, find_start(settled, scene), "settled"
        if by_pd.volume_ratio.min() > 0.0:  # where a tet is inverted the law is infinite
            start, begun = by_pd.positions, "PD's answer"
        solution = solve(scene, solver="fenicsx", tolerance=WARM, start=start)
        return Answer(solution, scene, settled, self._skin(settled, solution), begun)

    def _solve_law_by_skfem(self) -> Answer:
        law, by_pd = self.answer(m.FENICSX_NEO_HOOKEAN), self.answer(m.PD).solution
        start = by_pd.positions if by_pd.volume_ratio.min() > 0.0 else law.solution.positions
        solution = solve(law.scene, solver="skfem", tolerance=WARM, start=start)
        return Answer(solution, law.scene, law.settled, self._skin(law.settled, solution), law.start)

    @cached_property
    def without(self) -> SolvedCase | None:
        """The same expression without the effect and without contact; None if the case is no effect."""
        if self.case.without is None:
            return None
        plain = Case(self.case.name, "without", self.case.expression, self.case.without)
        return SolvedCase(self.person, plain)

    @cached_property
    def other_start(self) -> Solution:
        """PD's answer from where every wrap is moved by the skin wrap's way to its targets, bone or not.

        Such a start inverts tets.
        """
        head, pd = self.person.head, self.answer(m.PD)
        assert pd.settled is not None
        targets = head.wrap_targets(pd.settled.targets(self.shape))
        return prepare(pd.scene).solve(
            start=head.vertices + np.tile(targets - head.skin_wrap.vertices, (3, 1)), tolerance=TIGHT
        )

    @cached_property
    def skins(self) -> dict[str, Floats]:
        """The skins [mm] of the methods that solve no expression, by label; p beyond what a network knows is clamped.

        A scene without targets has none, and without a network the methods that need one are left out.
        """
        if self.case.scene is not None:
            return {}
        methods = m.ready_methods(self.network, beyond="clamp")
        weights = self.case.weights
        return {name: method.bind(self.face).frame(weights).astype(np.float64) for name, method in methods.items()}

    def compare(self, method: str, truth: str) -> list[dict]:
        """Measure a method's distance to a solver's answer: over all vertices, if it has them, and over the skin.

        The skin's `share` is by `surrogate.ruler`; None in a scene without targets, and where bones explain all.
        """
        other, head, lines = self.answer(truth), self.person.head, []
        skin = self.skins.get(method)
        if skin is None:
            solved = self.answer(method)
            skin = solved.skin
            apart = difference(solved.solution.positions, other.solution.positions, other.scene.vertices)
            lines.append({"to": truth, "over": ALL_VERTICES, **asdict(apart)})
        beside = asdict(difference(skin, other.skin, head.skin.vertices))
        return [*lines, {"to": truth, "over": SKIN, **beside, "share": self._share(skin, other.skin)}]

    def _share(self, skin: Floats, truth: Floats) -> float | None:
        if self.case.scene is not None:
            return None
        figures = measure(distances(skin, truth), distances(truth, self.shape + self.face.carried))
        return figures.share if figures.vertices else None

    def tell_solve(self, solver: str) -> dict:
        """Say what a solver did."""
        answer = self.answer(solver)
        norms = answer.solution.history.gradient_norm
        record = {
            "start": answer.start,
            "iterations": answer.solution.iterations,
            "linear_iterations": answer.solution.detail.get("linear_iterations"),
            "gradient": float(norms[-1] / norms[0]) if norms[0] > 0 else 0.0,
            "reason": answer.solution.reason.name,
            "done": answer.converged,
        }
        if answer.trace is not None:
            record["to_001_mm"] = answer.trace.iterations_to(ACCURACY)
        if solver == m.PD_PLAIN:
            record["done"] = record["to_001_mm"] is not None
        if solver == m.FENICSX:
            record["another_minimum_mm"] = answer.another
        return record

    def tell_face(self) -> dict:
        """Say what PD's answer is: volumes, whether it is the only one, how near lips come, what an effect changes."""
        pd, head = self.answer(m.PD), self.person.head
        solution, soft = pd.solution, slice(0, len(head.soft.tets))
        volumes = pd.scene.volumes[soft]
        record: dict[str, Any] = {
            "least_ratio": float(solution.volume_ratio.min()),
            "soft_volume_percent": float(100.0 * (solution.volume_ratio[soft] @ volumes / volumes.sum() - 1.0)),
        }
        if self.case.contact:
            (contact,) = pd.scene.of(terms.Contact)
            assert self.without is not None
            free = self.without.answer(m.PD).solution
            for when, each in (("before", free), ("after", solution)):
                pairs, depth = TriangleTree(each.positions, contact.triangles).measure_overlap()
                record |= {f"crossings_{when}": pairs, f"overlap_{when}_mm": depth}
        if pd.settled is not None:
            if not self.case.contact:  # the way without contact, until something is met, is in the history, too
                energy = solution.history.energy
                size = np.maximum(np.abs(energy[:-1]), np.finfo(float).tiny)
                record["energy_rise"] = float(np.max(np.diff(energy) / size, initial=0.0))
            record["to_other_start_mm"] = float(distances(solution.positions, self.other_start.positions).max())
            record["neutral_change_mm"] = float(distances(pd.settled.skin, head.skin.vertices).max())
            gaps = distances(solution.positions[: len(head.bone)], head.wrap_targets(pd.settled.targets(self.shape)))[
                head.regions["lips"]
            ]
            record["lips_mm"] = [float(np.median(gaps)), float(np.percentile(gaps, 95)), float(gaps.max())]
        if self.without is not None:
            change = distances(pd.skin, self.without.answer(m.PD).skin)
            record |= {"change_mean_mm": float(change.mean()), "change_max_mm": float(change.max())}
        return record

    def compare_inside(self) -> dict:
        """Compare PD's answer with the law's inside; see `compare_insides`."""
        pd, law = self.answer(m.PD), self.answer(m.FENICSX_NEO_HOOKEAN)
        settled = None if pd.settled is None or law.settled is None else (pd.settled, law.settled)
        both = (PD_ENERGY, pd.scene, pd.solution), (NEO_HOOKEAN, law.scene, law.solution)
        return compare_insides(self.person.head, *both, settled=settled)
