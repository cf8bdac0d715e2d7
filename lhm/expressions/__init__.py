"""ARKit's 52 expressions: names, weights, takes, blending, and shapes carried to other faces."""

from ..arkit import ARKIT
from .blending import blend, checked_weights, index, weights_of
from .conversation import conversation
from .rigging import PersonalRig, personalised
from .take import Take, read_take, resampled
from .transfer import transfer_expressions

__all__ = [
    "ARKIT",
    "PersonalRig",
    "Take",
    "blend",
    "checked_weights",
    "conversation",
    "index",
    "personalised",
    "read_take",
    "resampled",
    "transfer_expressions",
    "weights_of",
]
