"""Cases of one head by every solver, another law and every method: how far apart they are, and what effects do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....lhm.base.limits import LEVEL, SEED
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.template.template import DEFAULT_LEVEL
from ....reference import Face
from ....reference.added import added_laws
from ....surrogate import methods as m
from ....surrogate.methods import Method
from ....surrogate.runtime import Surrogate
from ... import contest
from ...contest import Contest, Made, collect_rows, list_failures
from ...harness.study import Column, Row, Table, Task, Values, above, at_most
from ..cases import CASES, get_case
from ..person import WHOSE, OfPerson, check_known, find_network
from .insides import LAYERS, compare_insides
from .pictures import draw_case
from .solvers import FENICSX_FROM_PD, FROM_PD, OTHER_START, WATCHED, WITHOUT, FaceOfScene, list_solvers

NEAR_ACCURACY = 0.01
"""How near [mm] PD's answer must be to that from another start."""
APART = 1e-4
"""Share of the largest displacement; converged answers that are farther apart are two minima."""
ROUNDING = 1e-12
"""A rise of the energy by at most this share of it is rounding."""


@dataclass(frozen=True)
class Agreement(Contest, OfPerson):
    """Cases of one head: expressions, loads and the paper's effects."""

    name = "agreement"
    question = "Does the fast simulator agree with finite elements, and what do effects do?"
    needs = ("people", "heads", "network")
    cheap = "cheekPuff, every"
    columns = (
        Column("method", "by"),
        Column("to", "to"),
        Column("everywhere", "skin, mean [mm]"),
        Column("farthest", "max [mm]"),
        Column("share", "share"),
        Column("inside", "all vertices, max [mm]"),
        Column("relative", "the same / largest displacement"),
        Column("iterations", "iterations", cost=True),
        Column("reason", "ended"),
    )
    note = (
        "PD, FEniCSx and scikit-fem solve PD's energy on the same tets. The neo-Hookean law has the same small-strain "
        "moduli. Each settles the neutral face itself. The mandible is free. Distances are those of vertices. Shares "
        "are of T less blendshapes that bones carry, over vertices that this moves by more than 0.05 mm. FEniCSx "
        "starts at the settled face, and at PD's answer too: where energy has two minima, PD is right if FEniCSx stays "
        "there. The other start of PD moves all wraps by the skin's way to its targets, which inverts tets. No target "
        "holds the skin where a bone opens the jaw or a load pushes the cheek. FEniCSx models no contact, and takes "
        "PD's pairs. Where an effect changes the neutral face, it settles first, and its displacement is added to the "
        "expression's targets; the paper does not say how. The study `work-precision` has the seconds."
    )
    timed = False
    version = 5

    identities: str = option("anny", WHOSE)
    level: int = option(DEFAULT_LEVEL, "level of the template: 1,212, 4,842 or 19,362 vertices", bound=LEVEL)
    seed: int | None = option(None, "seed of the identity; default: the mean head", bound=SEED)  # type: ignore[assignment]
    cases: tuple[str, ...] = option(
        (), f"one of {', '.join(CASES)}, or an expression as jawOpen*0.5+cheekPuff; repeat for several  [all]"
    )
    laws: tuple[str, ...] = option(
        (), "a law that --add has, beside PD's and neo-Hookean; repeat for several", name="--law"
    )
    weights: str = option("", "weights of `softdeca train`  [those that are shipped]")

    def list_cases(self) -> Sequence[str]:
        """Name the cases; InputError for an unknown space, law, case or expression, and weights that cannot be read."""
        self.check()
        check_known("law", self.laws, added_laws())
        self.network()
        return [get_case(name).name for name in dict.fromkeys(self.cases or CASES)]

    def make_case(self, name: str) -> contest.Case:
        """Make a case on the study's person, or on a head that is fitted to the skin that the case makes of it."""
        case, person = get_case(name), self.person()
        if case.changed is not None:
            person = person.change(case.changed(person.head), self.level)

        def make() -> Face:
            if case.scene is not None:
                return FaceOfScene(person.head, person.shapes, make_scene=case.scene)
            return person.face(case.parameters(person.head), case.contact)

        about = {"shown": case.shown, "without_targets": case.scene is not None}
        kind = "scenes" if case.scene is not None else "expressions" if case.is_plain else "effects"
        return contest.Case(name, kind, make, case.weights[None], about=about)

    def list_methods(self, name: str) -> Sequence[str | Method]:
        """List solvers, and where targets hold the skin, methods at the price of blendshapes."""
        case = get_case(name)
        ready = {} if case.scene is not None else m.ready_methods(self.network(), beyond="clamp")
        return [*list_solvers(case, self._laws), *ready.values()]

    def list_truths(self, name: str) -> Sequence[str | Method]:
        """List PD, and where FEniCSx can, its answer from there and each law's."""
        return [WATCHED] if get_case(name).contact else [WATCHED, FROM_PD, *map(m.solve_law, self._laws)]

    @property
    def _laws(self) -> tuple[str, ...]:
        """The hyperelastic laws by name."""
        return ("neo-Hookean", *self.laws)

    def network(self) -> Surrogate | None:
        """Load the network that was asked for, or what is shipped for the space."""
        return find_network(self.weights, self.identities)

    def compare(self, face: Face, weights: Floats, own: Made, true: Made) -> Mapping[str, Any]:
        """Measure skins, and inside where both were solved."""
        skins = contest.compare_skins(face, weights, own, true)
        return {**skins, **compare_insides(face.head, own, true)}

    def measure(self, task: Task) -> Values:
        """Run all methods on a case and draw it."""
        frames: dict[str, Made] = {}
        case, methods, truths = self.make_case(task.case), self.list_methods(task.case), self.list_truths(task.case)
        rows = contest.run_contest(case, methods, truths, compare=self.compare, on_frame=frames.__setitem__)
        pictures = draw_case(case.make(), get_case(task.case), frames) if m.PD in frames else {}
        return {"rows": rows, **pictures}

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each method and truth."""
        lines = []
        for row in values["rows"]:
            what = {"method": row["method"], **row["told"], "reason": row["reason"] or row["told"].get("reason")}
            for truth, to in row["to"].items():
                inside = to.get("inside", {})
                far = {"inside": inside.get("max"), "relative": inside.get("relative")}
                lines.append({**what, "to": truth, **{key: to[key] for key in SKIN}, **far})
        return lines

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all give one answer, no tet is turned, and all was reached that was asked.

        That PD is FEniCSx to 1e-6 excludes another law, whose least distance is above 1e-3 of the largest displacement.
        """
        lines = collect_rows(rows)
        gates = []
        for what, apart, bound in (
            ("PD to FEniCSx, same energy, each settled by itself", find_nearest(lines), 1e-6),
            ("scikit-fem to FEniCSx, PD's energy", find_inside(lines, m.SKFEM, FENICSX_FROM_PD), 1e-8),
            *(
                (
                    f"scikit-fem to FEniCSx, {law}",
                    find_inside(lines, m.solve_law(law, m.SKFEM).name, m.solve_law(law).name),
                    1e-8,
                )
                for law in self._laws
            ),
        ):
            if apart:
                gates.append(at_most(f"{what}, of the largest displacement", max(apart.values()), bound))
        told = {(line["case"], line["method"]): line["told"] for line in lines if line["told"]}
        pd = {case: each for (case, method), each in told.items() if method == m.PD}
        least = min((each["least_ratio"] for each in pd.values()), default=0.0)
        gates.append(above("smallest volume ratio of a tet over all cases (none inverted)", least, 0.0))
        rises = sum(each.get("energy_rise", 0.0) > ROUNDING for each in pd.values())
        gates.append(at_most("cases whose energy rises", rises, 0))
        # Expressions at full weight may have two minima, which `words` names; effects are chosen to have one.
        effects = [line for line in lines if line["kind"] == "effects"]
        away = [line["to"][m.PD]["inside"]["max"] for line in effects if line["method"] == OTHER_START and line["to"]]
        if away:
            what = "largest distance of an effect's answer to PD's from another start [mm]"
            gates.append(at_most(what, max(away), NEAR_ACCURACY))
        gates.append(at_most("solver runs that did not reach what was asked", len(list_failures(lines)), 0))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell whether the answers are one, what another law and methods leave, and which effect is most."""
        lines, sentences = collect_rows(rows), []
        same = find_nearest(lines)
        if same:
            sentences.append(
                "Projective dynamics and FEniCSx find the same minimiser of the same energy to "
                f"{max(same.values()):.1e} of the largest displacement in all {len(same)} cases."
            )
        twice = find_inside(lines, m.FENICSX, m.PD) | find_inside(lines, OTHER_START, m.PD)
        names = [case for case, apart in twice.items() if apart > APART]
        if names:
            sentences.append(
                f"PD's energy has two minima on {', '.join(names)}: FEniCSx, or PD from another start, ends in the "
                "other. FEniCSx stays at PD's answer there."
            )
        laws = [m.solve_law(law).name for law in self._laws]
        for method in (*laws, m.NETWORK, m.DERIVATIVES, m.SETTLED, m.BLENDSHAPES):
            means = [line["to"][m.PD]["everywhere"] for line in lines if line["method"] == method and line["to"]]
            if means:
                sentences.append(f"The skin by {method} is at most {max(means):.3f} mm from PD's on average.")
        changes = {line["case"]: line["to"][m.PD]["farthest"] for line in lines if line["method"] == WITHOUT}
        if changes:
            most = max(changes, key=lambda case: changes[case])
            sentences.append(
                f"Of {len(changes)} effects {most} changes its expression most, by {changes[most]:.1f} mm."
            )
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate PD's answers, what effects do, each method's skin, and what the law changes."""
        lines, tables = collect_rows(rows), []
        answers = [{**line, **line["told"]} for line in lines if line["method"] == m.PD and line["told"]]
        if answers:
            tables.append(Table.of("PD's answers", ANSWER_TITLES, answers))
        changes = [{**line, **line["told"], **line["to"][m.PD]} for line in lines if line["method"] == WITHOUT]
        if changes:
            tables.append(Table.of("What each effect does", EFFECT_TITLES, changes, EFFECT_NOTE))
        skins = [
            (line["case"], line["method"], to["everywhere"], to["farthest"], to["share"])
            for line in lines
            if (to := line["to"].get(m.PD)) is not None
        ]
        titles = ["case", "method", "mean [mm]", "max [mm]", "share"]
        note = "Shares are by the ruler of surrogates, over vertices that more than bones move."
        tables.append(Table("Skins beside PD's", titles, skins, note))
        return [*tables, *(tabulate_law(lines, law) for law in self._laws)]


SKIN = ("everywhere", "farthest", "share")
ANSWER_TITLES = {
    "case": "case",
    "least_ratio": "smallest volume ratio",
    "energy_rise": "largest rise of the energy",
    "neutral_change_mm": "neutral face moves, max [mm]",
    "soft_volume_percent": "soft tissue's volume [%]",
    "lips_median_mm": "lips to their targets, median [mm]",
    "lips_max_mm": "max [mm]",
    "overlap_mm": "lips overlap [mm]",
}
EFFECT_TITLES = {
    "case": "effect",
    "shown": "what the paper shows",
    "everywhere": "changes the expression, mean [mm]",
    "farthest": "max [mm]",
    "overlap_mm": "lips overlap without contact [mm]",
}
EFFECT_NOTE = (
    "Flesh is the neck and the face below the brow, except lips, lids, mouth, eyes, teeth and ears; it fades in over "
    "12 mm along the skin."
)


def find_inside(lines: Iterable[Mapping], method: str, truth: str) -> dict[str, float]:
    """Find a method's largest distance of a vertex to a truth's, of the largest displacement, by case."""
    return {
        line["case"]: line["to"][truth]["inside"]["relative"]
        for line in lines
        if line["method"] == method and "inside" in line["to"].get(truth, {})
    }


def find_nearest(lines: Sequence[Mapping]) -> dict[str, float]:
    """Find the same of FEniCSx to PD, by its nearer start."""
    from_rest, from_pd = (find_inside(lines, method, m.PD) for method in (m.FENICSX, FENICSX_FROM_PD))
    return {case: min(apart, from_pd.get(case, apart)) for case, apart in from_rest.items()}


def tabulate_law(lines: Iterable[Mapping], law: str) -> Table:
    """Tabulate what a law changes inside: vertices, stress of each layer, and the mandible's place."""
    by_law = m.solve_law(law).name
    titles = ["case", "vertices, mean [mm]", "max [mm]", "mandible [mm]", "turn [degrees]"]
    titles += [f"{layer}, {name} [kPa]" for layer in LAYERS for name in (law, m.PD)]
    cells = []
    for case, line in ((line["case"], line) for line in lines if line["method"] == by_law):
        pd = next(line for line in lines if (line["case"], line["method"]) == (case, m.PD))
        to = line["to"].get(m.PD)
        if to is not None:
            stresses = (to["stress"], pd["to"][by_law]["stress"])
            each = [stress[layer]["mean"] for layer in LAYERS for stress in stresses]
            inside, jaw = to["inside"], to["mandible"]
            cells.append((case, inside["mean"], inside["max"], jaw["mm"], jaw["degrees"], *each))
    note = "Von Mises stress of the tets, mean by volume, without the membrane. The mandible is free."
    return Table(f"Inside: the {law} law and PD", titles, cells, note)
