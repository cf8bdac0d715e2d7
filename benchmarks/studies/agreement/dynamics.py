"""A cheek let go and a head shaken: Eq. 9, projective dynamics with mass on the skin, and FEM's time steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm import LayeredHead
from ....lhm.base.errors import InputError
from ....lhm.base.mesh import Floats
from ....reference import Face
from ....reference.face.dynamics import Recurrence
from ....reference.march import SCHEMES
from ...harness.study import Column, Row, Task, Values, at_most
from ..person import OfPerson
from .release import FEWEST, FRAME, TIGHT, Frames, Release, Swing, swing

PER_FRAME = (1, 4)
SHAKE = (5.0, 2.0)  # mm to either side, Hz; 20 mm turn 700 tets inside out, and a step has more than one answer then
LEAST_FRAMES = 8
RELEASED, SHAKEN = "a cheek let go", "a shaken head"
EQUATION_AS_EULER, PROJECTIVE = "Eq. 9, implicit Euler's coefficients", "PD, mass on the skin"
EULER = "FEM, implicit Euler"
"""All three model the same."""


@dataclass(frozen=True)
class Dynamics(OfPerson):
    """Frames at 60 per second of one head; marches of a motion are compared frame by frame, so they are one task."""

    name = "dynamics"
    heading = "Does a moving face swing alike by every method?"
    question = "Do Eq. 9, projective dynamics and FEM's time steps move a face alike?"
    cheap = "a shaken head, all marches"
    columns = (
        Column("name", "march"),
        Column("steps_per_s", "steps per second"),
        Column("frequency", "frequency [Hz]"),
        Column("damping", "damping ratio"),
        Column("misfit", "misfit of the cosine"),
        Column("peak_mm", "peak [mm]"),
        Column("off_mm", "off the finest march [mm]"),
        Column("iterations", "iterations a step", cost=True),
        Column("stopped", "stopped"),
    )
    note = (
        "Bones are held. Frequency (undamped) and damping ratio are those of a damped cosine fitted to the motion. "
        "Only Eq. 9 with p's damping has a damper; what implicit Euler loses is numerical. Eq. 9 gives mass to the "
        "skin alone: what the springs of the expression need to swing at p's frequency. Shaken: 5 mm to either side at "
        "2 Hz; only Eq. 9 sees no acceleration of the head. A march that stopped is compared up to there."
    )

    level: int = 1
    frames: int = 24

    def tasks(self) -> Sequence[Task]:
        """List the motions; InputError for too few frames."""
        self.check()
        if self.frames < LEAST_FRAMES:
            raise InputError(f"frames: at least {LEAST_FRAMES} are needed, got {self.frames}")
        return [Task(case, "all marches") for case in (RELEASED, SHAKEN)]

    def measure(self, task: Task) -> Values:
        """Measure every march of a motion."""
        released = _release(self)
        if task.case == RELEASED:
            return let_go(released, self.frames)
        return shake(released, self.frames)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that marches agree where they model the same, and all end."""
        gates: list[dict] = []
        for row in rows:
            values = row.values
            if row.case == RELEASED:
                gates += [
                    at_most(f"{name} to implicit Euler by FEM, of the largest displacement", off, 1e-5)
                    for name, off in values["to_fem"].items()
                ]
            elif row.case == SHAKEN:
                what = "shaken: PD to implicit Euler by FEM, of the largest displacement"
                gates.append(at_most(what, values["to_fem"], 1e-5))
        ended = sum(not line["converged"] for row in rows for line in row.values["rows"])
        return [*gates, at_most("marches that did not reach what was asked", ended, 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what implicit Euler does to a swing."""
        marches = {line["name"]: line for row in rows if row.case == RELEASED for line in row.values["rows"]}
        sentences = [
            f"{name}: {line['frequency']:.2f} Hz, damping ratio {line['damping']:.3f}"
            for name in (
                "Eq. 9, p's frequency and damping",
                "FEM, implicit Euler",
                _name_march("Newmark", PER_FRAME[-1]),
            )
            if (line := marches.get(name)) and line["frequency"] is not None
        ]
        return f"A cheek let go swings by {'; '.join(sentences)}." if sentences else ""

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw what is left of the first displacement against time, a line per march."""
        traces: Mapping = next((row.values["traces"] for row in rows if row.case == RELEASED), {})
        if not traces:
            return {}
        figure, axis = subplots(figsize=(9, 4.5))
        for name, trace in traces.items():
            style = "-" if name.startswith("FEM") else "--"
            axis.plot(trace["times"], trace["left"], style, lw=1.3, label=name)
        axis.set(xlabel="time [s]", ylabel="share of the first displacement")
        axis.axhline(0.0, color="#bbbbbb", lw=0.8)
        figure.legend(loc="outside right upper")
        return {"What is left of the first displacement.": to_svg(figure)}


@lru_cache(maxsize=1)
def _release(study: Dynamics) -> Release:
    head = study.person().head
    return Release(Face(head, choices={"bones": "prescribed"}), cheek(head))


def cheek(head: LayeredHead) -> int:
    """Give the skin wrap's vertex of the face nearest to 45 mm beside the lips."""
    wrap, face = head.skin_wrap.vertices, np.flatnonzero(head.regions["face"])
    beside = wrap[head.regions["lips"]].mean(axis=0)[:2] + [45.0, 0.0]
    return int(face[np.linalg.norm(wrap[face, :2] - beside, axis=1).argmin()])


def let_go(release: Release, frames: int) -> dict:
    """March the release by every scheme: swings, and distances between equal models."""
    p = release.face.parameters
    equation = {
        "Eq. 9, p's frequency and damping": Recurrence.from_oscillator(p.frequency, p.damping, FRAME),
        EQUATION_AS_EULER: Recurrence.from_implicit_euler(p.frequency, FRAME),
    }
    frames_of: dict[str, Frames] = {
        name: release.play_recurrence(recurrence, frames) for name, recurrence in equation.items()
    }
    frames_of[PROJECTIVE] = release.play("implicit Euler", frames, solver="projective", tolerance=TIGHT)
    runs = {EULER: release.play("implicit Euler", frames, tolerance=TIGHT)}
    runs |= {
        _name_march(scheme, count): release.play(scheme, frames, count) for scheme in SCHEMES for count in PER_FRAME
    }
    rows = [_describe_motion(release, name, run) | _describe_end(run) for name, run in frames_of.items()]
    for name, run in runs.items():
        rows.append(_describe_motion(release, name, run) | _count_work(run) | _describe_end(run))
    same = runs.pop(EULER)
    amplitude = float(np.abs(release.start - release.scene.vertices).max())
    return {
        "areal_density": release.areal,
        "amplitude_mm": amplitude,
        "rows": rows,
        "to_fem": {
            name: _compare_motions(frames_of[name].positions, same.positions, amplitude)
            for name in (EQUATION_AS_EULER, PROJECTIVE)
        },
        "traces": {
            name: {
                "times": (run.time_step * np.arange(len(run.positions))).tolist(),
                "left": release.motion(run.positions).tolist(),
            }
            for name, run in (frames_of | runs).items()
        },
    }


def _compare_motions(positions: Floats, others: Floats, whole: float) -> float | None:
    """The largest difference of two motions over a length; None where one of them stopped early."""
    return float(np.abs(positions - others).max() / whole) if len(positions) == len(others) else None


def _name_march(scheme: str, per_frame: int) -> str:
    return f"FEM, {scheme}, {per_frame} per frame"


def _describe_motion(release: Release, name: str, run: Frames) -> dict:
    shares = release.motion(run.positions)
    fit = swing(run.time_step * np.arange(len(shares)), shares) if len(shares) > FEWEST else Swing(None, None, None)
    return {"name": name, "steps_per_s": 1.0 / run.time_step} | asdict(fit)


def _describe_end(run: Frames) -> dict:
    """Whether a march made all its steps; if not, after how many it stopped, and why."""
    steps = len(run.positions) - 1
    return {"converged": run.converged, "stopped": None if run.converged else f"after {steps} steps: {run.reason}"}


def _count_work(run: Frames) -> dict:
    return {"iterations": float(run.iterations.mean()) if run.iterations.size else None}


def shake(release: Release, frames: int) -> dict:
    """Shake the head from side to side: the skin's peak in the head's frame [mm], and how far others are off."""
    reach, pace = SHAKE[0], 2.0 * np.pi * SHAKE[1]

    def shaken(t: float) -> Floats:
        return np.array([-reach * pace**2 * np.sin(pace * t), 0.0, 0.0])

    rest = release.scene.vertices[: len(release.face.head.bone)]
    runs = {
        name: release.play("implicit Euler", frames, solver=solver, tolerance=TIGHT, shaken=shaken)
        for name, solver in ((PROJECTIVE, "projective"), (EULER, "fenicsx"))
    }
    runs |= {f"FEM, {scheme}": release.play(scheme, frames, shaken=shaken) for scheme in SCHEMES[1:]}
    fine = release.play("Newmark", frames, PER_FRAME[-1], shaken=shaken)
    finest, exact = f"FEM, Newmark, {PER_FRAME[-1]} per frame", fine.positions[:: PER_FRAME[-1]]
    motions = {name: run.positions for name, run in runs.items()} | {finest: exact}
    rows = []
    for name, positions in motions.items():
        together = min(len(positions), len(exact))
        rows.append(
            {
                "name": name,
                "peak_mm": float(np.linalg.norm(positions - rest, axis=2).max()),
                "off_mm": float(np.linalg.norm(positions[:together] - exact[:together], axis=2).max()),
                **_describe_end(fine if name == finest else runs[name]),
            }
        )
    euler = motions[EULER]
    to_fem = _compare_motions(motions[PROJECTIVE], euler, float(np.abs(euler - rest).max()))
    return {"rows": rows, "to_fem": to_fem}
