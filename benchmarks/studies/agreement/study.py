"""Cases of one head by every solver, another law and every method: how far apart they are, and what effects do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ....animation.page import Pose, Rig, render_face_page
from ....animation.pictures import draw_cut_away
from ....animation.plots import subplots, to_svg
from ....lhm import check_head, identities
from ....lhm.base.limits import LEVEL, SEED
from ....lhm.base.option import option
from ....lhm.template.template import DEFAULT_LEVEL
from ....reference import Parameters
from ....surrogate import Surrogate
from ....surrogate import methods as m
from ...harness.first_screen import ALL_VERTICES, SKIN, select_comparisons
from ...harness.study import Column, Row, Table, Task, Values, above, at_most
from ..cases import CASES, Case, get_case
from ..measures import ACCURACY, NEO_HOOKEAN, PD_ENERGY
from ..person import WHOSE, OfPerson
from .insides import tabulate_insides
from .pictures import draw_case
from .solved import ROUNDING, TRUTHS, SolvedCase

HEAD, FIT, TURNED, BESIDE = "the head", "fit and gates", "the head in 3D", "side by side"
ALL_SOLVERS = (m.FENICSX, m.PD, m.PD_PLAIN, m.SKFEM, m.FENICSX_NEO_HOOKEAN, m.SKFEM_NEO_HOOKEAN)
FEWER_SOLVERS = (m.FENICSX, m.PD, m.FENICSX_NEO_HOOKEAN)
"""Of effects and of scenes without targets; scikit-fem and plain PD are checked on the others."""
CUT = "soft tissue (yellow) and muscle (red) cut open; the skin wrap; the skull wrap: cranium white, mandible blue"
VIEW_WORDS = "Turn it with the mouse or a finger. In the poses the solvers' own answers can be chosen and compared."
NEAR_ACCURACY = 0.01
"""How near [mm] PD's answer must be to that from another start."""


@dataclass(frozen=True)
class Agreement(OfPerson):
    """Cases of one head: expressions, loads and the paper's effects."""

    name = "agreement"
    heading = "Does the fast simulator agree with finite elements, and what do effects do?"
    question = (
        "Do projective dynamics, FEniCSx and scikit-fem find the same face, how far are a hyperelastic law, the "
        "network and its rivals from it, and what do the paper's effects do to it?"
    )
    needs = ("people", "heads", "network")
    cheap = "collisions, network"
    columns = (
        Column("to", "to"),
        Column("over", "over"),
        Column("mean", "mean [mm]"),
        Column("rms", "RMS [mm]"),
        Column("p95", "95 % [mm]"),
        Column("max", "max [mm]"),
        Column("relative", "max / largest displacement"),
        Column("share", "share"),
        Column("start", "start"),
        Column("iterations", "iterations", cost=True),
        Column("to_001_mm", "iterations to 0.01 mm", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("gradient", "gradient / start"),
        Column("reason", "ended"),
    )
    note = (
        "PD, FEniCSx and scikit-fem solve PD's energy on the same tets. The neo-Hookean law has the same small-strain "
        "moduli. PD, FEniCSx and the law each settle the neutral face themselves; scikit-fem solves the scenes of "
        "FEniCSx. The mandible is free. Distances are those of vertices. Shares are of T less blendshapes that bones "
        "carry, over vertices that this moves by more than 0.05 mm. Iterations to 0.01 mm count until no vertex is "
        "farther from the answer. Where FEniCSx ends in another minimum than PD, it also starts at PD's answer: PD is "
        "right if FEniCSx stays there. The other start of PD moves all wraps by the skin's way to its targets, which "
        "inverts tets. No target holds the skin where a bone opens the jaw or a load pushes the cheek. FEniCSx models "
        "no contact. Where an effect changes the neutral face, it settles first, and its displacement is added to the "
        "expression's targets; the paper does not say how. The study `work-precision` has the seconds."
    )
    version = 3

    identities: str = option("anny", WHOSE)
    level: int = option(DEFAULT_LEVEL, "level of the template: 1,212, 4,842 or 19,362 vertices", bound=LEVEL)
    seed: int | None = option(None, "seed of the identity; default: the mean head", bound=SEED)  # type: ignore[assignment]
    cases: tuple[str, ...] = option(
        (), f"one of {', '.join(CASES)}, or an expression as jawOpen*0.5+cheekPuff; repeat for several  [all]"
    )
    weights: str = option("", "weights of `softdeca train`  [those that are shipped]")

    def tasks(self) -> Sequence[Task]:
        """List the head, and each case by each method; InputError for an unknown space, case or expression."""
        self.check()
        rivals = tuple(m.ready_methods(self.network()))
        tasks = [Task(case.name, method) for case in self._chosen for method in list_methods(case, rivals)]
        return [Task(HEAD, FIT), *tasks, Task(TURNED, BESIDE)]

    @property
    def _chosen(self) -> list[Case]:
        return [get_case(name) for name in dict.fromkeys(self.cases or CASES)]

    def network(self) -> Surrogate | None:
        """Load the network that was asked for, else the one that is shipped for the space, if there is one."""
        if self.weights:
            return Surrogate.load(Path(self.weights))
        shipped = Surrogate.load()
        return shipped if shipped.space == identities.from_text(self.identities).name else None

    def measure(self, task: Task) -> Values:
        """Measure a method on a case; the head's gates and picture; pictures of a case; the head in 3D."""
        head = self.person().head
        if task.case == HEAD:
            figures = [(each.words, each.value, each.unit, each.limit) for each in check_head(head).figures]
            return {"tets": len(head.tets), "figures": figures, CUT: draw_cut_away(head)}
        if task.case == TURNED:
            return {"blendshapes, PD, FEniCSx and network": self._draw_page()}
        solved, method = solve_case(self, task.case), task.method
        if method == BESIDE:
            return draw_case(solved)
        if method not in TRUTHS:
            laws = () if solved.case.contact else (m.FENICSX_NEO_HOOKEAN,)
            return {"compared": [line for truth in (m.PD, *laws) for line in solved.compare(method, truth)]}
        compared = solved.compare(method, TRUTHS[method])
        about = {"shown": solved.case.shown, "without_targets": solved.case.scene is not None}
        record = about | solved.tell_solve(method) | {"compared": compared}
        if method == m.PD:
            return record | solved.tell_face()
        return record | {"inside": solved.compare_inside()} if method == m.FENICSX_NEO_HOOKEAN else record

    def _draw_page(self) -> bytes:
        """The head in 3D: rigs by network, and the answers to the expressions at default p."""
        at_rest, network = self.person().face(Parameters()), self.network()
        rigs = [] if network is None else [Rig.baked(m.NETWORK, network.bind_face(at_rest))]
        poses = []
        for case in self._chosen:
            if case.is_plain and case.expression:
                solved = solve_case(self, case.name)
                skins = {solver: solved.answer(solver).skin for solver in (m.PD, m.FENICSX_NEO_HOOKEAN)}
                poses.append(Pose(case.name, case.weights, skins))
        title = f"the head ({self.person().space.name})"
        return render_face_page(title, VIEW_WORDS, at_rest, rigs, poses).encode()

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each comparison, the first with what the solver did; none of pictures."""
        compared: Sequence[Mapping] = values.get("compared", [])
        run = {key: value for key, value in values.items() if key != "compared"}
        lines = [{**(run if k == 0 else {}), **one} for k, one in enumerate(compared)]
        return lines or ([run] if "reason" in run else [])

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all give one answer, no tet is turned, all was reached that was asked, and acceleration pays.

        That PD is FEniCSx to 1e-6 excludes another law, whose least distance is above 1e-3 of the largest displacement,
        and plain PD, stopped at 0.005 mm.
        """
        gates = []
        for what, method, bound in (
            ("PD to FEniCSx, same energy, each settled by itself", m.PD, 1e-6),
            ("scikit-fem to FEniCSx, PD's energy", m.SKFEM, 1e-8),
            ("scikit-fem to FEniCSx, neo-Hookean", m.SKFEM_NEO_HOOKEAN, 1e-8),
        ):
            lines = select_comparisons(rows, method, TRUTHS[method], ALL_VERTICES)
            if lines:
                worst = max(line["relative"] for line in lines)
                gates.append(at_most(f"{what}, of the largest displacement", worst, bound))
        faces = [row.values for row in rows if row.method == m.PD]
        if faces:
            least = min(values["least_ratio"] for values in faces)
            gates.append(above("smallest volume ratio of a tet over all cases (none inverted)", least, 0.0))
            rises = sum(values.get("energy_rise", 0.0) > ROUNDING for values in faces)
            gates.append(at_most("cases whose energy rises", rises, 0))
        # Expressions at full weight may have two minima, which `words` names; effects are chosen to have one.
        away = [values["to_other_start_mm"] for values in faces if "change_max_mm" in values]
        if away:
            what = "largest distance of an effect's answer to PD's from another start [mm]"
            gates.append(at_most(what, max(away), NEAR_ACCURACY))
        unfinished = sum(not row.values.get("done", True) for row in rows if row.method != m.PD_PLAIN)
        gates.append(at_most("solver runs that did not reach what was asked", unfinished, 0))
        counts = {(row.case, row.method): row.values["to_001_mm"] for row in rows if row.method in (m.PD, m.PD_PLAIN)}
        pairs = [
            (counts[case, m.PD], slow)
            for (case, solver), slow in counts.items()
            if solver == m.PD_PLAIN and (case, m.PD) in counts
        ]
        if pairs:
            # None where one does not come to 0.01 mm.
            ratios = [None if None in pair else pair[0] / max(pair[1], 1) for pair in pairs]
            worst = None if None in ratios else max(ratio for ratio in ratios if ratio is not None)
            what = "accelerated PD's iterations to 0.01 mm over plain PD's, worst case"
            gates.append(at_most(what, worst, 0.2, answer=False))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell whether the answers are one, what another law and methods leave, and which effect is most."""
        sentences = []
        same = [line["relative"] for line in select_comparisons(rows, m.PD, m.FENICSX, ALL_VERTICES)]
        if same:
            sentences.append(
                "Projective dynamics and FEniCSx find the same minimiser of the same energy to "
                f"{max(same):.1e} of the largest displacement in all {len(same)} cases."
            )
        twice = {
            row.case: apart
            for row in rows
            if (apart := row.values.get("another_minimum_mm") or row.values.get("to_other_start_mm") or 0.0)
            > NEAR_ACCURACY
        }
        if twice:
            sentences.append(
                f"PD's energy has two minima on {', '.join(twice)}, up to {max(twice.values()):.2f} mm apart: FEniCSx, "
                "or PD from another start, ends in the other. FEniCSx is compared from PD's answer there."
            )
        for method in (m.FENICSX_NEO_HOOKEAN, m.NETWORK, m.DERIVATIVES, m.SETTLED, m.BLENDSHAPES):
            means = [line["mean"] for line in select_comparisons(rows, method, m.PD, SKIN)]
            if means:
                sentences.append(f"The skin by {method} is at most {max(means):.3f} mm from PD's on average.")
        changes = {row.case: row.values["change_max_mm"] for row in rows if "change_max_mm" in row.values}
        if changes:
            most_changed = max(changes, key=lambda case: changes[case])
            sentences.append(
                f"Of {len(changes)} effects {most_changed} changes its expression most, by "
                f"{changes[most_changed]:.1f} mm."
            )
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the head's gates, what effects do, what PD's answers are, each method, and what the law changes."""
        figures = [figure for row in rows for figure in row.values.get("figures", [])]
        tables = [Table("The head", ["figure", "measured", "unit", "gate"], figures)] if figures else []
        faces = [{"case": row.case, **row.values} for row in rows if row.method == m.PD]
        effects = [values for values in faces if "change_max_mm" in values]
        if effects:
            tables.append(Table.of("What each effect does", EFFECT_TITLES, effects, EFFECT_NOTE))
        if faces:
            lines = [values | _spread(values.get("lips_mm")) for values in faces]
            tables.append(Table.of("PD's answers", FACE_TITLES, lines))
        return [*tables, *_tabulate_methods(rows), *tabulate_insides(rows, PD_ENERGY, NEO_HOOKEAN)]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw distances, a line per case: means, and of the law the largest of all vertices too."""
        marks = {
            (m.PD, m.FENICSX, ALL_VERTICES, "mean"): "PD to FEniCSx, same energy",
            (m.SKFEM, m.FENICSX, ALL_VERTICES, "mean"): "scikit-fem to FEniCSx, same energy",
            (m.FENICSX_NEO_HOOKEAN, m.PD, SKIN, "mean"): "neo-Hookean law to PD, skin",
            (m.FENICSX_NEO_HOOKEAN, m.PD, ALL_VERTICES, "max"): "the same, all vertices, largest",
            (m.NETWORK, m.PD, SKIN, "mean"): "network to PD, skin",
            (m.SETTLED, m.PD, SKIN, "mean"): "settled + blendshapes to PD, skin",
            (m.BLENDSHAPES, m.PD, SKIN, "mean"): "blendshapes to PD, skin",
        }
        cases = list(dict.fromkeys(row.case for row in rows if row.case not in (HEAD, TURNED)))
        shown = {
            label: [
                (max(line[key], 1e-14), cases.index(row.case))
                for row in rows
                for line in select_comparisons([row], method, truth, over)
            ]
            for (method, truth, over, key), label in marks.items()
        }
        if not any(shown.values()):
            return {}
        figure, axis = subplots(figsize=(10, 0.45 * len(cases) + 1.7))
        for label, points in shown.items():
            if points:
                axis.plot(*zip(*points, strict=True), "o", label=label)
        axis.axvline(ACCURACY, color="#bbbbbb", lw=0.8, ls=":")
        axis.set(xscale="log", xlabel="distance of the vertices, mean unless said [mm]; dotted: 0.01 mm")
        axis.set_yticks(range(len(cases)), cases)
        axis.invert_yaxis()
        axis.grid(False, axis="y")
        figure.legend(loc="outside upper center", ncol=3)
        return {"How far apart: solvers of one energy, another law, the network and its rivals.": to_svg(figure)}


EFFECT_TITLES = {
    "case": "effect",
    "shown": "what the paper shows",
    "neutral_change_mm": "neutral face moves, max [mm]",
    "change_mean_mm": "changes the expression, mean [mm]",
    "change_max_mm": "max [mm]",
    "soft_volume_percent": "soft tissue's volume [%]",
    "overlap_before_mm": "lips overlap without contact [mm]",
    "overlap_after_mm": "with contact [mm]",
}
EFFECT_NOTE = (
    "Flesh is the neck and the face below the brow, except lips, lids, mouth, eyes, teeth and ears; it fades in over "
    "12 mm along the skin."
)
FACE_TITLES = {
    "case": "case",
    "least_ratio": "smallest volume ratio",
    "energy_rise": "largest rise of the energy",
    "to_other_start_mm": "to the answer from another start [mm]",
    "lips_median": "lips to their targets, median [mm]",
    "lips_95": "95 % [mm]",
    "lips_max": "max [mm]",
}


def list_methods(case: Case, rivals: Sequence[str]) -> Sequence[str]:
    """List the labels of a case's rows: solvers, `rivals` where targets hold the skin, and its pictures last."""
    if case.contact:
        solvers: Sequence[str] = (m.PD, m.FENICSX)
    else:
        solvers = ALL_SOLVERS if case.is_plain else FEWER_SOLVERS
    return (*solvers, *(rivals if case.scene is None else ()), BESIDE)


@lru_cache(maxsize=len(CASES) + 8)
def solve_case(study: Agreement, name: str) -> SolvedCase:
    """Return a case on the study's person; what is solved of it is kept for the tasks that follow."""
    case, person = get_case(name), study.person()
    if case.changed is not None:
        person = person.change(case.changed(person.head), study.level)
    return SolvedCase(person, case, study.network())


def _spread(lips: Sequence[float] | None) -> dict[str, float]:
    return {} if lips is None else dict(zip(("lips_median", "lips_95", "lips_max"), lips, strict=True))


def _tabulate_methods(rows: Sequence[Row]) -> list[Table]:
    """Each method beside PD's skin and beside the law's, by case."""
    titles = ["case", "method"]
    for truth in (m.PD, m.FENICSX_NEO_HOOKEAN):
        titles += [f"to {truth}: mean [mm]", "max [mm]", "share"]
    cells = []
    for row in rows:
        beside = [select_comparisons([row], row.method, truth, SKIN) for truth in (m.PD, m.FENICSX_NEO_HOOKEAN)]
        if any(beside):
            figures = [line[0].get(key) if line else None for line in beside for key in ("mean", "max", "share")]
            cells.append((row.case, row.method, *figures))
    note = "Shares are by the ruler of surrogates, over vertices that more than bones move."
    return [Table("Skins by each method", titles, cells, note)] if cells else []
