"""What the study of dynamics measures: releases by time step and mass, and a shaken head, with gates."""

from __future__ import annotations

from collections.abc import Mapping
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
from .release import FINE, FRAME, TIGHT, Release, swing

PER_FRAME = (1, 2, 4)
SHAKE = (20.0, 2.0)  # mm to either side, Hz
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
    rows = [_row(release, name, positions, FRAME) for name, positions in frames_of.items()]
    for name, run in runs.items():
        rows.append(_row(release, name, run.positions, run.times[1]) | _energy(run))
    same = runs.pop("FEM, implicit Euler").positions
    n, amplitude = len(head.bone), float(np.abs(release.start - release.scene.vertices).max())
    to_fem = {
        name: float(np.abs(frames_of[name][:, :n] - same).max() / amplitude)
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
            name: {"times": (FRAME * np.arange(frames + 1)).tolist(), "left": release.motion(positions).tolist()}
            for name, positions in frames_of.items()
        }
        | {
            name: {"times": run.times.tolist(), "left": release.motion(run.positions).tolist()}
            for name, run in runs.items()
        },
    }
    return results | {"gates": _gates(results)}


def _label(scheme: str, per_frame: int) -> str:
    return f"FEM, {scheme}, {per_frame} per frame"


def _row(release: Release, name: str, positions: Floats, time_step: float) -> dict:
    left = release.motion(positions)
    return {"name": name, "steps_per_s": 1.0 / time_step} | asdict(swing(time_step * np.arange(len(left)), left))


def _energy(run: Trajectory) -> dict:
    """What the scheme lost, and the most that it ever gained, of the energy at the start."""
    share = run.energies.balance / (run.energies.kinetic + run.energies.potential)[0]
    return {
        "converged": run.converged,
        "lost": float(-share[-1]),
        "gained": float(max(np.diff(share).max(), 0.0)),
        "iterations": float(run.iterations.mean()),
        "factorisations": int(run.factorisations.sum()),
    }


def _steps(runs: Mapping[str, Trajectory]) -> list[dict]:
    """Errors of time steps at the frames' ends [mm], to Newmark's extrapolated to h = 0, and the observed order."""
    found = {name: run.positions[:: round(FRAME / run.times[1])] for name, run in runs.items()}
    half, finest = (found[_label("Newmark", count)] for count in PER_FRAME[1:])
    exact = finest + (finest - half) / 3.0
    rows = []
    for scheme in SCHEMES:
        series = [found[_label(scheme, count)] for count in PER_FRAME]
        coarse, fine = (_rms(a - b) for a, b in zip(series[:-1], series[1:], strict=True))
        for count, positions in zip(PER_FRAME, series, strict=True):
            off = np.linalg.norm(positions - exact, axis=2)
            rows.append(
                {
                    "name": scheme,
                    "per_frame": count,
                    "rms_mm": _rms(positions - exact),
                    "peak_mm": float(off.max()),
                    "order": float(np.log2(coarse / fine)) if count == PER_FRAME[-1] else None,
                }
            )
    return rows


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
        found = None if damped else swing(run.times, left)
        below = np.flatnonzero(np.abs(left) < 0.1)
        rows.append(
            {
                "name": name,
                "frequency": found and found.frequency,
                "decay": found and found.damping,
                "to_a_tenth_s": float(run.times[below[0]]) if damped and below.size else None,
                "converged": run.converged,
            }
        )
    return rows


def _shake(release: Release, frames: int) -> dict:
    """The head shaken from side to side: the skin's peak in the head's frame [mm], and how far others are off."""
    reach, pace = SHAKE[0], 2.0 * np.pi * SHAKE[1]

    def shaken(t: float) -> Floats:
        return np.array([-reach * pace**2 * np.sin(pace * t), 0.0, 0.0])

    rest = release.scene.vertices[: len(release.head.bone)]
    projective = release.by_projective_dynamics(frames, shaken)[:, : len(rest)]
    euler = release.by_elements("implicit Euler", frames, tolerance=TIGHT, shaken=shaken).positions
    fine = release.by_elements("Newmark", frames, PER_FRAME[-1], shaken=shaken).positions[:: PER_FRAME[-1]]
    others = {"PD, mass on the skin": projective, "FEM, implicit Euler": euler}
    others |= {f"FEM, {scheme}": release.by_elements(scheme, frames, shaken=shaken).positions for scheme in SCHEMES[1:]}
    peak = float(np.abs(euler - rest).max())
    rows = [
        {
            "name": name,
            "peak_mm": float(np.linalg.norm(positions - rest, axis=2).max()),
            "off_mm": float(np.linalg.norm(positions - fine, axis=2).max()),
        }
        for name, positions in {**others, f"FEM, Newmark, {PER_FRAME[-1]} per frame": fine}.items()
    ]
    return {"rows": rows, "to_fem": float(np.abs(projective - euler).max() / peak)}


def _gates(results: Mapping) -> list[dict]:
    orders = {row["name"]: row["order"] for row in results["steps"] if row["order"] is not None}
    marches = [row for row in results["release"] if "converged" in row] + results["own_mass"]
    euler = [row["gained"] for row in results["release"] if "implicit Euler" in row["name"] and "gained" in row]
    return [
        *(at_most(f"{name} to implicit Euler by FEM, of the largest displacement", off, 1e-5)
          for name, off in results["to_fem"].items()),
        at_most("shaken: PD to implicit Euler by FEM, of the largest displacement", results["shake"]["to_fem"], 1e-5),
        *(at_most(f"{name}: order of the time step, from 2", abs(orders[name] - 2.0), 0.3) for name in SCHEMES[1:]),
        at_most("implicit Euler: the most energy that a step gains, of the start's", max(euler), 1e-9),
        at_most("marches that did not reach what was asked", sum(not row["converged"] for row in marches), 0),
    ]  # fmt: skip
