"""A few heads to look at: fit, layers, and the simulated face in jawOpen, smile and blink, with their figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..animation.head_pictures import FRONT, LARGEST_GAP
from ..animation.pictures import Panel, draw_cut_away, draw_strip
from ..lhm import expressions
from ..lhm.base.geometry.bvh import TriangleTree
from ..lhm.base.geometry.topology import find_openings
from ..lhm.check import check_head
from ..lhm.head import LayeredHead
from ..reference import Parameters, facial_scene, solve

POSES = {
    "jawOpen": ("jawOpen",),
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "blink": ("eyeBlinkLeft", "eyeBlinkRight"),
}
SIZE = 300


@dataclass(frozen=True)
class Shown:
    """One head of the gallery: its figures by name, two pictures (PNG), and what was found and changed in its file."""

    name: str
    figures: dict[str, Any]
    faces: bytes
    layers: bytes
    notes: tuple[str, ...]


def shown_head(name: str, head: LayeredHead) -> Shown:
    """Simulate and draw a head that has a rig (some ten seconds); InputError without one."""
    skin, report = head.skin, check_head(head)
    gap = TriangleTree(head.skin_wrap.vertices, head.skin_wrap.triangles).closest(skin.vertices)[2]
    panels = [Panel("distance to its wrap", skin, gap, LARGEST_GAP)]
    crossings = sum(figure.value or 0.0 for figure in report.figures if figure.name.startswith("crossings"))
    figures: dict[str, Any] = {
        "skin vertices": len(skin.vertices),
        "openings of the skin": len(find_openings(skin.triangles)),
        "wrap to skin, mean [mm]": report.wrap_to_skin_mean,
        "smallest dihedral [°]": report.smallest_dihedral,
        "crossings of the wraps": int(crossings),
        "gates missed at rest": "; ".join(report.problems) or "none",
        "skin torn by jawOpen [mm²]": report.jaw_open_torn,
        "skin torn by blinks [mm²]": report.blink_torn,
    }
    for pose, names in POSES.items():
        shape = head.expression(expressions.weights_of(dict.fromkeys(names, 1.0)))
        solution = solve(facial_scene(head, Parameters(), shape), solver="projective")
        moved = head.skin_after(shape, solution.positions[: len(head.bone)])
        panels.append(Panel(pose, skin.with_vertices(moved)))
        figures[f"{pose}: tets inverted"] = int(np.count_nonzero(~(solution.volume_ratio > 0.0)))
        figures[f"{pose}: farthest motion [mm]"] = float(np.linalg.norm(moved - skin.vertices, axis=1).max())
    faces = draw_strip(panels, view=FRONT, size=SIZE, framed=head.skin_wrap.vertices, rest=skin)
    return Shown(name, figures, faces, draw_cut_away(head, size=SIZE), head.notes)
