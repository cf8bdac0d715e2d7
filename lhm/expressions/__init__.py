"""ARKit's 52 expressions: names, weights, takes, blending, and shapes carried to other faces."""

from ..identities.arkit import ARKIT, check_weights, index, parse_weights, weights_of
from ..identities.transfer import transfer_expressions
from .fitting import FittedTake, TrackedFace, find_neutral, fit_take
from .made_up import combinations, conversation, conversation_take, head_motion, sample_weights, speech
from .readers import read_take
from .recordings import Recording, recordings, starts
from .rig import blend
from .rigging import PersonalRig, personalise
from .takes import Take, resample, rotations
from .writing import write_take

__all__ = [
    "ARKIT",
    "FittedTake",
    "PersonalRig",
    "Recording",
    "Take",
    "TrackedFace",
    "blend",
    "check_weights",
    "combinations",
    "conversation",
    "conversation_take",
    "find_neutral",
    "fit_take",
    "head_motion",
    "index",
    "parse_weights",
    "personalise",
    "read_take",
    "recordings",
    "resample",
    "rotations",
    "sample_weights",
    "speech",
    "starts",
    "transfer_expressions",
    "weights_of",
    "write_take",
]
