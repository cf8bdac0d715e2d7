"""Projective dynamics on tets and triangles: local projections, one global matrix, L-BFGS (SoftDECA Section 3.2)."""

from .hessian.tangent import Tangent
from .solver import ProjectivePrepared, prepare

__all__ = ["ProjectivePrepared", "Tangent", "prepare"]
