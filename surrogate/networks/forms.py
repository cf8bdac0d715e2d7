"""The forms of networks of deformation gradients by the kind that weights name."""

from __future__ import annotations

from collections.abc import Mapping

from .face_wise import FaceWise
from .gradients import GradientForm
from .hypernetwork import Hypernetwork, PrintedHypernetwork
from .softsmpl import SoftSMPL

FORMS: Mapping[str, GradientForm] = {
    form.kind: form for form in (Hypernetwork(), PrintedHypernetwork(), SoftSMPL(), FaceWise())
}
