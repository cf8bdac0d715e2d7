"""Held-out frames in rows: blendshapes, projective dynamics and the surrogate, and how far each is off. PNG."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ..lhm.progress import OnProgress
from ..surrogate.modal.faces import Faces
from ..surrogate.modal.weights import ModalWeights
from ..surrogate.rivals.modal import ModalMethod
from .contact_sheet import FACE_HEIGHT
from .pictures import Panel, strip

SHOWN = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
"""Which frames: those at these shares of all test frames in the order of how far simulation moves the face."""
SIZE = 230


def frames_png(corpus: Path, weights: ModalWeights, *, partial: bool, progress: OnProgress) -> bytes:
    """Six frames of the test people, from one that hardly moves to one that moves much."""
    from PIL import Image

    faces = Faces(corpus, "test", partial=partial)
    moved = [(index, k, size) for index in range(len(faces)) for k, size in enumerate(faces.moved(index))]
    order = np.argsort([size for *_, size in moved])
    methods = ModalMethod(weights), ModalMethod(weights, exact=True)
    rows = []
    for number, share in enumerate(SHOWN):
        index, k, _ = moved[order[round(share * (len(order) - 1))]]
        face, frames = faces.face(index), faces.frames(index, np.array([k]))
        skin = faces.skin(face.identity)
        blended = skin.vertices + np.tensordot(frames.weights[0], faces.shapes(face.identity), axes=1)
        truth = frames.corrected[0].astype(np.float64)
        own, exact = (method.bind(face)(frames.weights)[0].astype(np.float64) for method in methods)
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
        y = skin.vertices[:, 1]
        framed = skin.vertices[y > y.max() - FACE_HEIGHT * np.ptp(y)]
        rows.append(Image.open(io.BytesIO(strip(panels, size=SIZE, framed=framed))).convert("RGB"))
        progress("pictures", (number + 1) / len(SHOWN))
    sheet = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)), "white")
    for number, row in enumerate(rows):
        sheet.paste(row, (0, number * row.height))
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG")
    return buffer.getvalue()
