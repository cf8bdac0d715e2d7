"""Random frames of a corpus in rows of three: blendshapes S, simulation T, and the distance |T - S| as colours. PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..lhm.base.mesh import Floats, Surface
from ..lhm.base.progress import OnProgress
from ..surrogate.corpus.mixture import NAMES, STATIC
from ..surrogate.corpus.plan import SPLITS
from ..surrogate.corpus.reading import Row, Table
from .pictures import Panel, draw_strip

SIZE = 220
FITS = 19
"""Letters of a caption."""
FACE_HEIGHT = 0.86
"""Share of a head, from its top, that a picture frames."""


def draw_contact_sheet(folder: Path, count: int, on_progress: OnProgress) -> bytes:
    """A picture of `count` accepted static frames of both splits, chosen at random, two to a line."""
    tables = [Table(folder, "statics", split, partial=True) for split in SPLITS]
    choices = [(table, row) for table in tables for row in range(len(table))]
    chosen = np.random.default_rng(0).choice(len(choices), min(count, len(choices)), replace=False)
    frames = []
    for done, number in enumerate(chosen):
        table, row = choices[number]
        frames.append(_frame(table, table[row]))
        on_progress("pictures", (done + 1) / len(chosen))
    return tile_pictures(frames, 2)


def tile_pictures(pictures: Sequence[bytes], columns: int) -> bytes:
    """PNG pictures in lines of so many, as PNG."""
    from PIL import Image

    images = [Image.open(io.BytesIO(picture)) for picture in pictures]
    width, height = max(image.width for image in images), max(image.height for image in images)
    whole = Image.new("RGB", (columns * width, -(-len(images) // columns) * height), "white")
    for number, image in enumerate(images):
        whole.paste(image, (number % columns * width, number // columns * height))
    buffer = io.BytesIO()
    whole.save(buffer, "PNG")
    return buffer.getvalue()


def draw_face_strip(panels: Sequence[Panel], skin: Surface, weights: Floats, size: int) -> bytes:
    """Panels side by side, framed as the face of a neutral skin, whose eyes the weights (52,) turn. PNG."""
    y = skin.vertices[:, 1]
    framed: Floats = skin.vertices[y >= y.max() - FACE_HEIGHT * np.ptp(y)]
    return draw_strip([replace(panel, weights=weights) for panel in panels], size=size, framed=framed)


def _frame(table: Table, row: Row) -> bytes:
    skin = table.skin(int(row["identity"]))
    blended = skin.vertices + np.tensordot(
        row["weights"].astype(np.float64), table.shapes(int(row["identity"])), axes=1
    )
    corrected = row["corrected"].astype(np.float64)
    distance = np.linalg.norm(corrected, axis=1)
    top = max(0.5, float(np.percentile(distance, 99.0)))
    panels = [
        Panel(f"S  {row['recording'].decode(errors='replace')[:FITS]}", skin.with_vertices(blended)),
        Panel(f"T  {row['kind'].decode(errors='replace')}", skin.with_vertices(blended + corrected)),
        Panel(_largest(row), skin.with_vertices(blended + corrected), distance, top),
    ]
    return draw_face_strip(panels, skin, row["weights"], SIZE)


def _largest(row: Row) -> str:
    """The parameter that differs most from the middle of its range."""
    varied = np.array([k for k in np.flatnonzero(row["varied"]) if NAMES[k] in STATIC], dtype=int)
    largest = varied[np.argmax(np.abs(row["coefficients"][varied, 0]))]
    return NAMES[largest].replace("_", " ")[:FITS]
