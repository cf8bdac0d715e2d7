"""ARKit's 52 expressions: names, weights, takes, blending, and shapes carried to other faces."""

from ..arkit import ARKIT, checked_weights, index, parsed, weights_of
from ..rig import blend
from .made_up import combinations, conversation, conversation_take, head_motion, sample_weights, speech
from .readers import read_take
from .recordings import Recording, recordings, starts
from .rigging import PersonalRig, personalised
from .takes import Take, resampled, rotations
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
