"""The learned surrogate of the simulator: corpus, deformation transfer, hypernetwork, training and run time."""

from .runtime import BoundSurrogate, Surrogate

__all__ = ["BoundSurrogate", "Surrogate"]
