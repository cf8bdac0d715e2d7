"""ARKit's 52 expressions: their names and order, weights, and blending of an identity space's shapes."""

from ..arkit import ARKIT
from .blending import blend, checked_weights, index, weights_of

__all__ = ["ARKIT", "blend", "checked_weights", "index", "weights_of"]
