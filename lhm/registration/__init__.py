"""Registration: a template's topology laid onto skins of any other."""

from .landmarks import landmark_ids, named_landmarks, read_landmarks
from .registration import Registration, Residual, register, registered_by

__all__ = [
    "Registration",
    "Residual",
    "landmark_ids",
    "named_landmarks",
    "read_landmarks",
    "register",
    "registered_by",
]
