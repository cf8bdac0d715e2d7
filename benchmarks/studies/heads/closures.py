"""How far lids and lips are apart over a take, by blendshapes, simulator and surrogate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....animation import plots
from ....animation.play import blend_linearly
from ....animation.takes import read_frames
from ....lhm import fit_head, identities, load_template
from ....lhm.base.limits import LEVEL
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.expressions import Take
from ....lhm.identities.gaps import Gap, find_gaps
from ....lhm.template import DEFAULT_LEVEL
from ....reference import Parameters, settle
from ....reference import Sequence as Simulation
from ....reference.face.parameters import read_parameters
from ....surrogate import Surrogate
from ....surrogate.methods import BLENDSHAPES, NETWORK, NETWORK_AND_DERIVATIVES, PD
from ...harness.study import Column, Row, Study, Task, Values
from ..person import check_person


@dataclass(frozen=True)
class Closures(Study):
    """Openings of the mean of the default people over a take."""

    name = "closures"
    heading = "Do lids and lips close as simulated?"
    question = "How far are lids and lips apart over a take, by blendshapes, PD and the surrogate?"
    columns = (
        Column("gap", "opening"),
        Column("by", "method"),
        Column("largest", "largest difference of its width from PD's [mm]"),
        Column("mean", "mean difference [mm]"),
        Column("least", "least width [mm]"),
        Column("least_simulated", "least width by PD [mm]"),
    )
    note = "On the mean of the default people. A width is negative where lids or lips cross."

    take: str = option("conversation:3", "a take, as `softdeca animate` reads it")
    frames: str = option("", "A:B, only these frames of the take, B left out")
    parameters: str = option("", "TOML of named parameters p")
    level: int = option(DEFAULT_LEVEL, "of the template: 1,212, 4,842 or 19,362 vertices", bound=LEVEL)
    dynamic: bool = option(False, "with inertia, simulated and by the surrogate")

    def tasks(self) -> Sequence[Task]:
        """List the take; InputError for one that cannot be read, and for parameters likewise."""
        check_person(0, self.level)
        self._read_parameters()
        take = read_frames(self.take, self.frames)
        return [Task(f"{self.take}, {len(take.times)} frames", "lids and lips")]

    def _read_parameters(self) -> Parameters:
        return read_parameters(Path(self.parameters)) if self.parameters else Parameters()

    def measure(self, task: Task) -> Values:
        """Play the take by all methods, some minutes a hundred frames; differences, and all widths."""
        take = read_frames(self.take, self.frames)
        openings, widths = self._measure_widths(take, self._read_parameters())
        lines = [
            {
                "gap": gap.name,
                "by": name,
                "largest": float(np.abs(values[:, k] - widths[PD][:, k]).max()),
                "mean": float(np.abs(values[:, k] - widths[PD][:, k]).mean()),
                "least": float(values[:, k].min()),
                "least_simulated": float(widths[PD][:, k].min()),
            }
            for k, gap in enumerate(openings)
            for name, values in widths.items()
            if name != PD
        ]
        return {
            "rows": lines,
            "times": take.times.tolist(),
            "gaps": [gap.name for gap in openings],
            "widths_mm": {name: values.tolist() for name, values in widths.items()},
            "widths": _draw_curves(take.times, openings, widths),
        }

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the largest difference of the network."""
        lines = [line for row in rows for line in row.values["rows"] if line["by"] == NETWORK]
        worst = max(lines, key=lambda line: line["largest"])
        return f"The network's {worst['gap']} are at most {worst['largest']:.2f} mm wider or narrower than simulated."

    def _measure_widths(self, take: Take, parameters: Parameters) -> tuple[list[Gap], dict[str, Floats]]:
        """The openings, and their widths [mm], shape (frames, openings), by method."""
        space, surrogate = identities.Anny(), Surrogate.load()
        skin, code = space.mean, np.zeros(space.code_size)
        head = fit_head(load_template(space, level=self.level), skin)
        openings = find_gaps(skin, space.parts, space.expressions)
        step = 1.0 / take.rate
        rigs = {
            NETWORK: surrogate.bind(skin, code, parameters),
            NETWORK_AND_DERIVATIVES: surrogate.bind(skin, code, parameters, exact=True, head=head),
        }
        simulation = Simulation.from_face(settle(head, parameters), time_step=step, dynamic=self.dynamic)
        playing = {name: rig.dynamic(step) if self.dynamic else rig for name, rig in rigs.items()}
        widths: dict[str, list[list[float]]] = {name: [] for name in (BLENDSHAPES, PD, *rigs)}
        for weights in take.weights:
            drawn = blend_linearly(skin, space.expressions, weights)
            skins: dict[str, np.ndarray] = {BLENDSHAPES: drawn}
            skins[PD] = simulation.skin(drawn, simulation.frame(drawn))
            skins |= {name: rig.frame(weights) for name, rig in playing.items()}
            for name, shown in skins.items():
                widths[name].append([gap.width(shown) for gap in openings])
        return openings, {name: np.array(rows) for name, rows in widths.items()}


def _draw_curves(times: Floats, openings: Sequence[Gap], widths: dict[str, Floats]) -> bytes:
    figure, axes = plots.subplots(len(openings), 1, figsize=(9, 2.4 * len(openings)), sharex=True)
    styles = {BLENDSHAPES: ":", PD: "-", NETWORK: "--"}
    for k, (axis, gap) in enumerate(zip(axes, openings, strict=True)):
        for name, values in widths.items():
            axis.plot(times, values[:, k], styles.get(name, "-."), label=name, lw=2.2 if name == PD else 1.2)
        axis.set_ylabel(f"{gap.name} [mm]")
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[-1].set_xlabel("time [s]")
    return plots.to_png(figure)
