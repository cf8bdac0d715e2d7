"""What the study of dynamics measures: releases by time step and mass, and a shaken head, with gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np

from ..lhm import LayeredHead
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..reference import Trajectory, march, solve, terms
from ..reference.dynamics import coefficients, implicit_euler
from ..reference.parameters import TISSUE_DENSITY
from ..reference.schemes import SCHEMES
from .gates import at_most
from .release import FEWEST, FINE, FRAME, TIGHT, Frames, Release, Swing, swing

PER_FRAME = (1, 2, 4)
SHAKE = (5.0, 2.0)  # mm to either side, Hz; 20 mm turn 700 tets inside out, and a step has more than one answer then
RAYLEIGH = (19.0, 0.055)  # 1/s, s: facial tissue
FAST = 16  # steps per frame that resolve the tissue's own swing
OWN_FRAMES = 4
GRAVITY = np.array([0.0, -9810.0, 0.0])  # mm/s²


def study(head: LayeredHead, at: int, frames: int, progress: OnProgress) -> dict:
    """Release and shake a head; every figure of the report."""
    release = Release(head, at)
    p = release.parameters
    progress("dynamics: Eq. 9 and projective dynamics", 0.05)
    equation = {
        "Eq. 9, p's frequency and damping": coefficients(p.frequency, p.damping, FRAME),
        "Eq. 9, implicit Euler's coefficients": implicit_euler(p.frequency, FRAME),
    }
    frames_of = {name: release.by_recurrence(recurrence, frames) for name, recurrence in equation.items()}
    frames_of["PD, mass on the skin"] = release.by_projective_dynamics(frames)
    progress("dynamics: time steps of finite elements", 0.2)
    runs = {"FEM, implicit Euler": release.by_elements("implicit Euler", frames, tolerance=TIGHT)}
    runs |= {
        _label(scheme, count): release.by_elements(scheme, frames, count) for scheme in SCHEMES for count in PER_FRAME
    }
    progress("dynamics: tissue's own mass, and a shaken head", 0.8)
    rows = [_row(release, name, run.positions, FRAME) | _end(run) for name, run in frames_of.items()]
    for name, run in runs.items():
        rows.append(_row(release, name, run.positions, run.time_step) | _energy(run) | _end(run))
    same = runs.pop("FEM, implicit Euler")
    n, amplitude = len(head.bone), float(np.abs(release.start - release.scene.vertices).max())
    to_fem = {
        name: _apart(frames_of[name].positions[:, :n], same.positions, amplitude)
        for name in ("Eq. 9, implicit Euler's coefficients", "PD, mass on the skin")
    }
    results = {
        "vertices": n,
        "tets": len(head.tets),
        "frames": frames,
        "areal_density": release.areal,
        "amplitude_mm": amplitude,
        "release": rows,
        "to_fem": to_fem,
        "steps": _steps(runs),
        "own_mass": _own_mass(release, frames),
        "shake": _shake(release, frames),
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
    return results | {"gates": _gates(results)}


def _apart(positions: Floats, others: Floats, whole: float) -> float | None:
    """The largest difference of two motions over a length; None where one of them stopped early."""
    return float(np.abs(positions - others).max() / whole) if len(positions) == len(others) else None


def _label(scheme: str, per_frame: int) -> str:
    return f"FEM, {scheme}, {per_frame} per frame"


def _row(release: Release, name: str, positions: Floats, time_step: float) -> dict:
    left = release.motion(positions)
    found = swing(time_step * np.arange(len(left)), left) if len(left) > FEWEST else Swing(None, None, None)
    return {"name": name, "steps_per_s": 1.0 / time_step} | asdict(found)


def _end(run: Trajectory | Frames) -> dict:
    """Whether a march made all its steps; if not, after how many it stopped, and why."""
    steps = len(run.positions) - 1
    return {"converged": run.converged, "stopped": None if run.converged else f"after {steps} steps: {run.reason}"}


def _energy(run: Trajectory) -> dict:
    """What the scheme lost, and the most that it ever gained, of the energy at the start."""
    share = run.energies.balance / (run.energies.kinetic + run.energies.potential)[0]
    return {
        "lost": float(-share[-1]),
        "gained": float(np.diff(share).max(initial=0.0)),
        "iterations": float(run.iterations.mean()) if run.iterations.size else None,
        "factorisations": int(run.factorisations.sum()),
    }


def _steps(runs: Mapping[str, Trajectory]) -> list[dict]:
    """Errors of time steps at the frames' ends [mm], to Newmark's extrapolated to h = 0, and the observed order."""
    found = {
        name: run.positions[:: round(FRAME / run.time_step)] if run.converged else None for name, run in runs.items()
    }
    half, finest = (found[_label("Newmark", count)] for count in PER_FRAME[1:])
    exact = None if half is None or finest is None else finest + (finest - half) / 3.0
    rows = []
    for scheme in SCHEMES:
        series = [found[_label(scheme, count)] for count in PER_FRAME]
        for count, positions in zip(PER_FRAME, series, strict=True):
            off = None if positions is None or exact is None else positions - exact
            rows.append(
                {
                    "name": scheme,
                    "per_frame": count,
                    "rms_mm": None if off is None else _rms(off),
                    "peak_mm": None if off is None else float(np.linalg.norm(off, axis=2).max()),
                    "order": _order(series) if count == PER_FRAME[-1] else None,
                }
            )
    return rows


def _order(series: Sequence[Floats | None]) -> float | None:
    """The observed order of three answers, each by half the step of the one before; None where one is missing."""
    coarse, middle, fine = series
    if coarse is None or middle is None or fine is None:
        return None
    return float(np.log2(_rms(coarse - middle) / _rms(middle - fine)))


def _rms(difference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=2))))


def _own_mass(release: Release, frames: int) -> list[dict]:
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
                **_end(run),
            }
        )
    return rows


def _shake(release: Release, frames: int) -> dict:
    """The head shaken from side to side: the skin's peak in the head's frame [mm], and how far others are off."""
    reach, pace = SHAKE[0], 2.0 * np.pi * SHAKE[1]

    def shaken(t: float) -> Floats:
        return np.array([-reach * pace**2 * np.sin(pace * t), 0.0, 0.0])

    rest = release.scene.vertices[: len(release.head.bone)]
    projective = "PD, mass on the skin"
    runs: dict[str, Trajectory | Frames] = {projective: release.by_projective_dynamics(frames, shaken)}
    runs["FEM, implicit Euler"] = release.by_elements("implicit Euler", frames, tolerance=TIGHT, shaken=shaken)
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
                **_end(fine if name == finest else runs[name]),
            }
        )
    euler = found["FEM, implicit Euler"]
    to_fem = _apart(found[projective], euler, float(np.abs(euler - rest).max()))
    return {"rows": rows, "to_fem": to_fem, "reach_mm": SHAKE[0], "hertz": SHAKE[1]}


def _gates(results: Mapping) -> list[dict]:
    orders = {row["name"]: row["order"] for row in results["steps"] if row["per_frame"] == PER_FRAME[-1]}
    off_two = {name: None if order is None else abs(order - 2.0) for name, order in orders.items()}
    marches = results["release"] + results["own_mass"] + results["shake"]["rows"]
    euler = [row["gained"] for row in results["release"] if "implicit Euler" in row["name"] and "gained" in row]
    return [
        *(at_most(f"{name} to implicit Euler by FEM, of the largest displacement", off, 1e-5)
          for name, off in results["to_fem"].items()),
        at_most("shaken: PD to implicit Euler by FEM, of the largest displacement", results["shake"]["to_fem"], 1e-5),
        *(at_most(f"{name}: order of the time step, from 2", off_two[name], 0.3) for name in SCHEMES[1:]),
        at_most("implicit Euler: the most energy that a step gains, of the start's", max(euler), 1e-9),
        at_most("marches that did not reach what was asked", sum(not row["converged"] for row in marches), 0),
    ]  # fmt: skip
