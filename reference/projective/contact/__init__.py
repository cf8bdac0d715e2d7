"""Contact of a surface with itself and with obstacles, inside the descent (SoftDECA 3.3.2)."""

from .descent import ContactDescent

__all__ = ["ContactDescent"]
