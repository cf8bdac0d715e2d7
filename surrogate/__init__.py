"""The learned surrogate of the simulator: corpora, networks, their training, and the run time."""

from .certified import CertifiedFace, CertifiedFrame
from .runtime import BoundRig, BoundSurrogate, Surrogate, derivatives_rig

__all__ = ["BoundRig", "BoundSurrogate", "CertifiedFace", "CertifiedFrame", "Surrogate", "derivatives_rig"]
