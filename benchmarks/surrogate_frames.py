"""Held-out frames in rows: blendshapes, PD, FEniCSx and the surrogate, and how far each is off. PNG."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..lhm.errors import InputError
from ..lhm.mesh import Floats32
from ..lhm.progress import OnProgress
from ..surrogate.corpus.references import FEM_LAWS
from ..surrogate.evaluate_references import referenced
from ..surrogate.modal.faces import Faces
from ..surrogate.modal.weights import ModalWeights
from ..surrogate.rivals.modal import ModalMethod
from ..viewer.pictures import Panel
from .contact_sheet import face_strip, sheet

SHOWN = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
"""Which frames: those at these shares of all test frames in the order of how far simulation moves the face."""
SIZE = 230


def frames_png(corpus: Path, weights: ModalWeights, *, partial: bool, progress: OnProgress) -> bytes:
    """Six frames of the test people, from one that hardly moves to one that moves much.

    Where FEniCSx has solved frames of the corpus on PD's energy, they are of these, with its answer beside the others.
    """
    faces = Faces(corpus, "test", partial=partial)
    methods = ModalMethod(weights), ModalMethod(weights, exact=True)
    rows = []
    for number, frame in enumerate(_shown(corpus, faces, partial)):
        face = faces.face(frame.face)
        skin = faces.skin(face.identity)
        blended = skin.vertices + np.tensordot(frame.weights, face.shapes, axes=1)
        truth = frame.simulated.astype(np.float64)
        own, exact = (method.bind(face)(frame.weights[None])[0].astype(np.float64) for method in methods)
        top = max(0.5, float(np.percentile(np.linalg.norm(truth, axis=1), 99.0)))
        simulated = skin.with_vertices(blended + truth)
        panels = [
            Panel("blendshapes: S", skin.with_vertices(blended)),
            Panel(f"PD: T, {face.kind}", simulated),
            Panel("network", skin.with_vertices(blended + own)),
            Panel("|S - T|", simulated, np.linalg.norm(truth, axis=1), top),
            Panel("|network - T|", simulated, np.linalg.norm(own - truth, axis=1), top),
            Panel("|exact bind - T|", simulated, np.linalg.norm(exact - truth, axis=1), top),
        ]
        if frame.fenicsx is not None:
            away = np.linalg.norm(frame.fenicsx - truth, axis=1)
            panels.insert(2, Panel("FEniCSx", skin.with_vertices(blended + frame.fenicsx)))
            panels.append(Panel("|FEniCSx - T|", simulated, away, top))
        rows.append(face_strip(panels, skin, frame.weights.astype(np.float64), SIZE))
        progress("pictures", (number + 1) / len(SHOWN))
    return sheet(rows, 1)


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame of a face: weights (52,), T - S (n, 3) [mm] by PD, and by FEniCSx where it is known."""

    face: int
    weights: Floats32
    simulated: Floats32
    fenicsx: Floats32 | None


def _shown(corpus: Path, faces: Faces, partial: bool) -> list[_Frame]:
    known = _solved(corpus, faces, partial)
    if known:
        order = np.argsort([np.percentile(np.linalg.norm(frame.simulated, axis=1), 95.0) for frame in known])
        return [known[order[round(share * (len(order) - 1))]] for share in SHOWN]
    moved = [(index, k, size) for index in range(len(faces)) for k, size in enumerate(faces.moved(index))]
    order = np.argsort([size for *_, size in moved])
    found = []
    for share in SHOWN:
        index, k, _ = moved[order[round(share * (len(order) - 1))]]
        frames = faces.frames(index, np.array([k]))
        found.append(_Frame(index, frames.weights[0], frames.corrected[0].astype(np.float32), None))
    return found


def _solved(corpus: Path, faces: Faces, partial: bool) -> list[_Frame]:
    try:
        frames = [one for one in referenced(corpus, "test", faces, partial=partial) if one.law == FEM_LAWS[0]]
    except InputError:  # a corpus without references
        return []
    return [_Frame(one.face, one.weights, one.simulated, one.fenicsx) for one in frames]
