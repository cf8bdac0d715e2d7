"""Contact of a surface with itself, solved after the scene without it (SoftDECA 3.3.2)."""

from .solver import ContactSolver

__all__ = ["ContactSolver"]
