"""Projective dynamics on tets and triangles: local projections, one global matrix, L-BFGS (SoftDECA Section 3.2)."""

from .solver import ProjectivePrepared, prepare, time_local_step
from .tangent import Pattern, Tangent

__all__ = ["Pattern", "ProjectivePrepared", "Tangent", "time_local_step", "prepare"]
