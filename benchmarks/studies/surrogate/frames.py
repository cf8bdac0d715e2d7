"""The frames at which the network errs most, beside the simulator and trivial rivals, with distances. PNG."""

from __future__ import annotations

import numpy as np

from ....animation.contact_sheet import draw_face_strip
from ....animation.pictures import Panel
from ....surrogate.methods import NETWORK, SETTLED, Method
from ....surrogate.ruler import kind_of_coefficients
from ....surrogate.trials import CorpusTrials
from .methods import NetworkExam
from .scores import CORPUS, run_trials

SHOWN = 6
"""Faces, the worst ones, with the worst frame of each."""
SIZE = 230


def draw_worst_frames(exam: NetworkExam) -> list[bytes]:
    """Draw the worst frame of each of the SHOWN worst faces, the worst first: a PNG of panels for each."""
    faces, network, settled = exam.tested.faces, exam.methods[NETWORK], exam.methods[SETTLED]
    rows = []
    for number, frame, error in find_worst_frames(exam.tested, network):
        face, frames = faces.face(number), faces.frames(number, np.array([frame]))
        skin, weights = face.skin, frames.weights[0]
        blended = face.blend(weights)
        truth = blended + frames.corrected[0].astype(np.float64)
        own, still = (method.bind(face).frame(weights) for method in (network, settled))
        carried = blended + face.carried
        top = max(0.5, float(np.percentile(np.linalg.norm(truth - carried, axis=1), 99.0)))
        panels = [
            Panel("blendshapes: S", skin.with_vertices(blended)),
            Panel(f"T: {kind_of_coefficients(face.coefficients)}", skin.with_vertices(truth)),
            Panel(f"network {error:.2f} mm", skin.with_vertices(own)),
            *(
                Panel(f"|{name} - T|", skin.with_vertices(truth), np.linalg.norm(answer - truth, axis=1), top)
                for name, answer in (("bones carried", carried), ("settled face", still), ("network", own))
            ),
        ]
        rows.append(draw_face_strip(panels, skin, weights.astype(np.float64), SIZE))
    return rows


def find_worst_frames(tested: CorpusTrials, method: Method) -> list[tuple[int, int, float]]:
    """Find the faces with the worst frames of a method, the worst first: face, frame there and its mean error [mm].

    Errors are over the vertices that move.
    """
    worst: dict[int, tuple[int, int, float]] = {}
    for row in run_trials(tested.static(), method):
        found = row["number"], row["frame"], row["to"][CORPUS]["mean"] or 0.0
        worst[found[0]] = max(worst.get(found[0], found), found, key=lambda each: each[2])
    return sorted(worst.values(), key=lambda frame: -frame[2])[:SHOWN]
