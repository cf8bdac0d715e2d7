"""Methods that agreement has beside METHODS, which tell more of their answers, and scenes as faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.mesh import Floats
from ....lhm.head.head import LayeredHead
from ....reference import Face, Scene, SettledFace, Solution, prepare, projective, solve, terms
from ....reference.face.facial import PD_ENERGY, FaceLaw, apply_law
from ....surrogate import methods as m
from ....surrogate.methods import Method, Solved, SolvedRig, tell_solution
from ..cases import Case
from ..measures import TIGHT, distances

FENICSX_FROM_PD = "FEniCSx, from PD's answer"
OTHER_START, WITHOUT = "PD, from another start", "PD, without the effect"
WARM = TIGHT / m.ROUGH
"""Gradient norm over its start of what starts at PD's answer to ROUGH."""


@dataclass(frozen=True, eq=False)
class FaceOfScene(Face):
    """A face whose every expression is one scene of its head, in which no target holds the skin."""

    make_scene: Callable[[LayeredHead], Scene] | None = None

    def expression_scene(self, expression: Floats, law: FaceLaw = PD_ENERGY) -> Scene:
        """Return the scene under a law, whatever the expression."""
        assert self.make_scene is not None
        return apply_law(self.make_scene(self.head), law)


def settle_tightly(face: Face) -> tuple[Face, SettledFace]:
    """Settle a face by PD to TIGHT. InputError where it does not converge."""
    own = replace(face, settling={"tolerance": TIGHT})
    settled = own.settled()
    if not settled.converged:
        raise InputError(f"the neutral face does not settle ({settled.reason})")
    return own, settled


def watch_pd(face: Face) -> SolvedRig:
    """Bind PD to TIGHT, whose frames tell the way, the volumes, and how near lips come to their targets."""
    own, settled = settle_tightly(face)

    def solve_frame(weights: Floats) -> Solved:
        scene = own.scene(weights)
        solution = prepare(scene).solve(start=settled.positions, tolerance=TIGHT)
        solved = tell_solution(own, weights, solution)
        return replace(solved, told={**solved.told, **tell_pd(own, weights, scene, solution)})

    return SolvedRig(own.skin, solve_frame, settled)


def tell_pd(face: Face, weights: Floats, scene: Scene, solution: Solution) -> dict[str, Any]:
    """Say what PD's answer is: volumes, rise of the energy, overlap of lips, how near they come to their targets."""
    head, settled, soft = face.head, face.settled(), slice(0, len(face.head.soft.tets))
    volumes = scene.volumes[soft]
    told: dict[str, Any] = {
        "least_ratio": float(solution.volume_ratio.min()),
        "soft_volume_percent": float(100.0 * (solution.volume_ratio[soft] @ volumes / volumes.sum() - 1.0)),
        "neutral_change_mm": float(distances(settled.skin, head.skin.vertices).max()),
    }
    if isinstance(face, FaceOfScene):
        return told
    if scene.of(terms.Contact):
        told |= measure_overlap(scene, solution.positions)
    else:  # the way without contact, until something is met, is in the history, too
        energy = solution.history.energy
        size = np.maximum(np.abs(energy[:-1]), np.finfo(float).tiny)
        told["energy_rise"] = float(np.max(np.diff(energy) / size, initial=0.0))
    targets = head.wrap_targets(settled.targets(face.blend(weights)))
    gaps = distances(solution.positions[: len(head.bone)], targets)[head.regions["lips"]]
    return told | {"lips_median_mm": float(np.median(gaps)), "lips_max_mm": float(gaps.max())}


def measure_overlap(scene: Scene, positions: Floats) -> dict[str, Any]:
    """Count pairs of triangles in contact that cross, and measure how deep [mm], at positions (n, 3) [mm]."""
    (contact,) = scene.of(terms.Contact)
    pairs, depth = TriangleTree(positions, contact.triangles).measure_overlap()
    return {"crossings": pairs, "overlap_mm": depth}


def start_elsewhere(face: Face) -> SolvedRig:
    """Bind PD from where every wrap is moved by the skin wrap's way to its targets, bone or not: it inverts tets."""
    own, settled = settle_tightly(face)
    head = own.head

    def solve_frame(weights: Floats) -> Solved:
        way = head.wrap_targets(settled.targets(own.blend(weights))) - head.skin_wrap.vertices
        start = head.vertices + np.tile(way, (3, 1))
        return tell_solution(own, weights, prepare(own.scene(weights)).solve(start=start, tolerance=TIGHT))

    return SolvedRig(own.skin, solve_frame, settled)


def leave_out(case: Case, face: Face) -> SolvedRig:
    """Bind PD without a case's effect and without contact; overlap is told of the surfaces that contact keeps apart."""
    assert case.without is not None
    choices = {name: choice for name, choice in face.choices.items() if name != "contact"}
    rig = watch_pd(replace(face, parameters=case.without(face.head), choices=choices))

    def solve_frame(weights: Floats) -> Solved:
        solved = rig.solve(weights)
        more = measure_overlap(face.scene(weights), solved.positions) if case.contact else {}
        return replace(solved, told={**solved.told, **more})

    return SolvedRig(face.skin, solve_frame, rig.settled)


def freeze_contact(face: Face) -> SolvedRig:
    """Bind FEniCSx, which models no contact, with the pairs that are near in PD's answer, from a rough answer on."""
    own, settled = settle_tightly(face)
    by_pd = watch_pd(face)

    def solve_frame(weights: Floats) -> Solved:
        prepared = projective.prepare(own.scene(weights))
        rough = prepared.solve(start=settled.positions, tolerance=m.ROUGH).positions
        frozen = prepared.freeze_contact(by_pd.solve(weights).positions)
        return tell_solution(own, weights, solve(frozen, solver="fenicsx", start=rough, tolerance=WARM))

    return SolvedRig(own.skin, solve_frame, settled)


WATCHED = Method(m.PD, watch_pd)
FROM_PD = m.solve_by(FENICSX_FROM_PD, "fenicsx", "#d62728", tolerance=WARM, near=True)


def list_solvers(case: Case, laws: Sequence[str]) -> list[Method]:
    """List the solvers of a case by PD's energy and by laws; scikit-fem checks expressions and loads."""
    if case.contact:
        solvers = [Method(m.FENICSX, freeze_contact)]
    else:
        solvers = [m.METHODS[m.FENICSX], FROM_PD, *map(m.solve_law, laws)]
    if case.is_plain:
        solvers += [m.METHODS[m.SKFEM], *(m.solve_law(law, m.SKFEM) for law in laws)]
    if case.scene is None:
        solvers.append(Method(OTHER_START, start_elsewhere))
    if case.without is not None:
        solvers.append(Method(WITHOUT, lambda face: leave_out(case, face)))
    return solvers
