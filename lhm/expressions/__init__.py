"""ARKit's 52 expressions: names, weights, takes, blending, and shapes carried to other faces."""

from ..arkit import ARKIT
from .blending import blend, checked_weights, index, parsed, weights_of
from .combinations import combinations, sample_weights
from .conversation import conversation, conversation_take
from .head_motion import head_motion
from .head_rotation import rotations
from .recordings import Recording, recordings, starts
from .rigging import PersonalRig, personalised
from .speech import speech
from .take import Take, resampled
from .take_file import read_take
from .transfer import transfer_expressions

__all__ = [
    "ARKIT",
    "PersonalRig",
    "Recording",
    "Take",
    "blend",
    "checked_weights",
    "combinations",
    "conversation",
    "conversation_take",
    "head_motion",
    "index",
    "parsed",
    "personalised",
    "read_take",
    "recordings",
    "resampled",
    "rotations",
    "sample_weights",
    "speech",
    "starts",
    "transfer_expressions",
    "weights_of",
]
