"""The learned surrogate of the simulator: corpora, networks, their training, and the run time."""

from .runtime import BoundSurrogate, Surrogate, derivatives_rig

__all__ = ["BoundSurrogate", "Surrogate", "derivatives_rig"]
