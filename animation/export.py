"""A face as a rig for other programs: skin, eyes and teeth, moved by morph targets of ARKit's 52 names.

The targets are blendshapes, or the simulator's derivatives: physics at the price of blendshapes, whose sums leave the
simulator by what is not linear. That error is measured, and stands in the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..lhm.base.files.glb import write_glb
from ..lhm.base.files.morphs import MorphedSurface, MorphRig
from ..lhm.base.files.usd import write_usd
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, sample_weights
from ..lhm.head.detail import FineSkin
from ..lhm.head.head import LayeredHead
from ..lhm.identities.arkit import ARKIT
from ..lhm.scans.own_mesh import OwnMesh
from ..reference import Face
from ..surrogate import BoundSurrogate, CertifiedFace
from ..surrogate.certified import find_counted
from ..surrogate.methods import BLENDSHAPES, DERIVATIVES, differentiate
from .eyes_and_teeth import TURN, EyesAndTeeth, find_eyes_and_teeth
from .pictures import shade_skin, to_linear_light

RigFormat = Literal["glb", "usd"]
WRITERS: Mapping[str, Callable[[Path, MorphRig], None]] = {"glb": write_glb, "usd": write_usd}
EXPRESSIONS, ACCURACY = 8, 1e-3
"""Mixed expressions that the error is measured on, and the accuracy [mm] of the simulator's answers there."""
STRONGEST = 4
"""Shapes that name an expression."""
ORGANS = ("left_eye", "right_eye", "upper_teeth", "lower_teeth", "upper_gums", "lower_gums")


def blended_rig(face: Face) -> MorphRig:
    """Make the rig of a face's blendshapes, without p."""
    return named_rig(face.skin, face.shapes, {"method": BLENDSHAPES})


def simulated_rig(face: Face, progress: OnProgress) -> MorphRig:
    """Make the rig of the face that settles under p and of the simulator's derivatives; some seconds.

    The notes tell its error; see `measure_error`. Raises what the simulator raises.
    """
    progress("derivatives", 0.0)
    rest = face.skin.with_vertices(face.skin.vertices + face.offset)
    targets = face.shapes + face.responses
    progress("derivatives", 1.0)
    return named_rig(rest, targets, {"method": DERIVATIVES, **measure_error(face, progress)})


def measure_error(face: Face, progress: OnProgress) -> dict[str, float | str]:
    """Measure how far the simulator's derivatives are from it, on EXPRESSIONS random expressions.

    The mean is over those of the mean distance [mm] of the vertices that physics moves, the largest of any vertex; its
    expression is named by its strongest shapes, the vertex by its number in the head's skin and its regions.
    """
    certified = CertifiedFace(face, differentiate(face), DERIVATIVES)
    rng, means, largest, worst, vertex = np.random.default_rng(0), [], 0.0, "", 0
    for number in range(EXPRESSIONS):
        progress("error", number / EXPRESSIONS)
        weights = sample_weights(rng)
        skin = certified.frame(weights, ACCURACY).skin.astype(np.float64)
        distance = np.linalg.norm(certified.rig.frame(weights) - skin, axis=1)
        means.append(distance[find_counted(skin, face.blend(weights) + face.carried)].mean())
        if distance.max() > largest:
            largest, vertex = float(distance.max()), int(distance.argmax())
            strongest = np.argsort(-weights)[:STRONGEST]
            worst = " + ".join(f"{ARKIT[k]}*{weights[k]:.2g}" for k in strongest if weights[k] > 0.0)
    progress("error", 1.0)
    mean = float(np.mean(means))
    return {
        "expressions": EXPRESSIONS,
        "mean_error_mm": mean,
        "largest_error_mm": largest,
        "largest_error_in": worst,
        "largest_error_vertex": vertex,
        "largest_error_regions": ", ".join(name for name in face.head.regions if face.head.on_skin([name])[vertex]),
    }


def named_rig(rest: Surface, targets: Floats | Floats32, notes: Mapping[str, Any]) -> MorphRig:
    """Make a rig of a skin at rest and 52 targets (52, n, 3) [mm], with eyes and teeth where the skin's are known."""
    surfaces = [MorphedSurface.from_targets("skin", rest, targets, colour=to_linear_light(shade_skin(rest)))]
    organs = find_eyes_and_teeth(rest)
    if organs is None:
        return MorphRig(surfaces, ARKIT, notes)
    surfaces += _morph_organs(organs, rest, targets)
    return MorphRig(surfaces, ARKIT, {**notes, "eye_turns_degrees": tell_turns()})


def refine_rig(rig: MorphRig, fine: FineSkin) -> MorphRig:
    """Make the rig's first surface, its skin, as it is drawn finer. The others stay."""
    skin, *others = rig.surfaces
    rest, targets = _refine(skin, fine)
    colour = to_linear_light(shade_skin(skin.rest, fine))
    finer = MorphedSurface.from_targets(skin.name, rest, targets.astype(np.float32), colour=colour)
    return replace(rig, surfaces=[finer, *others])


def _refine(skin: MorphedSurface, fine: FineSkin) -> tuple[Surface, Floats]:
    """Return a skin as it is drawn finer, at rest, and its targets there [mm], shape (52, k, 3)."""
    rest = fine.refine(skin.rest.vertices)
    moved = [fine.refine(skin.rest.vertices + target).vertices for target in skin.targets]
    return rest, np.stack(moved) - rest.vertices


def carry_rig(rig: MorphRig, head: LayeredHead, own: OwnMesh) -> MorphRig:
    """Put a scan's own mesh in place of the rig's first surface, its skin.

    The notes tell of a mouth that is sealed, and of lids that are shut or one with the eyes, which do not blink.
    """
    skin, *others = rig.surfaces
    notes = dict(rig.notes)
    rest, moves = _refine(skin, head.fine_skin)
    settled = rest.vertices - head.fine_skin.refine(head.skin.vertices).vertices
    moved = own.surface.with_vertices(own.surface.vertices + own.weights @ settled)
    targets = dict(zip(rig.names, (own.weights @ move for move in moves), strict=True))
    lips = (skin.rest.vertices + skin.targets[list(rig.names).index("jawOpen")])[head.on_skin(["lips"])]
    if own.has_sealed_mouth(moved.vertices + targets["jawOpen"], lips):
        notes["mouth"] = "sealed in the scan: no mouth shows between its lips as the jaw opens"
    if shut := [name for name in ("eyeBlinkLeft", "eyeBlinkRight") if own.has_shut_lids(targets[name])]:
        notes["lids"] = f"shut in the scan, or one surface with the eyes: it has no {' and no '.join(shut)}"
        targets |= {name: np.zeros_like(moved.vertices) for name in shut}
    colour = to_linear_light(shade_skin(moved) if own.colours is None else own.colours)
    values = np.stack(list(targets.values())).astype(np.float32)
    carried = MorphedSurface.from_targets(skin.name, moved, values, colour=colour)
    return replace(rig, surfaces=[carried, *others], notes=notes)


def _morph_organs(organs: EyesAndTeeth, rest: Surface, targets: Floats | Floats32) -> Iterator[MorphedSurface]:
    """Give eyes, which stand still at their centres, and teeth and gums, whose place is linear in the skin's."""
    at_rest, colours = organs.place(rest.vertices), to_linear_light(organs.colours)
    moved = np.stack([organs.place(rest.vertices + target) for target in targets]) - at_rest
    ends = np.cumsum([len(organ.points) for organ in organs.organs]).tolist()
    for name, begin, end in zip(ORGANS, [0, *ends], ends, strict=False):
        points, colour, offsets = at_rest[begin:end], colours[begin:end], moved[:, begin:end]
        triangles = organs.triangles[((organs.triangles >= begin) & (organs.triangles < end)).all(axis=1)] - begin
        if name.endswith("eye"):
            centre = 0.5 * (points[0] + points[-1])  # of a ball, whose first and last points are its poles
            look = {"colour": colour, "place": centre}
            yield MorphedSurface.from_targets(name, Surface(points - centre, triangles), offsets[:0], **look)
        else:
            yield MorphedSurface.from_targets(name, Surface(points, triangles), offsets, colour=colour)


def tell_turns() -> dict[str, dict[str, float]]:
    """Tell by how many degrees a weight of 1 turns its eye's node about x or y, about x first."""
    turns: dict[str, dict[str, float]] = {}
    for side, out in (("Left", 1.0), ("Right", -1.0)):
        turns |= {f"eyeLook{way}{side}": {"x": TURN[way]} for way in ("Up", "Down")}
        turns |= {f"eyeLookOut{side}": {"y": out * TURN["Out"]}, f"eyeLookIn{side}": {"y": -out * TURN["In"]}}
    return turns


def named_take(method: str, rig: BoundSurrogate, take: Take) -> MorphRig | None:
    """Make the rig of a skin that plays a take by its own 52 targets; None where its frames are no sums of these."""
    targets = rig.linear_targets
    if targets is None:
        return None
    rest = rig.skin.with_vertices(rig.neutral.astype(np.float64))
    skin = MorphedSurface.from_targets("skin", rest, targets)
    return MorphRig([skin], ARKIT, {"method": method}, take.times, np.clip(take.weights, 0.0, 1.0))
