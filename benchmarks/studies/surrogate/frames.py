"""The frames at which the network errs most, beside the simulator and trivial rivals, with distances. PNG."""

from __future__ import annotations

import numpy as np

from ....animation.contact_sheet import draw_face_strip
from ....animation.pictures import Panel
from ....lhm.base.errors import InputError
from ....lhm.base.mesh import Floats, Floats32
from ....lhm.base.progress import OnProgress
from ....surrogate.corpus.reading import Faces
from ....surrogate.corpus.shard import FEM_LAWS
from ....surrogate.methods import FENICSX, NETWORK, SETTLED, Method
from ....surrogate.ruler import kind_of_coefficients, measure
from .methods import NetworkExam

SHOWN = 6
"""Faces, the worst ones, with the worst frame of each."""
SIZE = 230


def draw_worst_frames(exam: NetworkExam, progress: OnProgress) -> list[bytes]:
    """Draw the worst frame of each of the SHOWN worst faces, the worst first: a PNG of panels for each.

    Where FEniCSx has solved the frame on PD's energy, its answer stands beside the others.
    """
    faces, network, settled = exam.tested.faces, exam.methods[NETWORK], exam.methods[SETTLED]
    solved: dict[tuple[int, bytes], Floats32] = {}
    try:
        for known in exam.tested.read_references():
            if known.law == FEM_LAWS[0]:
                solved[known.face, known.weights.tobytes()] = known.fenicsx
    except InputError:
        solved = {}  # a corpus without references
    rows = []
    for number, (worst, frame, error) in enumerate(find_worst_frames(faces, network)):
        face, frames = faces.face(worst), faces.frames(worst, np.array([frame]))
        skin, weights_now = face.skin, frames.weights[0]
        blended = face.blend(weights_now)
        truth, carried = frames.corrected[0].astype(np.float64), face.carried
        own, still = (method.bind(face).frame(weights_now) - blended for method in (network, settled))
        top = max(0.5, float(np.percentile(np.linalg.norm(truth - carried, axis=1), 99.0)))
        simulated = skin.with_vertices(blended + truth)

        def off(answer: Floats | Floats32, truth: Floats = truth) -> Floats:
            return np.linalg.norm(answer - truth, axis=1)

        panels = [
            Panel("blendshapes: S", skin.with_vertices(blended)),
            Panel(f"T: {kind_of_coefficients(face.coefficients)}", simulated),
            Panel(f"network {error:.2f} mm", skin.with_vertices(blended + own)),
            Panel("|bones carried - T|", simulated, off(carried), top),
            Panel("|settled face - T|", simulated, off(still), top),
            Panel("|network - T|", simulated, off(own), top),
        ]
        answer = solved.get((worst, weights_now.tobytes()))
        if answer is not None:
            panels.insert(2, Panel(FENICSX, skin.with_vertices(blended + answer)))
            panels.append(Panel("|FEniCSx - T|", simulated, off(answer), top))
        rows.append(draw_face_strip(panels, skin, weights_now.astype(np.float64), SIZE))
        progress("pictures", (number + 1) / SHOWN)
    return rows


def find_worst_frames(faces: Faces, method: Method) -> list[tuple[int, int, float]]:
    """Find the faces with the worst frames of a method, the worst first: face, frame there and its mean error [mm].

    Errors are over the vertices that move.
    """
    worst = []
    for index in range(len(faces)):
        face, frames = faces.face(index), faces.frames(index)
        if not len(frames.weights):
            continue
        truth, rig = frames.corrected.astype(np.float32), method.bind(face)
        blended = face.blend(frames.weights)
        answers = np.stack([rig.frame(weights) for weights in frames.weights])
        errors = np.linalg.norm(answers - blended - truth, axis=2)
        motions = np.linalg.norm(truth - face.carried, axis=2)
        means = np.nan_to_num([measure(e, m).mean for e, m in zip(errors, motions, strict=True)])
        worst.append((index, int(np.argmax(means)), float(np.max(means))))
    return sorted(worst, key=lambda frame: -frame[2])[:SHOWN]
