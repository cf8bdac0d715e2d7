"""The learned surrogate of the simulator: corpora, networks, their training, and the run time."""

from .certified import CertifiedFace, CertifiedFrame
from .methods import METHODS, certify
from .rigs.bound import BoundSurrogate
from .runtime import BoundRig, Surrogate

__all__ = ["METHODS", "BoundRig", "BoundSurrogate", "CertifiedFace", "CertifiedFrame", "Surrogate", "certify"]
