"""How far linear tets on a head are from their limit: ever finer meshes, and quadratic tets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm.base.option import option
from ...harness.study import Column, Row, Table, Task, Values, above, at_most
from ..person import OfPerson, parse_poisson
from .limits import SPLIT, SUB_LAYERS, LawOnHead, compare_finer_meshes, name_layers

FINER, QUADRATIC = "finer meshes", "quadratic tets"
"""What linear tets are compared with."""
COARSE = 1
"""Level of the heads on which Poisson's ratio is varied: quadratic tets with a pressure take minutes there."""
PRESSED = "mouthPucker"
"""Expression whose Poisson's ratio is varied."""
FINER_LAYERS = SUB_LAYERS[:2]
"""Sub-layers beside quadratic tets on a level above, where four take a minute."""
MOST = 0.4999
"""Bound of Poisson's ratio, above which quadratic tets have no reference here."""
ACCEPTED = 0.039
"""Bound of the mean discretisation error [mm]: 0.033 on the default head, 0.041 on the level below."""
LOCKS = 6.3
"""Least growth of linear tets' error, over the motion, from the lowest to the highest Poisson's ratio.

Measured on level 1 from nu 0.38 to 0.499: 7.8.
"""


@dataclass(frozen=True)
class MeshError(OfPerson):
    """Linear tets beside finer meshes by expression, and beside quadratic tets by Poisson's ratio."""

    name = "mesh"
    heading = "Is the head's mesh fine enough?"
    question = (
        "How far are linear tets on a head from ever finer meshes, and how far from quadratic tets as tissue nears "
        "incompressibility?"
    )
    cheap = "level 1, nu 0.45"
    columns = (
        Column("what", "mesh"),
        Column("tets", "tets"),
        Column("mean", "distance, mean [mm]"),
        Column("p95", "95 % [mm]"),
        Column("max", "max [mm]"),
        Column("over_all", "mean over mean |T - carried(S)|"),
        Column("share", "the same where the skin moves"),
        Column("iterations", "iterations", cost=True),
    )
    note = (
        "Distances of the skin, with prescribed bones. Finer meshes: PD's energy with default parameters. The error is "
        "the distance to the limit across the layers plus the change along the surface that is left; both are taken to "
        "add. The order is log2 of the RMS change from 1 to 2 sub-layers over that from 2 to 4. An order outside 0.5 "
        "to 2 is brought to the nearer end, and proves no asymptotic range. The GCI across is 1.25 times the estimated "
        "RMS error of the finest mesh. The GCI along is 3 times it, since two levels show no order. The assumed order "
        "of 1 is low, so the error is rather stated too large. A split surface has springs at its middles too. "
        "Quadratic tets: neo-Hookean tissue of default shear moduli on the same mesh, by displacement (P2) below nu "
        "0.49, with a pressure (P2-P1) from there. T is the reference's skin; no bone is scaled, so carried(S) is S."
    )
    limit = 7200.0

    expressions: tuple[str, ...] = option(
        ("jawOpen*0.5", "mouthSmileLeft+mouthSmileRight", "cheekPuff+mouthPucker*0.5"),
        "beside finer meshes, as jawOpen*0.5+cheekPuff; repeat for several",
    )
    poisson: tuple[str, ...] = option(
        ("0.38", "0.45", "0.47", "0.49", "0.499"),
        f"a Poisson's ratio, beside quadratic tets of level {COARSE}; repeat for several",
    )
    finer: tuple[str, ...] = ("0.45",)

    def tasks(self) -> Sequence[Task]:
        """List what linear tets are compared with. Raises InputError for options out of range."""
        self.check(self.expressions)
        for text in (*self.poisson, *self.finer):
            parse_poisson(text, MOST)
        levels = [(COARSE, text) for text in self.poisson] + [(self.level, text) for text in self.finer]
        return [
            *(Task(text, FINER) for text in self.expressions),
            *(Task(_name_case(level, text), QUADRATIC) for level, text in dict.fromkeys(levels)),
        ]

    def measure(self, task: Task) -> Values:
        """Solve one case on its meshes; each is one of `rows`."""
        if task.method == FINER:
            subject = self.person()
            return compare_finer_meshes(subject.head, subject.shape(task.case))
        level, text = _read_case(task.case)
        subject = self.person(level)
        solved = LawOnHead(subject.head, subject.shape(PRESSED), float(text))
        return {"rows": solved.compare_sub_layers(SUB_LAYERS if level == COARSE else FINER_LAYERS)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check the error of the own mesh, and that linear tets lock.

        A mesh that may do all that another can has at most its energy.
        """
        gates = []
        finer = [row.values["rows"] for row in rows if row.method == FINER]
        if finer:
            energies = [{line["what"]: line["energy"] for line in lines} for lines in finer]
            rises = sum(energy[SPLIT] > energy[name_layers(1)] for energy in energies)
            gates.append(at_most("expressions whose energy is higher on the mesh split into eight", rises, 0))
            what = "mean discretisation error of the head's own mesh, worst expression [mm]"
            gates.append(at_most(what, max(lines[0]["mean"] for lines in finer), ACCEPTED))
        coarse = {float(text): lines[0] for (level, text), lines in _list_quadratic(rows).items() if level == COARSE}
        if len(coarse) > 1:
            low, high = (coarse[nu]["over_all"] for nu in (min(coarse), max(coarse)))
            what = "error of linear tets over the motion, highest over lowest Poisson's ratio"
            gates.append(above(what, high / low, LOCKS))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the errors to both limits."""
        sentences = []
        own = [row.values["rows"][0] for row in rows if row.method == FINER]
        if own:
            means = [line["mean"] for line in own]
            sentences.append(
                f"The head's own mesh is {min(means):.3f} to {max(means):.3f} mm on average, and at most "
                f"{max(line['max'] for line in own):.2f} mm, from the limit of finer meshes."
            )
        for row in rows:
            lines = row.values["rows"]
            if row.method == QUADRATIC:
                sentences.append(
                    f"{row.case}: linear tets are {lines[0]['mean']:.3f} mm from quadratic ones on average, "
                    f"{lines[0]['max']:.2f} mm at most, {lines[0]['over_all']:.1f} times |T - carried(S)|."
                )
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate each mesh's distance to the limit of finer ones, and linear tets beside quadratic ones."""
        finer = [row for row in rows if row.method == FINER]
        orders = {"case": "expression", "moved_mm": "moved, max [mm]", "order_across": "order across the layers"}
        orders |= {"gci_across_mm": "GCI across [mm]", "gci_along_mm": "GCI along [mm]"}
        away = [
            (row.case, line["what"], direction, *(line[direction][key] for key in ("mean", "rms", "p95", "max")))
            for row in finer
            for direction in ("across", "along")
            for line in row.values["rows"]
            if direction in line
        ]
        head = ["expression", "mesh", "limit", "mean [mm]", "RMS [mm]", "95 % [mm]", "max [mm]"]
        figures = "{mean:.4f} / {max:.3f} / {over_all:.2f}"
        locked = [
            (_name_case(*case), lines[0]["reference"],
             *(figures.format(**line) for line in lines), *[""] * (len(SUB_LAYERS) - len(lines)))
            for case, lines in _list_quadratic(rows).items()
        ]  # fmt: skip
        titles = ["case", "reference", *map(name_layers, SUB_LAYERS)]
        caption = "Linear tets to quadratic ones: mean [mm] / max [mm] / times mean |T - carried(S)|"
        tables = [
            Table.of("Order and GCI of finer meshes", orders, [{"case": row.case, **row.values} for row in finer]),
            Table("Distance of each mesh to the limit across the layers, and along the surface", head, away),
            Table(caption, titles, locked),
        ]
        return [table for table in tables if table.rows]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the error against the size of the mesh, and against Poisson's ratio."""
        finer, quadratic = [row for row in rows if row.method == FINER], _list_quadratic(rows)
        pictures = {}
        if finer:
            pictures["Error against the size of the mesh."] = _draw_sizes(finer)
        if quadratic:
            pictures["Distance of linear to quadratic tets by Poisson's ratio."] = _draw_ratios(quadratic)
        return pictures


Quadratic = Mapping[tuple[int, str], Sequence[Values]]
"""Lines of linear tets beside quadratic ones, by level and Poisson's ratio."""


def _list_quadratic(rows: Sequence[Row]) -> Quadratic:
    return {_read_case(row.case): row.values["rows"] for row in rows if row.method == QUADRATIC}


def _draw_sizes(rows: Sequence[Row]) -> str:
    """RMS error to the limit against relative size, a line per expression: SVG."""
    figure, axes = subplots(1, 2, figsize=(8.6, 3.4), sharey=True)
    titles = {"across": "across: 1 / sub-layers", "along": "along: edges / the head's own"}
    for axis, (direction, title) in zip(axes, titles.items(), strict=True):
        for row in rows:
            errors = [line[direction]["rms"] for line in row.values["rows"] if direction in line]
            axis.plot(0.5 ** np.arange(len(errors)), errors, "o-", label=row.case, ms=4)
        axis.set_xscale("log", base=2)
        axis.set(yscale="log", xlabel=title)
    axes[0].set_ylabel("RMS distance to the limit [mm]")
    axes[0].legend()
    return to_svg(figure)


def _draw_ratios(quadratic: Quadratic) -> str:
    """Mean error against Poisson's ratio, a line per number of sub-layers and level: SVG."""
    figure, axes = subplots(1, 2, figsize=(8.8, 3.4))
    levels = sorted({level for level, _ in quadratic})
    shown = sorted({text for _, text in quadratic}, key=float)
    titles = {"mean": "mean error [mm]", "over_all": "mean error / mean |T - carried(S)|"}
    for axis, (key, title) in zip(axes, titles.items(), strict=True):
        for number, count in enumerate(SUB_LAYERS):
            for level in levels:
                points = sorted(
                    (float(text), lines[number][key])
                    for (its_level, text), lines in quadratic.items()
                    if its_level == level and number < len(lines)
                )
                from_half, sizes = [0.5 - nu for nu, _ in points], [size for _, size in points]
                label = f"{name_layers(count)}, level {level}" if points else None
                style = "o-" if level == COARSE else "s:"
                axis.plot(from_half, sizes, style, color=f"C{number}", ms=4, label=label)
        axis.set(xlabel="Poisson's ratio", ylabel=title, xscale="log")
        axis.set_xticks([0.5 - float(text) for text in shown], shown, fontsize=8)
        axis.minorticks_off()
        axis.set_ylim(bottom=0.0)
        axis.invert_xaxis()
    axes[0].legend(fontsize=8)
    return to_svg(figure)


def _name_case(level: int, text: str) -> str:
    return f"level {level}, nu {text}"


def _read_case(case: str) -> tuple[int, str]:
    level, _, text = case.partition(", nu ")
    return int(level.removeprefix("level ")), text
