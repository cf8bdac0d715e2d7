"""One face of the study `agreement` with what has been solved of it, each once: by PD, FEniCSx and another law."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cached_property

import numpy as np

from ....animation.pictures import Panel, draw_strip
from ....lhm.base.mesh import Floats
from ....reference import Parameters, Scene, SettledFace, Solution, prepare, settle, solve
from ....reference.face.facial import apply_law
from ....surrogate import Surrogate
from ....surrogate.methods import BLENDSHAPES, FENICSX, NETWORK, PD, PD_PLAIN, SKFEM, SKFEM_NEO_HOOKEAN
from ..measures import ACCURACY, TIGHT, Trace, difference, distances, trace_solve, trace_to_itself
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
LAW = "neo-Hookean"
BESIDE = "side by side"
TO_PD, TO_FENICSX, TO_NEO = "to PD", "to FEniCSx", "to neo-Hookean"
ALL, SKIN = ", all vertices", ", skin"


class SolvedScene:
    """A scene of a head, the same scene under the neo-Hookean law, and the answers to both.

    Here no target holds the skin, so nothing has to settle first; a `SolvedExpression` has targets.
    """

    neutral: SettledFace | None = None
    """The neutral face as PD settles it."""

    def __init__(self, of: Person, scene: Scene):
        self.of, self.scene = of, scene

    @property
    def neutral_by_law(self) -> SettledFace | None:
        """The neutral face as the law settles it."""
        return None

    @property
    def law_scene(self) -> Scene:
        """The scene under the law."""
        return apply_law(self.scene, LAW)

    @cached_property
    def pd(self) -> tuple[Solution, Trace]:
        """PD's tight answer, and the way to it."""
        return trace_to_itself(prepare(self.scene))

    @cached_property
    def fenicsx(self) -> tuple[Solution, float | None]:
        """FEniCSx' answer to the same energy; and how far [mm] from PD's it ends from rest, where that is another."""
        answer, rest = self.pd[0].positions, self.scene.vertices
        solution = solve(self.scene, solver="fenicsx", tolerance=TIGHT)
        beside = difference(solution.positions, answer, rest)
        if beside.relative <= APART:
            return solution, None
        return solve(self.scene, solver="fenicsx", start=answer, tolerance=WARM), beside.max

    @cached_property
    def neo(self) -> tuple[Solution, Scene, Floats | None]:
        """The law's answer by FEniCSx, its scene, and its start.

        That is PD's answer; where it has inverted tets, at which the law is infinite, the settled face, else rest.
        """
        pd, scene, start = self.pd[0], self.law_scene, None
        if pd.volume_ratio.min() > 0:
            start = pd.positions
        elif self.neutral_by_law is not None:
            start = self.neutral_by_law.positions
        return solve(scene, solver="fenicsx", tolerance=WARM, start=start), scene, start

    def skin(self, solution: Solution) -> Floats:
        """Give the skin [mm] of an answer to PD's scene."""
        return self.of.head.skin_after(self.of.head.skin.vertices, solution.positions[: len(self.of.head.bone)])

    def law_skin(self, solution: Solution) -> Floats:
        """Give the skin [mm] of an answer to the law's scene."""
        return self.skin(solution)

    def solve_by(self, method: str) -> dict:
        """Solve by a method: what it did, and how far its answer is from the others'."""
        by_pd, trace = self.pd
        if method == PD:
            least = float(by_pd.volume_ratio.min())
            row = self._row(by_pd, "rest", TO_FENICSX, self.fenicsx[0])
            return row | {"to_001_mm": trace.iterations_to(ACCURACY), "least_ratio": least}
        if method == PD_PLAIN:
            plain = prepare(self.scene, method="plain")
            solution, trace = trace_solve(plain, by_pd.positions, enough=PLAIN_STOP, max_iterations=PLAIN_LIMIT)
            reached = trace.iterations_to(ACCURACY)
            row = self._row(solution, "rest", TO_PD, by_pd)
            return row | {"to_001_mm": reached, "done": reached is not None}
        if method == FENICSX:
            solution, another = self.fenicsx
            begun = "rest" if another is None else "PD's answer"
            return self._row(solution, begun, TO_PD, by_pd) | {"another_minimum_mm": another}
        if method == SKFEM:
            rough = solve(self.scene, tolerance=ROUGH).positions
            solution = solve(self.scene, solver="skfem", tolerance=TIGHT / ROUGH, start=rough)
            return self._row(solution, "PD, stopped early", TO_FENICSX, self.fenicsx[0])
        solution, scene, start = self.neo
        begun = "PD's answer" if start is by_pd.positions else "rest" if start is None else "its own settled face"
        if method == SKFEM_NEO_HOOKEAN:
            checked = solve(scene, solver="skfem", tolerance=WARM, start=start)
            return self._row(checked, begun, TO_NEO, solution)
        row = self._row(solution, begun, TO_PD, by_pd)
        skins = difference(self.law_skin(solution), self.skin(by_pd), self.of.head.skin.vertices)
        row["compared"].append({"compared": TO_PD + SKIN, **asdict(skins)})
        settled = None
        if self.neutral is not None and self.neutral_by_law is not None:
            settled = self.neutral, self.neutral_by_law
            row["done"] = row["done"] and self.neutral_by_law.converged
        both = (PD, self.scene, by_pd), (LAW, scene, solution)
        return row | {"inside": compare_insides(self.of.head, *both, settled=settled)}

    def _row(self, solution: Solution, start: str, what: str, other: Solution) -> dict:
        """What a solver did, and how far it is from another's answer over all vertices."""
        norms = solution.history.gradient_norm
        apart = difference(solution.positions, other.positions, self.scene.vertices)
        return {
            "compared": [{"compared": what + ALL, **asdict(apart)}],
            "start": start,
            "iterations": solution.iterations,
            "linear_iterations": solution.detail.get("linear_iterations"),
            "gradient": float(norms[-1] / norms[0]) if norms[0] > 0 else 0.0,
            "reason": solution.reason.name,
            "done": solution.converged,
        }

    def picture(self) -> bytes:
        """Draw at rest, simulated, under the law, and the distance of the two: PNG."""
        skin = self.of.head.skin
        simulated, law = self.skin(self.pd[0]), self.law_skin(self.neo[0])
        apart = distances(law, simulated)
        top = max(0.05, float(np.percentile(apart, 99.5)))
        panels = [
            Panel("at rest", skin),
            Panel(f"simulated ({PD})", skin.with_vertices(simulated)),
            Panel(f"{LAW} law", skin.with_vertices(law)),
            Panel(f"{LAW} - PD", skin.with_vertices(simulated), apart, top),
        ]
        return draw_strip(panels, rest=skin)


class SolvedExpression(SolvedScene):
    """An expression of a face under p, whose neutral face each law settles for its own answer."""

    neutral: SettledFace

    def __init__(self, of: Person, weights: Floats, parameters: Parameters, network: Surrogate | None):
        self.weights, self.parameters, self._network = weights, parameters, network
        self.shape = of.blend(weights[None])[0]
        self.neutral = settle(of.head, parameters)
        self.targets = self.neutral.targets(self.shape)
        super().__init__(of, self.neutral.scene(self.shape))

    @cached_property
    def neutral_by_law(self) -> SettledFace:
        """The neutral face as the law settles it."""
        return settle(self.of.head, self.parameters, law=LAW, tolerance=WARM)

    @property
    def law_scene(self) -> Scene:
        """The expression's scene under the law, on the face that the law has settled."""
        return self.neutral_by_law.scene(self.shape)

    @cached_property
    def learned(self) -> Floats:
        """The surrogate's skin [mm]."""
        assert self._network is not None
        bound = self._network.bind_face(self.of.face(self.parameters))
        return np.asarray(bound.frame(self.weights), dtype=np.float64)

    def solve_by(self, method: str) -> dict:
        """Solve as a scene without targets; PD's row has how far [mm] lips are from theirs: median, 95 %, largest."""
        row = super().solve_by(method)
        if method == PD:
            head, wrap = self.of.head, self.pd[0].positions[: len(self.of.head.bone)]
            left = distances(wrap, head.wrap_targets(self.targets))[head.regions["lips"]]
            row["lips_mm"] = [float(np.median(left)), float(np.percentile(left, 95)), float(left.max())]
        return row

    def skin(self, solution: Solution) -> Floats:
        """Give the skin [mm] of an answer to PD's scene."""
        return self.neutral.skin_after(self.shape, solution.positions)

    def law_skin(self, solution: Solution) -> Floats:
        """Give the skin [mm] of an answer to the law's scene."""
        return self.neutral_by_law.skin_after(self.shape, solution.positions)

    def compare_skins(self, method: str) -> dict:
        """Measure how far the surrogate's skin, or that of blendshapes, is from the solvers'."""
        skin, rest = self.learned if method == NETWORK else self.shape, self.of.head.skin.vertices
        others = {
            TO_PD: self.skin(self.pd[0]),
            TO_FENICSX: self.skin(self.fenicsx[0]),
            TO_NEO: self.law_skin(self.neo[0]),
        }
        return {
            "compared": [
                {"compared": what + SKIN, **asdict(difference(skin, other, rest))} for what, other in others.items()
            ]
        }

    def picture(self) -> bytes:
        """Draw target, simulated, and the distances of blendshapes, neo-Hookean law and surrogate: PNG."""
        pd, head = self.skin(self.pd[0]), self.of.head
        simulated = head.skin.with_vertices(pd)
        others = {f"{BLENDSHAPES} - {PD}": self.shape, f"{LAW} - {PD}": self.law_skin(self.neo[0])}
        others |= {} if self._network is None else {f"{NETWORK} - PD": self.learned}
        errors = {text: distances(skin, pd) for text, skin in others.items()}
        top = max(0.05, float(np.percentile(errors[f"{BLENDSHAPES} - {PD}"], 99.5)))
        panels = [Panel("target", head.skin.with_vertices(self.shape)), Panel(f"simulated ({PD})", simulated)]
        panels += [Panel(text, simulated, error, top) for text, error in errors.items()]
        return draw_strip([replace(panel, weights=self.weights) for panel in panels], rest=head.skin)
