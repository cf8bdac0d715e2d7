"""A cheek let go and a head shaken: Eq. 9, projective dynamics with mass on the skin, and FEM's time steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm import LayeredHead
from ....lhm.base.errors import InputError
from ....lhm.base.limits import LEVEL, STUDIED_FRAMES
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import Trajectory, march, solve, terms
from ....reference.face.dynamics import Recurrence
from ....reference.face.parameters import TISSUE_DENSITY
from ....reference.march import SCHEMES
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..person import OfPerson
from .release import FEWEST, FINE, FRAME, TIGHT, Frames, Release, Swing, swing

PER_FRAME = (1, 2, 4)
SHAKE = (5.0, 2.0)  # mm to either side, Hz; 20 mm turn 700 tets inside out, and a step has more than one answer then
RAYLEIGH = (19.0, 0.055)  # 1/s, s: facial tissue
FAST = 16  # steps per frame that resolve the tissue's own swing
OWN_FRAMES = 4
LEAST_FRAMES = 8
GRAVITY = np.array([0.0, -9810.0, 0.0])  # mm/s²
RELEASED, OWN_MASS, SHAKEN = "a cheek let go", "a cheek let go, tissue's own mass", "a shaken head"
EQUATION_AS_EULER, PROJECTIVE = "Eq. 9, implicit Euler's coefficients", "PD, mass on the skin"
EULER = "FEM, implicit Euler"
"""All three model the same."""


@dataclass(frozen=True)
class Dynamics(OfPerson):
    """Frames at 60 per second of one head; marches of a motion are compared frame by frame, so they are one task."""

    name = "dynamics"
    heading = "Does a moving face swing alike by every method?"
    question = "Do Eq. 9, projective dynamics and FEM's time steps move a face alike, and what do they lose?"
    columns = (
        Column("name", "march"),
        Column("steps_per_s", "steps per second"),
        Column("frequency", "frequency [Hz]"),
        Column("damping", "damping ratio"),
        Column("misfit", "misfit of the cosine"),
        Column("lost", "energy lost"),
        Column("to_a_tenth_s", "to a tenth after [s]"),
        Column("peak_mm", "peak [mm]"),
        Column("off_mm", "off the finest march [mm]"),
        Column("iterations", "iterations a step", cost=True),
        Column("factorisations", "factorisations", cost=True),
        Column("stopped", "stopped"),
    )
    note = (
        "Bones are held. Frequency (undamped) and damping ratio are those of a damped cosine fitted to the motion. "
        "Only Eq. 9 with p's damping has a damper; what implicit Euler loses is numerical. Eq. 9 gives mass to the "
        "skin alone: what the springs of the expression need to swing at p's frequency. The tissue's own mass is 1040 "
        "kg/m³, where it says so with Rayleigh damping 19 /s and 0.055 s. A displacement that grows linearly from the "
        "bone gives each point of the skin a third of the mass below it. Without springs the tissue hangs on its "
        "bones and on the held lining of mouth and lids. It is let go from its sag under 1 g, which excites many "
        "modes. Without a damper the decay is that of modes that fall out of step, over 4 frames. Shaken: 5 mm to "
        "either side at 2 Hz; only Eq. 9 sees no acceleration of the head. A march that stopped is compared up to "
        "there."
    )

    level: int = option(1, "of the template: 1,212, 4,842 or 19,362 vertices", bound=LEVEL)
    frames: int = option(24, f"at 60 per second, at least {LEAST_FRAMES}", bound=STUDIED_FRAMES)

    def tasks(self) -> Sequence[Task]:
        """List the motions; InputError for too few frames."""
        self.check()
        if self.frames < LEAST_FRAMES:
            raise InputError(f"frames: at least {LEAST_FRAMES} are needed, got {self.frames}")
        return [Task(case, "all marches") for case in (RELEASED, OWN_MASS, SHAKEN)]

    def measure(self, task: Task) -> Values:
        """Measure every march of a motion."""
        released = _release(self)
        if task.case == RELEASED:
            return let_go(released, self.frames)
        if task.case == OWN_MASS:
            return {"rows": release_tissue(released, self.frames)}
        return shake(released, self.frames)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that marches agree where they model the same, schemes have their order, and all end."""
        gates: list[dict] = []
        for row in rows:
            values = row.values
            if row.case == RELEASED:
                orders = {step["name"]: step["order"] for step in values["steps"] if step["per_frame"] == PER_FRAME[-1]}
                off_two = {name: None if order is None else abs(order - 2.0) for name, order in orders.items()}
                euler = [r["gained"] for r in values["rows"] if "implicit Euler" in r["name"] and "gained" in r]
                gates += [
                    *(at_most(f"{name} to implicit Euler by FEM, of the largest displacement", off, 1e-5)
                      for name, off in values["to_fem"].items()),
                    *(at_most(f"{name}: order of the time step, from 2", off_two[name], 0.3) for name in SCHEMES[1:]),
                    at_most("implicit Euler: the most energy that a step gains, of the start's", max(euler), 1e-9),
                ]  # fmt: skip
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

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the error of the time step."""
        return [
            Table(
                "The error of the time step",
                ["scheme", "steps a frame", "RMS [mm]", "peak [mm]", "order"],
                [
                    [step[key] for key in ("name", "per_frame", "rms_mm", "peak_mm", "order")]
                    for step in row.values["steps"]
                ],
                "At the frames' ends, to Newmark's answers extrapolated to no step at all; the order by three steps' "
                "differences.",
            )
            for row in rows
            if row.case == RELEASED
        ]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw what is left of the first displacement against time, a line per march."""
        traces: Mapping = next((row.values["traces"] for row in rows if row.case == RELEASED), {})
        if not traces:
            return {}
        figure, axis = subplots(figsize=(9, 4.5))
        for name, trace in traces.items():
            if not name.endswith("2 per frame"):
                style = "-" if name.startswith("FEM") else "--"
                axis.plot(trace["times"], trace["left"], style, lw=1.3, label=name)
        axis.set(xlabel="time [s]", ylabel="share of the first displacement")
        axis.axhline(0.0, color="#bbbbbb", lw=0.8)
        figure.legend(loc="outside right upper")
        return {"What is left of the first displacement.": to_svg(figure)}


@lru_cache(maxsize=1)
def _release(study: Dynamics) -> Release:
    head = study.person().head
    return Release(head, cheek(head))


def cheek(head: LayeredHead) -> int:
    """Give the skin wrap's vertex of the face nearest to 45 mm beside the lips."""
    wrap, face = head.skin_wrap.vertices, np.flatnonzero(head.regions["face"])
    beside = wrap[head.regions["lips"]].mean(axis=0)[:2] + [45.0, 0.0]
    return int(face[np.linalg.norm(wrap[face, :2] - beside, axis=1).argmin()])


def let_go(release: Release, frames: int) -> dict:
    """March the release by every scheme: swings, energies, distances between equal models, errors of steps."""
    p = release.parameters
    equation = {
        "Eq. 9, p's frequency and damping": Recurrence.from_oscillator(p.frequency, p.damping, FRAME),
        EQUATION_AS_EULER: Recurrence.from_implicit_euler(p.frequency, FRAME),
    }
    frames_of = {name: release.by_recurrence(recurrence, frames) for name, recurrence in equation.items()}
    frames_of[PROJECTIVE] = release.by_projective_dynamics(frames)
    runs = {EULER: release.by_elements("implicit Euler", frames, tolerance=TIGHT)}
    runs |= {
        _name_march(scheme, count): release.by_elements(scheme, frames, count)
        for scheme in SCHEMES
        for count in PER_FRAME
    }
    rows = [
        _describe_motion(release, name, run.positions, FRAME) | _describe_end(run) for name, run in frames_of.items()
    ]
    for name, run in runs.items():
        rows.append(
            _describe_motion(release, name, run.positions, run.time_step) | _describe_energy(run) | _describe_end(run)
        )
    same = runs.pop(EULER)
    n, amplitude = len(release.head.bone), float(np.abs(release.start - release.scene.vertices).max())
    return {
        "areal_density": release.areal,
        "amplitude_mm": amplitude,
        "rows": rows,
        "to_fem": {
            name: _compare_motions(frames_of[name].positions[:, :n], same.positions, amplitude)
            for name in (EQUATION_AS_EULER, PROJECTIVE)
        },
        "steps": _compare_steps(runs),
        "traces": {
            name: {
                "times": (FRAME * np.arange(len(run.positions))).tolist(),
                "left": release.motion(run.positions).tolist(),
            }
            for name, run in frames_of.items()
        }
        | {
            name: {"times": run.times.tolist(), "left": release.motion(run.positions).tolist()}
            for name, run in runs.items()
        },
    }


def _compare_motions(positions: Floats, others: Floats, whole: float) -> float | None:
    """The largest difference of two motions over a length; None where one of them stopped early."""
    return float(np.abs(positions - others).max() / whole) if len(positions) == len(others) else None


def _name_march(scheme: str, per_frame: int) -> str:
    return f"FEM, {scheme}, {per_frame} per frame"


def _describe_motion(release: Release, name: str, positions: Floats, time_step: float) -> dict:
    left = release.motion(positions)
    found = swing(time_step * np.arange(len(left)), left) if len(left) > FEWEST else Swing(None, None, None)
    return {"name": name, "steps_per_s": 1.0 / time_step} | asdict(found)


def _describe_end(run: Trajectory | Frames) -> dict:
    """Whether a march made all its steps; if not, after how many it stopped, and why."""
    steps = len(run.positions) - 1
    return {"converged": run.converged, "stopped": None if run.converged else f"after {steps} steps: {run.reason}"}


def _describe_energy(run: Trajectory) -> dict:
    """What the scheme lost, and the most that it ever gained, of the energy at the start."""
    share = run.energies.balance / (run.energies.kinetic + run.energies.potential)[0]
    return {
        "lost": float(-share[-1]),
        "gained": float(np.diff(share).max(initial=0.0)),
        "iterations": float(run.iterations.mean()) if run.iterations.size else None,
        "factorisations": int(run.factorisations.sum()),
    }


def _compare_steps(runs: Mapping[str, Trajectory]) -> list[dict]:
    """Errors of time steps at the frames' ends [mm], to Newmark's extrapolated to h = 0, and the observed order."""
    found = {
        name: run.positions[:: round(FRAME / run.time_step)] if run.converged else None for name, run in runs.items()
    }
    half, finest = (found[_name_march("Newmark", count)] for count in PER_FRAME[1:])
    exact = None if half is None or finest is None else finest + (finest - half) / 3.0
    rows = []
    for scheme in SCHEMES:
        series = [found[_name_march(scheme, count)] for count in PER_FRAME]
        coarse, middle, fine = series
        order = None
        if coarse is not None and middle is not None and fine is not None:
            order = float(np.log2(_rms(coarse - middle) / _rms(middle - fine)))
        for count, positions in zip(PER_FRAME, series, strict=True):
            off = None if positions is None or exact is None else positions - exact
            rows.append(
                {
                    "name": scheme,
                    "per_frame": count,
                    "rms_mm": None if off is None else _rms(off),
                    "peak_mm": None if off is None else float(np.linalg.norm(off, axis=2).max()),
                    "order": order if count == PER_FRAME[-1] else None,
                }
            )
    return rows


def _rms(difference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=2))))


def release_tissue(release: Release, frames: int) -> list[dict]:
    """Release from a sag under 1 g with the mass of tissue, without and with springs, undamped and damped."""
    head = release.head
    thickness = np.linalg.norm(head.skin_wrap.vertices - head.skull_wrap.vertices, axis=1)
    skin = head.skin_wrap.triangles
    weight = terms.Gravity(GRAVITY, TISSUE_DENSITY)
    sagged = solve(
        replace(release.passive, terms=(*release.passive.terms, weight)), solver="fenicsx", tolerance=TIGHT
    ).positions
    whole = {"density": TISSUE_DENSITY}
    third = {"skin": skin, "skin_density": TISSUE_DENSITY * thickness[skin].mean(axis=1) / 3.0}
    cases = (
        ("no springs, all tissue's mass, lumped", release.passive, whole, False),
        ("no springs, all tissue's mass, consistent", release.passive, {**whole, "mass": "consistent"}, False),
        ("no springs, a third of it, on the skin", release.passive, third, False),
        ("no springs, all, Rayleigh damping", release.passive, {**whole, "damping": RAYLEIGH}, True),
        ("springs, all, Rayleigh damping", release.scene, {**whole, "damping": RAYLEIGH}, True),
    )
    rows = []
    for name, scene, mass, damped in cases:
        # With Rayleigh's stiffness part high frequencies creep: a scheme is needed that forgets the release's jump.
        per_frame, shown = (PER_FRAME[-1], frames) if damped else (FAST, OWN_FRAMES)
        run = march(
            scene,
            time_step=FRAME / per_frame,
            steps=per_frame * shown,
            scheme="implicit Euler" if damped else "Newmark",
            positions=sagged,
            tolerance=FINE,
            keep=np.arange(len(head.bone)),
            **mass,
        )
        left = release.motion(run.positions, sagged)
        found = None if damped or len(left) <= FEWEST else swing(run.times, left)
        below = np.flatnonzero(np.abs(left) < 0.1)
        rows.append(
            {
                "name": name,
                "frequency": found and found.frequency,
                "decay": found and found.damping,
                "to_a_tenth_s": float(run.times[below[0]]) if damped and below.size else None,
                **_describe_end(run),
            }
        )
    return rows


def shake(release: Release, frames: int) -> dict:
    """Shake the head from side to side: the skin's peak in the head's frame [mm], and how far others are off."""
    reach, pace = SHAKE[0], 2.0 * np.pi * SHAKE[1]

    def shaken(t: float) -> Floats:
        return np.array([-reach * pace**2 * np.sin(pace * t), 0.0, 0.0])

    rest = release.scene.vertices[: len(release.head.bone)]
    runs: dict[str, Trajectory | Frames] = {PROJECTIVE: release.by_projective_dynamics(frames, shaken)}
    runs[EULER] = release.by_elements("implicit Euler", frames, tolerance=TIGHT, shaken=shaken)
    runs |= {f"FEM, {scheme}": release.by_elements(scheme, frames, shaken=shaken) for scheme in SCHEMES[1:]}
    fine = release.by_elements("Newmark", frames, PER_FRAME[-1], shaken=shaken)
    finest, exact = f"FEM, Newmark, {PER_FRAME[-1]} per frame", fine.positions[:: PER_FRAME[-1]]
    found = {name: run.positions[:, : len(rest)] for name, run in runs.items()} | {finest: exact}
    rows = []
    for name, positions in found.items():
        together = min(len(positions), len(exact))
        rows.append(
            {
                "name": name,
                "peak_mm": float(np.linalg.norm(positions - rest, axis=2).max()),
                "off_mm": float(np.linalg.norm(positions[:together] - exact[:together], axis=2).max()),
                **_describe_end(fine if name == finest else runs[name]),
            }
        )
    euler = found[EULER]
    to_fem = _compare_motions(found[PROJECTIVE], euler, float(np.abs(euler - rest).max()))
    return {"rows": rows, "to_fem": to_fem}
