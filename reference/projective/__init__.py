"""Projective dynamics on tets and triangles: local projections, one global matrix, L-BFGS (SoftDECA Section 3.2)."""

from .solver import ProjectivePrepared, local_step_seconds, prepare
from .tangent import Pattern, Tangent

__all__ = ["Pattern", "ProjectivePrepared", "Tangent", "local_step_seconds", "prepare"]
