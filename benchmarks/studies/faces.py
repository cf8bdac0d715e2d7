"""The main study's contest: unseen faces under random p, and the mean face under default p, by every method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...lhm import identities
from ...lhm.base.errors import InputError
from ...lhm.base.limits import LEVEL, SEED, STUDIED_PEOPLE
from ...lhm.base.option import option
from ...lhm.expressions import parse_weights
from ...lhm.template.template import DEFAULT_LEVEL
from ...reference import Face, Parameters
from ...surrogate import methods as m
from ...surrogate.methods import Method
from ..contest import KINDS, Case, Contest, collect_rows, draw_case, list_columns, list_failures
from ..harness import first_screen
from ..harness.study import Row, Table, at_most
from .person import WHOSE, find_network, person

MEAN, QUADRATIC = "the mean face", ", beside quadratic tets"
SAME = 1e-3
"""[mm] by which two solvers of one energy may differ, both to a small gradient."""


@dataclass(frozen=True)
class Faces(Contest):
    """People whom nobody trained on, each under a p of another kind, and the mean face under default p."""

    name = "faces"
    question = "How far is each method from the simulator, and it from converged finite elements?"
    needs = ("people", "heads", "network")
    columns = list_columns(first_screen.TRUTHS)

    identities: str = option("anny", WHOSE)
    level: int = option(DEFAULT_LEVEL, "level of the template", bound=LEVEL)
    people: int = option(6, "how many people", bound=STUDIED_PEOPLE)
    frames: int = option(3, "frames of each person", bound=STUDIED_PEOPLE)
    converged: int = option(
        1,
        "how many people have their first frame solved by quadratic tets, too: minutes, 5 GB",
        bound=replace(STUDIED_PEOPLE, least=0),
    )
    seed: int = option(5301, "seed of the people", bound=SEED)
    expressions: tuple[str, ...] = option(
        ("jawOpen*0.6", "mouthSmileLeft*0.7+mouthSmileRight*0.7", "mouthPucker*0.7"),
        "of the mean face, as jawOpen*0.5+cheekPuff; repeat for several",
    )
    weights: str = option("", "weights of `softdeca train`  [those that are shipped]")

    def list_cases(self) -> Sequence[str]:
        """Name the mean face, and people; InputError for a space, an expression or weights that cannot be read."""
        identities.from_text(self.identities)
        for text in self.expressions:
            parse_weights(text)
        if not self.expressions or self.people < 1 or self.frames < 1:
            raise InputError("people, frames, expressions: expected 1 or more")
        if self.converged > self.people:
            raise InputError(f"converged: {self.converged} of {self.people} people")
        find_network(self.weights, self.identities)
        names, converged = [f"person {k + 1}" for k in range(self.people)], self._find_converged()
        return [
            MEAN + QUADRATIC,
            *([MEAN] if self.expressions[1:] else []),
            *(name for name in names if self.frames > 1 or name not in converged),
            *(name + QUADRATIC for name in converged),
        ]

    def _find_converged(self) -> Sequence[str]:
        """Name the people whose first frame quadratic tets solve: from the second on, and the first last."""
        return [f"person {k % self.people + 1}" for k in range(1, self.converged + 1)]

    def make_case(self, name: str) -> Case:
        """Make the mean face with the expressions, or draw a person; what has quadratic tets has the first frame."""
        chosen = slice(1) if name.endswith(QUADRATIC) else slice(1, None)
        if name.startswith(MEAN):
            someone = person(self.identities, None, self.level)
            weights = np.stack([parse_weights(text) for text in self.expressions[chosen]])
            return Case(
                name,
                "default",
                lambda: Face(someone.head, someone.shapes, Parameters(), per="wraps", code=someone.code),
                weights,
                someone.fit_s,
            )
        who = name.removesuffix(QUADRATIC)
        number = int(who.split()[1])
        kind = KINDS[(number - 1) % len(KINDS)]
        case = draw_case(who, self.identities, (self.seed, number), kind, self.frames, level=self.level)
        return replace(case, name=name, weights=case.weights[chosen]) if who in self._find_converged() else case

    def list_methods(self, name: str) -> Sequence[str | Method]:
        """List every method; FEniCSx on the mean face, by both laws.

        Under a random p an energy may have two minima: on the first person FEniCSx and PD end 0.8 mm apart.
        """
        ready = m.ready_methods(find_network(self.weights, self.identities), beyond="clamp")
        methods: list[str | Method] = [m.PD_FIRST_ORDER, *ready.values()]
        return [*methods, m.FENICSX, m.FENICSX_NEO_HOOKEAN] if name.startswith(MEAN) else methods

    def list_truths(self, name: str) -> Sequence[str]:
        """List the simulator, that of tets, and where the case says so quadratic tets."""
        return (m.PD, m.PD_TETS, m.FENICSX_P2) if name.endswith(QUADRATIC) else (m.PD, m.PD_TETS)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that solvers made every frame, and that two of one energy agree; `words` tell what else failed."""
        lines = collect_rows(rows)
        failed = list_failures(line for line in lines if line["method"] in first_screen.SOLVERS)
        gates = [at_most("frames that a solver could not make", len(failed), 0)]
        if apart := first_screen.measure_apart(lines):
            gates.append(at_most("FEniCSx to PD, same energy, largest distance of the skin [mm]", max(apart), SAME))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what the first screen tells, and what failed."""
        lines = collect_rows(rows)
        return " ".join([*first_screen.write_sentences(lines), *list_failures(lines)])

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate errors and costs by method, and errors by kind of p."""
        lines = collect_rows(rows)
        return [*first_screen.tabulate(lines), first_screen.tabulate_kinds(lines)]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw error against seconds."""
        figure = first_screen.draw_figure(collect_rows(rows))
        return {first_screen.CAPTION: figure} if figure else {}
