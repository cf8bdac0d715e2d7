"""softdeca bench closures: how far lids and lips are apart over a take, by blendshapes, simulator and surrogate.

No study of the common runner: it plays one take, and its rows are curves of all methods at the same frames.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..animation import plots
from ..animation.play import blend_linearly
from ..lhm import expressions, fit_head, identities, load_template
from ..lhm.base.files.atomic import replaced
from ..lhm.base.mesh import Floats, Ints, Surface
from ..lhm.base.progress import OnProgress
from ..lhm.base.provenance import describe_machine
from ..lhm.expressions import Take
from ..lhm.wraps.landmarks import find_landmarks
from ..reference import Parameters, settle
from ..reference import Sequence as Simulation
from ..surrogate import Surrogate

TRUTH = "PD"
FOLLOWS = 0.5
"""Of the largest motion among a rim's vertices, from which on one belongs to the part that moves."""
CORNERS = 0.2
"""Share of a rim's width at either end that is left out: corners are never apart."""


@dataclass(frozen=True, eq=False)
class Gap:
    """Pairs of vertices across an opening: upper and lower (k,)."""

    name: str
    upper: Ints
    lower: Ints

    def width(self, skin: np.ndarray) -> float:
        """The mean height [mm] of upper over lower vertices of a skin (n, 3); negative where they cross."""
        return float((skin[self.upper, 1] - skin[self.lower, 1]).mean())


@dataclass(frozen=True)
class Closure:
    """One opening by one method: largest and mean difference of its width from PD's [mm], and its least widths."""

    gap: str
    method: str
    largest: float
    mean: float
    least: float
    least_simulated: float


def gaps(skin: Surface, parts: Ints, shapes: Floats) -> list[Gap]:
    """Both eyes' lids and the lips of a neutral skin whose parts are known; shapes (52, n, 3) [mm]."""
    marks = find_landmarks(skin, parts)
    x = skin.vertices[:, 0]
    middle = 0.5 * (x.min() + x.max())
    lids = {"left lids": marks.lids[x[marks.lids] > middle], "right lids": marks.lids[x[marks.lids] <= middle]}
    blink = {"left lids": "eyeBlinkLeft", "right lids": "eyeBlinkRight"}
    found = [_gap(name, skin, rim, shapes[expressions.index(blink[name])], moves="upper") for name, rim in lids.items()]
    return [*found, _gap("lips", skin, marks.rim, shapes[expressions.index("jawOpen")], moves="lower")]


def _gap(name: str, skin: Surface, rim: Ints, shape: Floats, *, moves: str) -> Gap:
    x = skin.vertices[rim]
    margin = CORNERS * float(np.ptp(x[:, 0]))
    rim = rim[(x[:, 0] > x[:, 0].min() + margin) & (x[:, 0] < x[:, 0].max() - margin)]
    down = -shape[rim, 1]
    moving, still = rim[down > FOLLOWS * down.max()], rim[down <= FOLLOWS * down.max()]
    upper, lower = (moving, still) if moves == "upper" else (still, moving)
    across = skin.vertices[lower, 0][None] - skin.vertices[upper, 0][:, None]
    return Gap(name, upper, lower[np.argmin(np.abs(across), axis=1)])


def closures(
    take: Take, out: Path, parameters: Parameters, *, level: int, dynamic: bool, progress: OnProgress
) -> tuple[list[Closure], list[Path]]:
    """Play a take on the mean of the default people by all methods; gaps.json and gaps.png in `out`."""
    space, surrogate = identities.Anny(), Surrogate.load()
    skin, code = space.mean, np.zeros(space.code_size)
    head = fit_head(load_template(space, level=level, progress=progress), skin)
    openings = gaps(skin, space.parts, space.expressions)
    network = surrogate.bind(skin, code, parameters)
    exact = surrogate.bind(skin, code, parameters, exact=True, head=head)
    neutral = settle(head, parameters)
    simulation = Simulation.of(neutral, time_step=1.0 / take.rate, dynamic=dynamic)
    rigs = {"network": network, "network + simulator at bind": exact}
    playing = {name: rig.dynamic(1.0 / take.rate) if dynamic else rig for name, rig in rigs.items()}
    widths: dict[str, list[list[float]]] = {name: [] for name in ("blendshapes", TRUTH, *rigs)}
    for number, weights in enumerate(take.weights):
        drawn = blend_linearly(skin, space.expressions, weights)
        skins: dict[str, np.ndarray] = {"blendshapes": drawn, TRUTH: simulation.skin(drawn, simulation.frame(drawn))}
        skins |= {name: rig.frame(weights) for name, rig in playing.items()}
        for name, one in skins.items():
            widths[name].append([gap.width(one) for gap in openings])
        progress(f"gaps: frame {number + 1} of {len(take.times)}", (number + 1) / len(take.times))
    found = {name: np.array(rows) for name, rows in widths.items()}
    results = [
        Closure(
            gap=gap.name,
            method=name,
            largest=float(np.abs(values[:, k] - found[TRUTH][:, k]).max()),
            mean=float(np.abs(values[:, k] - found[TRUTH][:, k]).mean()),
            least=float(values[:, k].min()),
            least_simulated=float(found[TRUTH][:, k].min()),
        )
        for k, gap in enumerate(openings)
        for name, values in found.items()
        if name != TRUTH
    ]
    written = [out / "gaps.json", out / "gaps.png"]
    with replaced(written[0]) as path:
        options = {"frames": len(take.times), "rate": take.rate, "level": level, "dynamic": dynamic}
        content = {
            "machine": describe_machine(),
            "options": options | {"parameters": asdict(parameters)},
            "rows": [asdict(row) for row in results],
            "times": take.times.tolist(),
            "gaps": [gap.name for gap in openings],
            "widths_mm": {name: values.tolist() for name, values in found.items()},
        }
        path.write_text(json.dumps(content, indent=1, default=np.ndarray.tolist))
    with replaced(written[1]) as path:
        path.write_bytes(_curves(take.times, openings, found))
    return results, written


def _curves(times: Floats, openings: Sequence[Gap], widths: dict[str, Floats]) -> bytes:
    figure, axes = plots.subplots(len(openings), 1, figsize=(9, 2.4 * len(openings)), sharex=True)
    styles = {"blendshapes": ":", TRUTH: "-", "network": "--"}
    for k, (axis, gap) in enumerate(zip(axes, openings, strict=True)):
        for name, values in widths.items():
            axis.plot(times, values[:, k], styles.get(name, "-."), label=name, lw=2.2 if name == TRUTH else 1.2)
        axis.set_ylabel(f"{gap.name} [mm]")
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[-1].set_xlabel("time [s]")
    return plots.to_png(figure)
