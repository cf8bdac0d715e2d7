"""Registration: a template's topology laid onto skins of any other."""

from .landmarks import landmark_ids, pair_landmarks, read_landmarks
from .registration import Registration, Residual, register

__all__ = [
    "Registration",
    "Residual",
    "landmark_ids",
    "pair_landmarks",
    "read_landmarks",
    "register",
]
