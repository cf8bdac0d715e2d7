"""The named landmarks of a scan, found by laying the template on it."""

from __future__ import annotations

from ..base.mesh import Floats
from ..base.progress import OnProgress, silent
from ..registration.landmarks import landmark_ids
from ..registration.registration import register
from ..template import Template
from .intake import HeadScan


def found_landmarks(scan: HeadScan, template: Template, *, progress: OnProgress = silent) -> dict[str, Floats]:
    """Points [mm] on the upright skin by the names of `landmark_ids` (half a minute); raises what `register` raises.

    They are where the registered template's are: on Lee Perry-Smith's scan .7 to 6 mm from those picked by hand. For a
    person to look at, correct and give back to `fit`; given back as they are they say nothing new.
    """
    laid = register(template.skin, template.parts, scan.skin, landmarks=scan.landmarks, progress=progress)
    ids = landmark_ids(template.skin, template.parts)
    return {name: laid.vertices[vertex] for name, vertex in ids.items()}
