"""The forms of networks of deformation gradients by the kind that weights name."""

from __future__ import annotations

from collections.abc import Mapping

from .face_wise import FaceWise
from .gradients import GradientForm
from .hypernetwork import Hypernetwork, PrintedHypernetwork
from .softsmpl import SoftSMPL

MODAL = "modal"
"""The kind of the network that is no form of deformation gradients."""
FORMS: Mapping[str, GradientForm] = {
    form.kind: form for form in (Hypernetwork(), PrintedHypernetwork(), SoftSMPL(), FaceWise())
}


def has_tables(kind: str) -> bool:
    """Whether a network of a kind has an offset and responses, which the simulator's can replace."""
    return kind == MODAL or FORMS[kind].has_tables
