"""The independent cross-check: a scene's energy minimised by Newton's method on scikit-fem."""

from .prepared import Prepared, prepare

__all__ = ["Prepared", "prepare"]
