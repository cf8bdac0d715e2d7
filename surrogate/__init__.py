"""The learned surrogate of the simulator: corpora, networks, their training, and the run time."""

from .runtime import BoundRig, BoundSurrogate, Surrogate, derivatives_rig

__all__ = ["BoundRig", "BoundSurrogate", "Surrogate", "derivatives_rig"]
